"""The identified parameters as tables 5 to 7 of RR-8096 show them, and what the measurements leave open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayescal.geometry import Array
from bayescal.report.blocks import Cell, Column, Statement, Table, make_table
from bayescal.report.figures.parameters import scale_of
from bayescal.report.figures.style import split_symbol
from bayescal.report.numbers import (
    NOTHING,
    count_decimals,
    format_estimate,
    format_fixed,
    format_significant,
    join_words,
)
from bayescal.report.results import MODEL_ERROR, Results, split_name

LENGTH = "mm"
SHOWN_PAIRS = 3


@dataclass(frozen=True)
class Published:
    """Comparison of a least-squares identification with published values.

    Attributes
    ----------
    rms_mm : float
        Root mean square of the differences over all lengths, NaN without any.
    n_lengths : int
    n_inside, n_known : int
        Published values inside the posterior's 90 % interval, and how many there are.
    """

    rms_mm: float
    n_lengths: int
    n_inside: int
    n_known: int


def compare_published(results: Results, variant: str) -> Published:
    """Compare one variant's least squares and posterior (model error free) with the published values."""
    rows = results.least_squares[results.least_squares["variant"] == variant]
    lengths = rows[(rows["unit"] == LENGTH) & rows["difference"].notna()]["difference"].to_numpy()
    rms = float(np.sqrt(np.mean(np.square(lengths)))) if len(lengths) else float("nan")
    known = rows[rows["published_offset"].notna()]
    parameters = results.fit(variant, "free")["parameters"]
    inside = n = 0
    for row in known.itertuples():
        one = parameters.get(f"{row.parameter}[{row.leg}]") or parameters.get(str(row.parameter))
        if one is not None:
            n += 1
            inside += one["q05"] <= one["nominal"] + row.published_offset <= one["q95"]
    return Published(rms, len(lengths), int(inside), n)


def tabulate_parameters(results: Results, variant: str) -> Table:
    """Return one variant's offsets from nominal: posterior, least squares and published, a column per leg."""
    posterior = results.parameters
    posterior = posterior[(posterior["variant"] == variant) & (posterior["model_error"] == "free")]
    posterior = posterior[posterior["symbol"] != MODEL_ERROR]
    found = results.least_squares[results.least_squares["variant"] == variant]
    legs = [leg for leg in results.legs if leg in set(posterior["leg"]) | set(found["leg"])] or [1]
    columns = [Column("", kind="symbol"), Column("Unit", kind="text"), Column("", kind="text")]
    columns += [Column(f"leg {leg}") for leg in legs]
    rows = []
    for symbol in dict.fromkeys(posterior["symbol"]):
        lines = _list_lines(posterior[posterior["symbol"] == symbol], found[found["parameter"] == symbol], legs)
        _, unit = scale_of(symbol, str(posterior[posterior["symbol"] == symbol]["unit"].iloc[0]))
        for k, (label, cells) in enumerate(lines):
            span = len(lines) if k == 0 else 0
            rows.append([Cell(symbol, span=span), Cell(unit, span=span), Cell(label), *(Cell(c) for c in cells)])
    caption = f"{variant}: offsets of the parameters from nominal, with model error."
    return make_table(caption, columns, rows, _state_fit(results, variant, found))


def _list_lines(posterior: pd.DataFrame, found: pd.DataFrame, legs: list[int]) -> list[tuple[str, list[str]]]:
    """Return the lines of one symbol: posterior, least squares, and where there are any the published values."""
    factor, _ = scale_of(str(posterior["symbol"].iloc[0]), str(posterior["unit"].iloc[0]))
    single = set(posterior["leg"]) == {0}
    by_leg = posterior.assign(leg=legs[0] if single else posterior["leg"]).set_index("leg")
    places = min(4, count_decimals(float(factor * by_leg["sd"].min())))
    offset, sd = factor * (by_leg["mean"] - by_leg["nominal"]), factor * by_leg["sd"]
    lines = [
        (
            "posterior mean ± sd" + (" (machine)" if single else ""),
            [
                format_estimate(offset[leg], sd[leg], places, sign=True) if leg in offset.index else NOTHING
                for leg in legs
            ],
        )
    ]
    found = found.set_index("leg")
    for label, column in (
        ("least squares", "offset"),
        ("published", "published_offset"),
        ("least squares − published", "difference"),
    ):
        values = factor * found[column].reindex(legs)
        if values.notna().any():
            lines.append((label, [format_fixed(float(x), places, sign=True) for x in values]))
    return lines


def _state_fit(results: Results, variant: str, found: pd.DataFrame) -> list[Statement]:
    residual = found.drop_duplicates("leg").sort_values("leg")["leg_residual_rms_um"]
    low, high = (format_significant(x, 2) for x in (residual.min(), residual.max()))
    statements = [Statement(f"Least squares leave {low} to {high} µm (rms) per leg.")]
    if not found["converged"].astype(bool).all():
        statements.append(Statement("The least-squares fit did not converge.", "bad"))
    comparison = compare_published(results, variant)
    if comparison.n_known:
        text = (
            f"Least squares differ from the published values by {format_significant(comparison.rms_mm)} mm rms over "
            f"{comparison.n_lengths} lengths. "
            f"{comparison.n_inside} of {comparison.n_known} published values lie inside the posterior's 90 % intervals."
        )
        statements.append(Statement(text))
    return statements


