"""The posterior of parameters and frames, how much the data narrowed it, and published values next to it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayescal.experiments.shared.knowledge_page import VERDICT_LEVELS
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.study.page.results import NOISE, VARIANT, StudyResults
from bayescal.experiments.study.page.styles import Styles, add_legend, assign_styles
from bayescal.experiments.study.rows import ParameterRow, PublishedParameterRow
from bayescal.report.blocks import Block, Cell, Column, Figure, Fold, Heading, PageSection, Statement, Table, make_table
from bayescal.report.numbers import (
    NO_VALUE,
    count_decimals,
    format_estimate,
    format_fixed,
    format_significant,
    format_span,
    name_some,
)
from bayescal.report.style import GREY, INK, PALE
from bayescal.report.symbols import (
    ChosenUnits,
    describe_deformation,
    is_model_error,
    quote,
    scale_of,
    set_mathematics,
    split_name,
    write_symbol,
)

OPEN = 3  # variants whose tables are all shown; of more each stands behind a line
ESTIMATE = "posterior mean ± sd"
CONTRACTION = "A contraction of 0.75 halves the uncertainty."
VERDICTS = {
    "identifiable": "uncertainty at least halved",
    "weak": "not halved",
    "not": "not determined",
    "several": "several values",
}
PUBLISHED = "Published: least squares, no priors. Here: {origin}."
LENGTH = "mm"
ODD = 0.25  # of the other models' values, below which a published row looks misprinted
MISPRINT = 10.0
PRIOR_90 = 1.645  # prior standard deviations to the 5 and 95 % points of a normal prior
PANELS_OF_THREE_FROM = 8  # symbols from which the panels are three in a row
WIDEST_BAND = 100.0  # a prior's half width over what posteriors reach from which on a panel is all shaded
MOST_NAMED = 25  # parameters with a name each below an axis, legible on a telephone too


def show_parameters(study: StudyResults) -> PageSection:
    """Return the posterior of the parameters: leg by leg where they are of legs, and one by one."""
    title, blocks = "Parameters", list[Block]()
    published = tabulate_published(study)
    if published is not None:
        title += " and published tables"
        blocks += [published, PUBLISHED.format(origin=name_origin(study.summary["origin"]).rstrip("."))]
    blocks += _show_members(study) if study.has_members else _show_each(study)
    return PageSection(title, tuple(blocks), anchor="parameters", short="Parameters")


def state_undetermined(study: StudyResults) -> list[Statement]:
    """Say of which parameters the data do not halve the uncertainty."""
    rows = [row for row in study.rows(ParameterRow, study.chosen) if row.verdict != NOISE]
    weak = [row.parameter for row in rows if row.verdict not in ("identifiable", "several")]
    if not weak and any(row.verdict == "several" for row in rows):
        return []  # what is said of the solutions says it
    if not weak:
        return [Statement("All uncertainties at least halved.", "good", "Parameters")]
    text = f"{name_some(weak)}: uncertainty not halved."
    return [Statement(text, "warning", "Parameters", value=float(len(weak)), limit=0.0)]


# --- one by one ------------------------------------------------------------------------------------------------------


def _show_each(study: StudyResults) -> list[Block]:
    caption = "Posterior sd / prior sd."
    draw = partial(_draw_reduction, study.geometry, study.names, assign_styles(study))
    return [CONTRACTION, _tabulate_each(study), Figure("parameters", caption, draw), *state_agreement(study)]


def _tabulate_each(study: StudyResults) -> Table:
    """Return every parameter of the variant to use, its noise and errors too."""
    columns = [Column("Parameter", kind="text"), Column("Unit", kind="text"), Column("Nominal"), Column("Tolerance")]
    columns += [Column("Posterior, mean ± sd"), Column("90 % interval"), Column("Contraction"), Column("Verdict")]
    rows: list[list[str | Cell]] = []
    for row in study.rows(ParameterRow, study.chosen):
        if study.list_terms(study.chosen) and is_model_error(split_name(row.parameter)[0]):
            continue  # it has a section of its own
        factor, unit = study.shown_in(row.unit)
        low, high = (format_significant(factor * end, 5) for end in (row.q05, row.q95))
        verdict = row.verdict
        rows.append(
            [
                row.parameter,
                unit,
                format_significant(factor * row.nominal, 6),
                format_significant(factor * row.prior_sd, 3),
                format_estimate(factor * row.mean, factor * row.sd),
                f"{low} to {high}",
                format_fixed(row.contraction, 2),
                Cell("" if verdict == NOISE else VERDICTS[verdict], VERDICT_LEVELS[verdict]),
            ]
        )
    return make_table(f"Parameters of {study.label(study.chosen)}.", columns, rows)


def _draw_reduction(parameters: pd.DataFrame, variants: Sequence[str], styles: Styles) -> Drawing:
    """Return each parameter's posterior standard deviation over its tolerance, by variant."""
    names = list(dict.fromkeys(str(name) for name in parameters["parameter"]))
    figure = Drawing(figsize=(9.4, 3.6))
    axes = figure.subplots()
    for k, variant in enumerate(variants):
        rows, style = parameters[parameters["variant"] == variant], styles[variant]
        place = np.array([names.index(str(name)) for name in rows["parameter"]]) + 0.1 * (k - 0.5 * (len(variants) - 1))
        shape: dict[str, Any] = {"color": style.colour, "markersize": 4.5, "label": style.label}
        axes.plot(place, rows["sd"] / rows["prior_sd"], style.marker, **shape)
    axes.axhline(1.0, color=GREY, linewidth=0.8)
    axes.set_yscale("log")
    axes.set_ylabel("Posterior sd / tolerance")
    ticks = {name: [k] for k, name in enumerate(names)}
    if len(names) > MOST_NAMED:  # the entries of a symbol share its name
        ticks = {}
        for k, name in enumerate(names):
            ticks.setdefault(name.partition("[")[0], []).append(k)
    axes.set_xticks([float(np.mean(own)) for own in ticks.values()], [quote(name) for name in ticks], rotation=60)
    axes.tick_params(axis="x", labelsize=8.0)
    axes.grid(axis="y")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


