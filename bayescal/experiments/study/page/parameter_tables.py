"""The identified parameters as tables 5 to 7 of RR-8096 show them, and what the measurements leave open."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bayescal.experiments.study.page.published import compare_published, has_published, name_table
from bayescal.experiments.study.page.results import Results
from bayescal.experiments.study.page.variants import (
    describe_deformation,
    find_variants,
    group_variants,
    label_variant,
    list_deformations,
    name_variants,
)
from bayescal.report.blocks import Cell, Column, Fold, Statement, Table, make_table
from bayescal.report.numbers import (
    NOTHING,
    count_decimals,
    format_estimate,
    format_fixed,
    format_significant,
    join_words,
)
from bayescal.report.symbols import MODEL_ERROR, is_model_error, name_parameter, scale_of, split_name, write_symbol

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array

OPEN = 3  # variants whose tables are all shown; of more each stands behind a line
SHOWN_PAIRS = 3
KEPT, LOST = 0.5, 0.01  # share of the prior variance of a combination that is hardly, or well, measured
WIDE = 12  # symbols from which the contraction table has them as rows


def fold_parameters(results: Results) -> list[tuple[str, list[Fold]]]:
    """Return the tables of all variants, each behind a line that says how far it is from the published one."""
    groups = []
    for deformation in list_deformations(results):
        folds = []
        for name in find_variants(results, deformation=deformation):
            title = _title(results, name)
            if has_published(results, name):
                comparison = compare_published(results, name)
                title += (
                    f": least squares {format_significant(comparison.rms_mm, 2)} mm rms from the published lengths, "
                    f"{comparison.n_inside} of {comparison.n_known} published values in the posterior's 90 % intervals"
                )
            folds.append(Fold(title, (tabulate_parameters(results, name),), len(results.ranking) <= OPEN))
        words = describe_deformation(deformation)
        groups.append((words[0].upper() + words[1:], folds))
    return groups


def state_agreement(results: Results) -> list[Statement]:
    """Say how far the posteriors of variants lie apart that the evidence does not tell apart."""
    frame = results.parameters
    frame = frame[(frame["model_error"] == "free") & (frame["symbol"] != MODEL_ERROR)]
    words = []
    for group in group_variants(results, results.ranking):
        rows = frame[frame["variant"].isin(group)]
        index = ["symbol", "leg"]  # of the parameters that all have
        mean, sd = (rows.pivot(index=index, columns="variant", values=what).dropna() for what in ("mean", "sd"))
        if len(group) > 1 and len(mean):
            apart = np.ptp(mean.to_numpy(), axis=1) / sd.to_numpy().mean(axis=1)
            symbol, leg = mean.index[int(apart.argmax())]
            where = name_parameter(f"{symbol}[{leg}]" if leg else str(symbol))
            words.append(f"{name_variants(group)} by at most {format_fixed(float(apart.max()), 2)} sd ({where})")
    if not words:
        return []
    text = f"The posterior means of variants that are not told apart differ: {'; '.join(words)}."
    return [Statement(text)]


def tabulate_parameters(results: Results, variant: str) -> Table:
    """Return one variant's offsets from nominal: posterior, least squares and published, a column per leg."""
    posterior = results.parameters
    posterior = posterior[(posterior["variant"] == variant) & (posterior["model_error"] == "free")]
    posterior = posterior[posterior["symbol"] != MODEL_ERROR]
    found = results.least_squares[results.least_squares["variant"] == variant]
    legs = [leg for leg in results.legs if leg in set(posterior["leg"]) | set(found["leg"])] or [1]
    columns = [Column("", kind="symbol"), Column("Unit", kind="text"), Column("", kind="text")]
    columns += [Column(f"leg {leg}") for leg in legs]
    least_squares = {str(symbol): rows for symbol, rows in found.groupby("parameter", sort=False)}
    rows = []
    for symbol, chosen in posterior.groupby("symbol", sort=False):
        factor, unit = scale_of(str(symbol), str(chosen["unit"].iloc[0]))
        lines = _list_lines(chosen, least_squares.get(str(symbol), found.iloc[:0]), legs, factor)
        for k, (label, cells) in enumerate(lines):
            span = len(lines) if k == 0 else 0
            rows.append([Cell(str(symbol), span=span), Cell(unit, span=span), Cell(label), *(Cell(c) for c in cells)])
    caption = f"{_title(results, variant)}: offsets from nominal."
    return make_table(caption, columns, rows, _state_fit(results, variant, found))


