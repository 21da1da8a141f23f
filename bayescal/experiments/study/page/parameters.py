"""The posterior of the parameters, and how much the data narrowed it."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from bayescal.experiments.shared.knowledge_page import VERDICT_LEVELS
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.study.page.figures.readings import draw_reduction
from bayescal.experiments.study.page.illustrations import illustrate_parameters
from bayescal.experiments.study.page.published import compare_published, has_published, name_table, tabulate_published
from bayescal.experiments.study.page.results import NOISE, StudyResults
from bayescal.experiments.study.page.variants import (
    find_variants,
    group_variants,
    label_variant,
    list_deformations,
    name_variants,
)
from bayescal.report.blocks import Block, Cell, Column, Figure, Fold, Heading, Section, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, count_decimals, format_estimate, format_fixed, format_significant
from bayescal.report.symbols import MODEL_ERROR, describe_deformation, name_parameter

OPEN = 3  # variants whose tables are all shown; of more each stands behind a line
CONTRACTION = (
    "Contraction is the share of the prior variance that the data removed, 1 − (sd / tolerance)²: at 0 nothing is "
    "learnt, at 0.75 the uncertainty is halved, at 1 the parameter is known."
)
VERDICTS = {"identifiable": "uncertainty at least halved", "weak": "not halved", "not": "not determined"}
PUBLISHED = (
    "Published values differ from the posteriors by construction: they come from least squares with all poses "
    "weighted alike, without tolerances and without model error, on the data of the publication. The posteriors "
    "weigh every pose by its covariance, use the tolerances as priors and leave room for a model error. These data: "
    "{origin}. A published value outside an interval contradicts nothing, unless the data were made from that very "
    "table."
)


def show_parameters(study: StudyResults) -> Section:
    """Return the posterior of the parameters: leg by leg where poses of legs were measured, else one by one."""
    return _show_legs(study) if study.has("pose_errors") else _show_each(study)


# --- one by one ------------------------------------------------------------------------------------------------------


def _show_each(study: StudyResults) -> Section:
    columns = [Column("Parameter", kind="text"), Column("Unit", kind="text"), Column("Nominal"), Column("Tolerance")]
    columns += [Column("Posterior, mean ± sd"), Column("90 % interval"), Column("Contraction"), Column("Verdict")]
    rows: list[list[str | Cell]] = []
    for row in study.rows("parameters", study.chosen):
        factor, unit = study.shown_in(row["unit"])
        low, high = (format_significant(factor * row[end], 5) for end in ("q05", "q95"))
        verdict = str(row["verdict"])
        rows.append(
            [
                str(row["parameter"]),
                unit,
                format_significant(factor * row["nominal"], 6),
                format_significant(factor * row["prior_sd"], 3),
                format_estimate(factor * row["mean"], factor * row["sd"]),
                f"{low} to {high}",
                format_contraction(row["contraction"]),
                Cell("" if verdict == NOISE else VERDICTS[verdict], VERDICT_LEVELS[verdict]),
            ]
        )
    titles = {name: str(study.fit(name)["title"]) for name in study.names}
    draw = partial(draw_reduction, study.table("parameters"), titles)
    caption = "Posterior standard deviation of each parameter over its tolerance (prior standard deviation)."
    table = make_table(f"Parameters of {label_variant(study, study.chosen)}.", columns, rows)
    return Section("Parameters", (CONTRACTION, table, Figure("parameters", caption, draw)), anchor="parameters")


def format_contraction(value: float) -> str:
    """Return a contraction as every table shows it."""
    return format_fixed(value, 2)


# --- leg by leg ------------------------------------------------------------------------------------------------------


def _show_legs(study: StudyResults) -> Section:
    title, blocks = "Parameters", list[Block]()
    published = tabulate_published(study)
    if published is not None:
        title += " and published tables"
        blocks += [published, PUBLISHED.format(origin=name_origin(study.summary["origin"]).rstrip("."))]
    blocks += [illustrate_parameters(study), *state_agreement(study)]
    for heading, folds in fold_parameters(study):
        blocks += [Heading(heading), *folds]
    blocks.append(Fold("How much the measurements narrowed each parameter", (tabulate_contraction(study),)))
    return Section(title, tuple(blocks), anchor="parameters", short="Parameters")


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
    """Say how far the posteriors of variants that fit equally well lie apart."""
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
    text = f"The posterior means of variants that fit equally well differ: {'; '.join(words)}."
    return [Statement(text)]


def tabulate_parameters(results: StudyResults, variant: str) -> Table:
    """Return one variant's offsets from nominal: posterior, least squares and published, a column per leg."""
    posterior = results.parameters
    posterior = posterior[(posterior["variant"] == variant) & (posterior["model_error"] == "free")]
    posterior = posterior[posterior["symbol"] != MODEL_ERROR]
    found = results.table("least_squares")[results.table("least_squares")["variant"] == variant]
    legs = [leg for leg in results.legs if leg in set(posterior["leg"]) | set(found["leg"])] or [1]
    columns = [Column("", kind="symbol"), Column("Unit", kind="text"), Column("", kind="text")]
    columns += [Column(f"leg {leg}") for leg in legs]
    least_squares = {str(symbol): rows for symbol, rows in found.groupby("parameter", sort=False)}
    rows = []
    for symbol, chosen in posterior.groupby("symbol", sort=False):
        factor, unit = results.scale_of(str(symbol), str(chosen["unit"].iloc[0]))
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
    statements = [Statement(f"Residuals of least squares: {low} to {high} µm (rms) per leg.")]
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
    """Return the contraction of each symbol's parameters: the mean over the legs and the least."""
    frame = results.parameters
    frame = frame[(frame["model_error"] == "free") & (frame["symbol"] != MODEL_ERROR)]
    grouped = frame.groupby(["variant", "symbol"])["contraction"].agg(["mean", "min"])
    symbols = list(dict.fromkeys(frame["symbol"]))
    cells = {
        (str(name), str(symbol)): f"{format_contraction(mean)} ({format_contraction(least)})"
        for (name, symbol), mean, least in grouped.itertuples()
    }
    columns = [Column("", kind="symbol")]
    columns += [Column(label_variant(results, name), group="mean over legs (least)") for name in results.ranking]
    rows = [[symbol, *(cells.get((name, symbol), NOTHING) for name in results.ranking)] for symbol in symbols]
    return make_table("Contraction of the parameters, with model error.", columns, rows, [Statement(CONTRACTION)])