# --- leg by leg ------------------------------------------------------------------------------------------------------


def _show_members(study: StudyResults) -> list[Block]:
    blocks: list[Block] = [_illustrate(study), *state_agreement(study)]
    for heading, folds in fold_parameters(study):
        blocks += [*([Heading(heading)] if heading else []), *folds]
    blocks.append(Fold("Posterior sd / prior sd", (_tabulate_contraction(study),)))
    blocks.append(Fold(f"Parameters of {study.label(study.chosen)}", (CONTRACTION, _tabulate_each(study))))
    return blocks


def fold_parameters(study: StudyResults) -> list[tuple[str, list[Fold]]]:
    """Return the tables of all variants, each behind a line that says how far it is from the published one."""
    groups = []
    for deformation in study.deformations:
        folds = []
        for name in study.find(deformation=deformation):
            title, found = _title(study, name), compare_published(study, name)
            if found is not None:
                title += (
                    f": least squares {format_significant(found.rms_mm, 2)} mm rms from published "
                    f"lengths, {found.n_inside} of {found.n_known} inside 90 % intervals"
                )
            folds.append(Fold(title, (tabulate_parameters(study, name),), len(study.ranking) <= OPEN))
        words = describe_deformation(deformation) if deformation else ""
        groups.append((words[:1].upper() + words[1:], folds))
    return groups