def tabulate_contraction(results: Results) -> Table:
    """Return how much of each prior variance the measurements removed: the mean over the legs and the least."""
    frame = results.parameters
    frame = frame[(frame["model_error"] == "free") & (frame["symbol"] != MODEL_ERROR)]
    frame = frame.assign(contraction=1.0 - (frame["sd"] / frame["prior_sd"]) ** 2)
    grouped = frame.groupby(["variant", "symbol"])["contraction"].agg(["mean", "min"])
    symbols = list(dict.fromkeys(frame["symbol"]))
    rows = []
    for name in results.ranking:
        row: list[str | Cell] = [name]
        for symbol in symbols:
            if (name, symbol) not in grouped.index:
                row.append(NOTHING)
                continue
            mean, least = grouped.loc[(name, symbol)].to_numpy(dtype=float)
            row.append(f"{format_fixed(100 * mean, 1)} ({format_fixed(100 * least, 1)})")
        rows.append(row)
    columns = [
        Column("Variant", kind="name"),
        *(Column(s, "%", "1 − (sd / prior sd)², mean over legs (least)", symbolic=True) for s in symbols),
    ]
    return make_table(
        "Posterior contraction with model error: 0 % is the prior, 100 % is exactly known.", columns, rows
    )


# --- ridges ----------------------------------------------------------------------------------------------------------


def rank_pairs(draws: dict[str, Array]) -> list[tuple[str, str, float]]:
    """Return all pairs of parameters with their correlation, the strongest first."""
    names = list(draws)
    matrix = np.atleast_2d(np.corrcoef(np.stack([draws[name] for name in names])))
    pairs = [(names[i], names[j], float(matrix[i, j])) for i in range(len(names)) for j in range(i + 1, len(names))]
    return sorted((p for p in pairs if np.isfinite(p[2])), key=lambda pair: -abs(pair[2]))


def choose_leg(pairs: list[tuple[str, str, float]]) -> tuple[int, list[tuple[str, str]]]:
    """Return the leg with the most correlated pair and its most correlated pairs of symbols; leg 0 without any."""
    within = [(split_name(a), split_name(b)) for a, b, _ in pairs]
    leg = next((a[1] for a, b in within if a[1] == b[1] and a[1] > 0), 0)
    return leg, [(a[0], b[0]) for a, b in within if a[1] == b[1] == leg][:4]


def tabulate_ridges(results: Results) -> Table | None:
    """Return the most correlated pairs of every variant whose draws are there."""
    rows = []
    for name in results.ranking:
        if name in results.draws:
            pairs = rank_pairs(results.draws[name])[:SHOWN_PAIRS]
            texts = [f"{name_parameter(a)}, {name_parameter(b)}: {format_fixed(r, 3, sign=True)}" for a, b, r in pairs]
            rows.append([name, *texts, *[NOTHING] * (SHOWN_PAIRS - len(texts))])
    if not rows:
        return None
    columns = [Column("Variant", kind="name")]
    columns += [Column(title, kind="text") for title in ("Strongest", "second", "third")]
    return make_table("Most correlated pairs of parameters, correlation of the draws.", columns, rows)


def state_ridges(results: Results) -> list[Statement]:
    """Say in words which pairs of the best variant the measurements cannot tell apart."""
    best = results.ranking[0]
    if best not in results.draws:
        return []
    pairs = rank_pairs(results.draws[best])
    strong = [p for p in pairs if abs(p[2]) > 0.9]
    named = [
        f"{name_parameter(a)} with {name_parameter(b)} ({format_fixed(r, 2, sign=True)})"
        for a, b, r in pairs[:SHOWN_PAIRS]
    ]
    text = f"In {best} the most correlated pairs are {join_words(named)}." if named else ""
    if strong:
        kinds = dict.fromkeys(" with ".join(write_symbol(split_name(x)[0]) for x in p[:2]) for p in strong)
        text += (
            f" {len(strong)} of {len(pairs)} pairs exceed 0.9 in size (kinds: {join_words(list(kinds)[:6])}): only a "
            "combination of the two is well measured, along the ridge the prior decides."
        )
    else:
        text += f" None of the {len(pairs)} pairs exceeds 0.9 in size."
    return [Statement(text)]


def name_parameter(name: str) -> str:
    """Return a parameter's name in words, ``a_x of leg 3``."""
    symbol, leg = split_name(name)
    written = write_symbol(symbol)
    return f"{written} of leg {leg}" if leg else written


def write_symbol(symbol: str) -> str:
    """Return a symbol in running text: Greek letters as such."""
    head, below, above = split_symbol(symbol)
    return f"{head}{above}{f'_{below}' if below else ''}"
