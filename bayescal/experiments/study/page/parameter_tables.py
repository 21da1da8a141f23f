"""The identified parameters variant by variant, and how much the measurements narrowed them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayescal.experiments.study.page.published import compare_published, has_published, name_table
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.variants import (
    VARIANT,
    find_variants,
    group_variants,
    label_variant,
    list_deformations,
    name_variants,
)
from bayescal.report.blocks import Cell, Column, Fold, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, count_decimals, format_estimate, format_fixed, format_significant
from bayescal.report.symbols import MODEL_ERROR, name_parameter, scale_of
from bayescal.report.variant_names import describe_deformation

OPEN = 3  # variants whose tables are all shown; of more each stands behind a line
WIDE = 12  # symbols from which the contraction table has them as rows


def fold_parameters(results: StudyResults) -> list[tuple[str, list[Fold]]]:
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


def state_agreement(results: StudyResults) -> list[Statement]:
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
            words.append(
                f"{name_variants(results, group)} by at most {format_fixed(float(apart.max()), 2)} sd ({where})"
            )
    if not words:
        return []
    text = f"The posterior means of variants that are not told apart differ: {'; '.join(words)}."
    return [Statement(text)]


def tabulate_parameters(results: StudyResults, variant: str) -> Table:
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
    return make_table(caption, columns, rows, _state_fit(results, variant, found), "long")


def _title(results: StudyResults, variant: str) -> str:
    table = name_table(results, variant)
    return (
        f"{table[0].upper()}{table[1:]}, {label_variant(results, variant)}"
        if table
        else label_variant(results, variant)
    )


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


def _state_fit(results: StudyResults, variant: str, found: pd.DataFrame) -> list[Statement]:
    if found.empty:
        return []
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


def tabulate_contraction(results: StudyResults) -> Table:
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
        columns = [
            Column("", kind="symbol"),
            *(Column(label_variant(results, name), "%", group) for name in results.ranking),
        ]
        rows = [[s, *(cells.get((name, s), NOTHING) for name in results.ranking)] for s in symbols]
    else:
        columns = [VARIANT, *(Column(s, "%", group, symbolic=True) for s in symbols)]
        rows = [
            [label_variant(results, name), *(cells.get((name, s), NOTHING) for s in symbols)]
            for name in results.ranking
        ]
    return make_table(caption, columns, rows)