def state_agreement(study: StudyResults) -> list[Statement]:
    """Say how far the posteriors of variants that fit equally well lie apart."""
    frame, words = study.geometry, list[str]()
    for group in study.group(study.ranking):
        rows = frame[frame["variant"].isin(group)]
        index = ["symbol", "leg"]  # of the parameters that all have
        mean, sd = (rows.pivot(index=index, columns="variant", values=what).dropna() for what in ("mean", "sd"))
        if len(group) > 1 and len(mean):
            apart = np.ptp(mean.to_numpy(), axis=1) / sd.to_numpy().mean(axis=1)
            symbol, leg = mean.index[int(apart.argmax())]
            where = study.name_parameter(f"{symbol}[{leg}]" if leg else str(symbol))
            most = format_fixed(float(apart.max()), 2)
            words.append(f"{study.name_variants(group)} by at most {most} sd ({where})")
    text = f"Equally good variants differ in {'; '.join(words)}."
    return [Statement(text)] if words else []


def tabulate_parameters(study: StudyResults, variant: str) -> Table:
    """Return one variant's offsets from nominal: posterior, least squares and published, a column per leg.

    Without least squares the caption says what all rows are: on a telephone a column of it leaves no room for numbers.
    """
    posterior = study.geometry[study.geometry["variant"] == variant]
    found = study.table("least_squares", variant)
    legs = sorted({*posterior["leg"], *found["leg"]} - {0}) or [1]
    columns = [Column("", kind="symbol"), Column("Unit", kind="text")]
    columns += [] if found.empty else [Column("", kind="text")]
    columns += [Column(f"{study.member} {leg}") for leg in legs]
    rows = []
    for symbol, chosen in posterior.groupby("symbol", sort=False):
        factor, unit = study.scale_of(str(symbol), str(chosen["unit"].iloc[0]))
        lines = _list_lines(chosen, found[found["parameter"] == symbol], legs, factor)
        for k, (label, cells) in enumerate(lines):
            span = len(lines) if k == 0 else 0
            head = [Cell(str(symbol), span=span), Cell(unit, span=span), Cell(label)]
            if found.empty:
                head = [head[0], Cell(f"{unit}{label.removeprefix(ESTIMATE)}", span=span)]
            rows.append([*head, *(Cell(one) for one in cells)])
    what = f"offsets from nominal{f', {ESTIMATE}' if found.empty else ''}"
    caption = f"{_title(study, variant)}: {what}."
    return make_table(caption, columns, rows, _state_fit(study, variant, found), "long")


def _title(study: StudyResults, variant: str) -> str:
    table = name_table(study, variant)
    return f"{table[0].upper()}{table[1:]}, {study.label(variant)}" if table else study.label(variant)


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
    lines = [(ESTIMATE + (" (machine)" if single else ""), [estimates.get(leg, NO_VALUE) for leg in legs])]
    for label, column in (
        ("least squares", "offset"),
        ("published", "published_offset"),
        ("least squares − published", "difference"),
    ):
        values = {leg: factor * x for leg, x in zip(found["leg"], found[column], strict=True) if x == x}
        if values:
            lines.append((label, [format_fixed(values.get(leg), places, sign=True) for leg in legs]))
    return lines


def _state_fit(study: StudyResults, variant: str, found: pd.DataFrame) -> list[Statement]:
    if found.empty:
        return []
    residual = found.drop_duplicates("leg").sort_values("leg")["leg_residual_rms_um"]
    low, high = (format_significant(x, 2) for x in (residual.min(), residual.max()))
    statements = [Statement(f"Least-squares residuals: {low} to {high} µm (rms) per {study.member}.")]
    if not found["converged"].astype(bool).all():
        statements.append(Statement("Least squares did not converge.", "bad"))
    comparison = compare_published(study, variant)
    if comparison is not None and comparison.n_known:
        text = (
            f"Least squares − published: {format_significant(comparison.rms_mm)} mm rms, "
            f"{comparison.n_lengths} lengths. {comparison.n_inside} of {comparison.n_known} published "
            "values inside 90 % intervals."
        )
        statements.append(Statement(text))
    return statements