def _title(results: Results, variant: str) -> str:
    table = name_table(results, variant)
    return f"{table[0].upper()}{table[1:]}, {label_variant(variant)}" if table else label_variant(variant)


def _list_lines(
    posterior: pd.DataFrame, found: pd.DataFrame, legs: list[int], factor: float
) -> list[tuple[str, list[str]]]:
    """Return the lines of one symbol: posterior, least squares, and where there are any the published values."""
    single = set(posterior["leg"]) == {0}
    places = min(4, count_decimals(float(factor * posterior["sd"].min())))
    estimates = {
        legs[0] if single else leg: format_estimate(factor * (mean - nominal), factor * sd, places, sign=True)
        for leg, mean, nominal, sd in posterior[["leg", "mean", "nominal", "sd"]].itertuples(index=False)
    }
    lines = [("posterior mean ± sd" + (" (machine)" if single else ""), [estimates.get(leg, NOTHING) for leg in legs])]
    for label, column in (
        ("least squares", "offset"),
        ("published", "published_offset"),
        ("least squares − published", "difference"),
    ):
        values = {leg: factor * x for leg, x in zip(found["leg"], found[column], strict=True) if x == x}
        if values:
            lines.append((label, [format_fixed(values.get(leg), places, sign=True) for leg in legs]))
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
    cells = {
        (str(name), str(symbol)): f"{format_fixed(100 * mean, 1)} ({format_fixed(100 * least, 1)})"
        for (name, symbol), mean, least in grouped.itertuples()
    }
    caption = "Posterior contraction with model error: 0 % is the prior, 100 % is exactly known."
    group = "1 − (sd / prior sd)², mean over legs (least)"
    if len(symbols) > WIDE:
        columns = [Column("", kind="symbol"), *(Column(label_variant(name), "%", group) for name in results.ranking)]
        rows = [[s, *(cells.get((name, s), NOTHING) for name in results.ranking)] for s in symbols]
    else:
        columns = [Column("Variant", kind="name"), *(Column(s, "%", group, symbolic=True) for s in symbols)]
        rows = [[label_variant(name), *(cells.get((name, s), NOTHING) for s in symbols)] for name in results.ranking]
    return make_table(caption, columns, rows)


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
            rows.append([label_variant(name), *texts, *[NOTHING] * (SHOWN_PAIRS - len(texts))])
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
    text = f"In {label_variant(best)} the most correlated pairs are {join_words(named)}." if named else ""
    if strong:
        kinds = dict.fromkeys(" with ".join(write_symbol(split_name(x)[0]) for x in p[:2]) for p in strong)
        text += (
            f" {len(strong)} of {len(pairs)} pairs exceed 0.9 in size (kinds: {join_words(list(kinds)[:6])}): only a "
            "combination of the two is well measured, along the ridge the prior decides."
        )
    else:
        text += f" None of the {len(pairs)} pairs exceeds 0.9 in size."
    return [Statement(text), *_state_combinations(results, best)]


def _state_combinations(results: Results, variant: str) -> list[Statement]:
    """Say how many combinations of parameters keep their tolerance: ridges of three and more show in no pair."""
    draws, parameters = results.draws[variant], results.fit(variant, "free")["parameters"]
    names = [name for name in draws if name in parameters and not is_model_error(split_name(name)[0])]
    if len(names) < 2:
        return []
    left = np.linalg.eigvalsh(np.cov(np.stack([draws[name] / parameters[name]["prior_sd"] for name in names])))
    kept, lost = int((left > KEPT).sum()), int((left < LOST).sum())
    text = (
        f"Of the {len(left)} independent combinations of its geometry (principal axes of the draws in prior standard "
        f"deviations) {kept or 'none'} keep more than half of their prior variance, {lost or 'none'} less than 1 %."
    )
    if kept and lost:
        text += " So a parameter may stay uncertain by itself while the poses fix a combination of several."
    return [Statement(text)]