def _tabulate_contraction(study: StudyResults) -> Table:
    """Return the contraction of each symbol's parameters: the mean over the legs and the least."""
    frame = study.geometry
    grouped = frame.groupby(["variant", "symbol"])["contraction"].agg(["mean", "min"])
    cells = {key: f"{format_fixed(mean, 2)} ({format_fixed(least, 2)})" for key, mean, least in grouped.itertuples()}
    columns = [Column("", kind="symbol")]
    columns += [Column(study.label(name), group=f"mean over {study.member}s (least)") for name in study.ranking]
    symbols = dict.fromkeys(map(str, frame["symbol"]))
    rows = [[symbol, *(cells.get((name, symbol), NO_VALUE) for name in study.ranking)] for symbol in symbols]
    return make_table("Contraction.", columns, rows, [Statement(CONTRACTION)])


def _illustrate(study: StudyResults) -> Figure:
    """Return the intervals of the parameters of one model, that of the variant to use."""
    model, styles = study.split(study.chosen)[0], assign_styles(study)
    several = len(study.models) > 1
    which = f" of the {study.label_model(model)} model" if several else ""
    caption = (
        f"Offsets from nominal{which}: posterior mean, 90 % interval; band: "
        f"prior.{(' Others: tables below.' if several else '')}"
    )
    names = study.find(model)
    frame, published = study.geometry, study.table("least_squares")
    frame, published = (table[table["variant"].isin(names)] for table in (frame, published))
    draw = partial(
        _draw_parameters, frame, published, {name: styles[name] for name in names}, study.units, study.member
    )
    return Figure("parameters", caption, draw)


def _draw_parameters(
    rows: pd.DataFrame, published: pd.DataFrame, styles: Styles, asked: ChosenUnits, member: str
) -> Drawing:
    """Return the 90 % posterior intervals of the geometry, as offsets from nominal, a panel per symbol."""
    symbols = list(dict.fromkeys(rows["symbol"]))
    n_columns = 2 if len(symbols) <= PANELS_OF_THREE_FROM else 3
    n_rows = math.ceil(len(symbols) / n_columns)
    figure = Drawing(figsize=(9.4, 0.5 + 1.7 * n_rows))
    grid = figure.subplots(n_rows, n_columns, squeeze=False).ravel()
    for axes, symbol in zip(grid, symbols, strict=False):
        chosen = rows[rows["symbol"] == symbol]
        there = {name: style for name, style in styles.items() if name in set(chosen["variant"])}
        factor, unit = scale_of(symbol, str(chosen["unit"].iloc[0]), asked)
        widths = factor * PRIOR_90 * chosen.groupby("leg")["prior_sd"].max()
        axes.bar(widths.index, 2 * widths, 0.9, -widths, color=PALE, alpha=0.55, linewidth=0)
        draw_intervals(axes, chosen, there, factor)
        single = set(chosen["leg"]) == {0}
        for k, name in enumerate(there):
            known = published[(published["variant"] == name) & (published["parameter"] == symbol)]
            leg = (0.0 if single else known["leg"].to_numpy()) + np.full(len(known), _shift(k, len(there)))
            offset = factor * known["published_offset"].to_numpy()
            axes.plot(leg, offset, linestyle="none", marker="x", markersize=4.5, color=INK, markeredgewidth=0.9)
        reach = factor * float(chosen[["q05", "q95"]].sub(chosen["nominal"], axis=0).abs().to_numpy().max())
        if widths.max() > WIDEST_BAND * reach > 0.0:
            axes.set_ylim(-1.15 * reach, 1.15 * reach)
        axes.axhline(0, color=INK, linewidth=0.8)
        axes.set_ylabel(f"{set_mathematics(symbol, 'Δ')} ({unit})")
        label_members(axes, chosen, member)
    for axes in grid[len(symbols) :]:
        axes.set_axis_off()
    others: list[Patch | Line2D] = [Patch(color=PALE, alpha=0.55, label="prior, central 90 %")]
    if published["published_offset"].notna().any():
        others.append(Line2D([], [], color=INK, marker="x", markersize=4.5, linestyle="none", label="published"))
    add_legend(figure, styles, 1.6, *others, most=5)
    return figure


def _shift(k: int, n: int) -> float:
    return min(0.72, 0.24 * n) * ((k + 0.5) / n - 0.5)


def draw_intervals(axes: Axes, rows: pd.DataFrame, styles: Styles, factor: float) -> None:
    """Draw means and 90 % intervals as offsets from nominal, times a factor: variants side by side at each leg."""
    for k, (name, style) in enumerate(styles.items()):
        chosen = rows[rows["variant"] == name]
        leg = chosen["leg"].to_numpy() + _shift(k, len(styles))
        mean, low, high = (factor * (chosen[c] - chosen["nominal"]).to_numpy() for c in ("mean", "q05", "q95"))
        axes.vlines(leg, low, high, color=style.colour, linewidth=1.6)
        axes.plot(leg, mean, linestyle="none", marker=style.marker, markersize=3.8, color=style.colour)


def label_members(axes: Axes, rows: pd.DataFrame, member: str) -> None:
    """Name the legs, or what else the index of a parameter counts, below an axis."""
    legs = sorted(set(rows["leg"]))
    axes.set_xticks(legs, [f"{member} {leg}" if leg else "machine" for leg in legs])
    axes.set_xlim(min(legs) - 0.5, max(legs) + 0.5)
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y")


# --- published values ------------------------------------------------------------------------------------------------


class Published(NamedTuple):
    """A least-squares identification against published values.

    ``rms_mm`` of the differences over all ``n_lengths`` lengths (NaN without any), and how many of ``n_known`` values
    lie inside the posterior's 90 % interval.
    """

    rms_mm: float
    n_lengths: int
    n_inside: int
    n_known: int


def compare_published(study: StudyResults, variant: str) -> Published | None:
    """Compare one variant's least squares and posterior with the published values, if any."""
    rows = study.rows(PublishedParameterRow, variant)
    published = [row for row in rows if math.isfinite(row.published_offset)]
    if not published:
        return None
    lengths = [row.difference for row in rows if row.unit == LENGTH and math.isfinite(row.difference)]
    parameters = {row.parameter: row for row in study.rows(ParameterRow, variant)}
    inside = []
    for row in published:
        one = parameters.get(f"{row.parameter}[{row.leg}]") or parameters.get(row.parameter)
        if one is not None:
            inside.append(one.q05 <= one.nominal + row.published_offset <= one.q95)
    return Published(_measure_rms(lengths), len(lengths), sum(inside), len(inside))


def _measure_rms(values: Iterable[float]) -> float:
    """Return the root mean square of the values that are there, NaN without any."""
    known = pd.Series(values, dtype=float).dropna()
    return float(np.sqrt(np.mean(np.square(known.to_numpy())))) if len(known) else math.nan


def name_table(study: StudyResults, variant: str) -> str:
    """Return which published table belongs to a variant, ``table 5(a)``; empty where nothing of it is published."""
    if not study.table("least_squares", variant)["published_offset"].notna().any():
        return ""
    return str((study.publication or {}).get("tables", {}).get(variant, ""))


def tabulate_published(study: StudyResults) -> Table | None:
    """Return the rms difference between least squares and the published tables: a row per model; None without any."""
    frame = study.table("least_squares")
    if not frame["published_offset"].notna().any():
        return None
    frame = frame[frame["difference"].notna()]
    columns, keys = [Column("Model", kind="text")], []
    for deformation in study.deformations:
        names = study.find(deformation=deformation)
        words = describe_deformation(deformation).removeprefix("with the ")
        numbers = {name_table(study, name).partition("(")[0] for name in names}
        title = f"{numbers.pop()}, {words}" if len(numbers) == 1 and "" not in numbers else words
        group = title[0].upper() + title[1:]
        rows = frame[frame["variant"].isin(names)]
        lengths = list(dict.fromkeys(rows[rows["unit"] == LENGTH]["parameter"]))
        if lengths:  # all together, every other symbol by itself
            scale, text = study.scale_of(lengths[0], LENGTH)
            letters = ", ".join(dict.fromkeys(symbol.partition("_")[0] for symbol in lengths))
            columns.append(Column(letters, text, group))
            keys.append((deformation, lengths, scale))
        others = rows[rows["unit"] != LENGTH].drop_duplicates("parameter")
        for symbol, unit in zip(others["parameter"], others["unit"], strict=True):
            scale, text = study.scale_of(symbol, unit)
            columns.append(Column(symbol, text, group, symbolic=True))
            keys.append((deformation, [symbol], scale))
    cells: list[list[str]] = []
    for model in study.models:
        row = [study.label_model(model)]
        for deformation, symbols, scale in keys:
            names = study.find(model, deformation)
            chosen = frame[frame["variant"].isin(names) & frame["parameter"].isin(symbols)]
            row.append(format_significant(scale * _measure_rms(chosen["difference"]), 2))
        cells.append(row)
    caption = "Least squares − published tables, rms over legs."
    return make_table(caption, columns, cells, list_remarks(study))


def list_remarks(study: StudyResults) -> list[Statement]:
    """Return published rows that are far smaller than those of all other models, as misprints would be."""
    frame = study.table("least_squares")[study.table("least_squares")["published_offset"].notna()]
    grouped = {(str(name), str(symbol)): rows for (name, symbol), rows in frame.groupby(["variant", "parameter"])}
    sizes = {key: _measure_rms(rows["published_offset"]) for key, rows in grouped.items()}
    remarks = []
    for (name, symbol), size in sizes.items():
        same = study.find(deformation=study.split(name)[1])
        others = [sizes[other, symbol] for other in same if other != name and (other, symbol) in sizes]
        if len(others) > 1 and 0 < size < ODD * min(others):
            remarks.append(_remark(study, name, symbol, [size / x for x in others], grouped[name, symbol]))
    return remarks


def _remark(study: StudyResults, name: str, symbol: str, shares: list[float], rows: pd.DataFrame) -> Statement:
    factor, unit = study.scale_of(symbol, str(rows["unit"].iloc[0]))
    unit = f"·{unit}" if unit.startswith("10") else f" {unit}"
    printed = factor * _measure_rms(rows["difference"])
    times_ten = factor * _measure_rms(rows["offset"] - MISPRINT * rows["published_offset"])
    table = name_table(study, name) or "the published table"
    text = (
        f"{write_symbol(symbol)} in {table}, {study.label(name)}: printed at {format_span(shares, 2)} "
        "of other models' size (rms)"
    )
    if times_ten < 0.5 * printed:
        text += (
            f"; tenfold values lie {format_significant(times_ten, 2)}{unit} rms from least squares, "
            f"printed ones {format_significant(printed, 2)}{unit}: perhaps another unit"
        )
    return Statement(f"{text}.", "warning")


# --- frames ----------------------------------------------------------------------------------------------------------


def show_frames(study: StudyResults) -> PageSection | None:
    """Return the frames found, and what was known of them; None where all were known."""
    rows = study.frames
    if rows.empty:
        return None
    columns = [VARIANT]
    cells = {name: [study.label(name)] for name in study.ranking}
    before = ["known before"]
    for symbol, several in rows.groupby("symbol", sort=False):
        chosen = several.set_index("variant")
        factor, unit = study.scale_of(str(symbol), str(chosen["unit"].iloc[0]))
        columns.append(Column(str(symbol), unit, symbolic=True))
        before.append(f"± {format_significant(factor * float(chosen['prior_sd'].iloc[0]), 2)}")
        places = min(4, count_decimals(factor * float(chosen["sd"].min())))
        for name in study.ranking:
            mean, sd = (factor * float(chosen[value].get(name, math.nan)) for value in ("mean", "sd"))
            cells[name].append(format_estimate(mean, sd, places, sign=True))
    caption = "Frames found, posterior mean ± sd."
    return PageSection("Frames", (make_table(caption, columns, [*cells.values(), before]),), anchor="frames")
