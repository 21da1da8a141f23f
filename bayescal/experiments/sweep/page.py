"""The page of a sweep: how good what was swept must be, figures against it, and every member."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import figure as mpl
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from bayescal.experiments.runner.results import Results, Summary
from bayescal.experiments.shared.headline import write_headline
from bayescal.experiments.sweep.compute import ALWAYS, FROM, MIXED, NEVER, UP_TO, group_others, is_scale, list_missing
from bayescal.experiments.sweep.rows import ROWS, SweepAnswerRow, SweepMemberRow
from bayescal.experiments.sweep.schema import AxisConfig, FigureConfig, SweepConfig
from bayescal.files.rows import check_tables
from bayescal.report.blocks import (
    Block,
    Cell,
    Column,
    Figure,
    Fold,
    KeyFigure,
    Level,
    Page,
    PageSection,
    Statement,
    make_section,
    make_table,
)
from bayescal.report.numbers import NO_VALUE, capitalise, format_count, format_plain, format_power
from bayescal.report.style import INK, LEG_COLOURS, MARKERS, RED

MOST_PICTURES = 24
MOST_ROWS = 500
MOST_SAID = 8
LEVELS: dict[str, Level] = {ALWAYS: "good", UP_TO: "good", FROM: "good", MIXED: "warning", NEVER: "bad"}
MOST_LINES = 8
MOST_TICKS = 9


def build_page(config: SweepConfig, results: Results) -> Page:
    """Return the page of a sweep's tables."""
    check_tables(ROWS, results.tables, results.folder or Path())
    members, answers, summary = results.table("members"), SweepAnswerRow.read(results.table("answers")), results.summary
    axes, figures = {axis.name: axis for axis in config.axes}, {figure.key: figure for figure in config.figures}
    said = [_state_answer(row, axes, figures) for row in answers]
    verdict = (*said[:MOST_SAID], *_state_members(summary))
    sections = (
        make_section("Figures", (), (), tuple(_list_pictures(config, members))),
        *_answer_section(answers, axes, figures),
        *_failed_section(config, members),
        _member_section(config, members),
    )
    facts = (("Experiment", summary["experiment"]), *((name_axis(axis), _span(axis)) for axis in config.axes))
    origin = f"Base config {summary['experiment']}; only listed keys vary."
    first = f"{said[0].lead}: {said[0].text}" if said else _state_span(config.figures[0], summary)
    return Page(
        "Sweep",
        config.name,
        config.title,
        origin,
        write_headline([first]),
        verdict,
        sections,
        facts,
        key_figures=_list_key_figures(config, answers, summary),
    )


def _list_key_figures(config: SweepConfig, answers: list[SweepAnswerRow], summary: Summary) -> tuple[KeyFigure, ...]:
    """Return how many members there are, failed and are required values, and the range of the first figure."""
    n, failed, figure = summary["n_members"], summary["n_failed"], config.figures[0]
    found, unsure = summary["figures"][figure.key], summary["n_not_converged"]
    kept = sum(row.extent != NEVER for row in answers)
    span = f"{format_power(found['min'], 3)} to {format_power(found['max'], 3)}" if "min" in found else NO_VALUE
    several = [
        KeyFigure("Members", format_count(n)),
        KeyFigure("Failed", format_count(failed), "", "bad" if failed == n else "warning" if failed else "good"),
        KeyFigure("Not converged", format_count(unsure), "", "warning" if unsure else "good"),
        KeyFigure(capitalise(figure.title), span, figure.unit),
    ]
    if answers:
        level: Level = "good" if kept == len(answers) else "warning" if kept else "bad"
        several.append(KeyFigure("Requirements kept somewhere", f"{kept} of {len(answers)}", "", level))
    return tuple(several)


# --- in words ----------------------------------------------------------------------------------------------------


def _state_answer(row: SweepAnswerRow, axes: dict[str, AxisConfig], figures: dict[str, FigureConfig]) -> Statement:
    """Return where along an axis a figure keeps what is required of it, at a setting of the other axes."""
    figure, axis = figures[row.figure], axes[row.axis]
    where = f" with {row.setting}" if row.setting else ""
    text = f"{_limit(figure)} met {_place(row, axis)}{where}."
    unit = axis.unit if axis.factors is None else "times"
    value = row.bound if row.extent in (UP_TO, FROM) else math.nan
    return Statement(text, LEVELS[row.extent], capitalise(figure.title), value=value, unit=unit)


def _limit(figure: FigureConfig) -> str:
    return f"{figure.side} {format_plain(figure.limit or 0.0)} {figure.unit}".rstrip()


def _place(row: SweepAnswerRow, axis: AxisConfig) -> str:
    name = axis.title
    if row.extent in (ALWAYS, NEVER):
        return f"{row.extent} along {name}"
    if row.extent == MIXED:
        return f"in places along {name}"
    unit = f" {axis.unit}" if axis.unit and axis.factors is None else " times" if axis.factors is not None else ""
    return f"{row.extent} {name} {format_plain(row.bound, 3)}{unit}"


def _state_span(figure: FigureConfig, summary: Summary) -> str:
    found = summary["figures"][figure.key]
    if "min" not in found:
        return f"No results for {figure.title} in {format_count(summary['n_members'])} members"
    return (
        f"{capitalise(figure.title)} from {format_power(found['min'], 3)} to {format_power(found['max'], 3)} "
        f"{figure.unit}".rstrip()
    )


def _state_members(summary: Summary) -> Iterator[Statement]:
    """Yield what became of the members, and figures that no summary has."""
    n, failed, unsure = summary["n_members"], summary["n_failed"], summary["n_not_converged"]
    text = f"{format_count(n)} members ({format_count(summary['n_distinct'])} distinct): {format_count(failed)} failed"
    text += f", {format_count(unsure)} did not converge."
    level: Level = "bad" if failed == n else "warning" if failed or unsure else "plain"
    yield Statement(text, level, "Members", value=failed + unsure, limit=0.0)
    for key in list_missing(summary):
        yield Statement(f"No results for {key}.", "bad", "Missing")


def _span(axis: AxisConfig) -> str:
    taken = axis.settings
    if all(isinstance(one, int | float) and not isinstance(one, bool) for one in taken):
        return f"{len(taken)}, {format_plain(min(taken))} to {format_plain(max(taken))}"
    return ", ".join(map(str, taken[:6])) + (f" and {len(taken) - 6} more" if len(taken) > 6 else "")


# --- sections ----------------------------------------------------------------------------------------------------


def _answer_section(
    answers: list[SweepAnswerRow], axes: dict[str, AxisConfig], figures: dict[str, FigureConfig]
) -> Iterator[PageSection]:
    if not answers:
        return
    columns = [Column(title, kind="text") for title in ("Required", "Along", "With", "Met")]
    columns += [Column(title) for title in ("Bound", "Met at", "Not met at")]
    rows: list[list[str | Cell]] = [
        [
            f"{figures[row.figure].title} {_limit(figures[row.figure])}",
            name_axis(axes[row.axis]),
            row.setting or NO_VALUE,
            Cell(row.extent, LEVELS[row.extent]),
            *(_number(row.bound, 3), _number(row.met_at, 4), _number(row.failed_at, 4)),
        ]
        for row in answers
    ]
    table = make_table("Where requirements are met (interpolated).", columns, rows)
    yield make_section("Required values", (), (table,))


def _list_pictures(config: SweepConfig, members: pd.DataFrame) -> Iterator[Figure]:
    """Yield a picture of each figure against each axis of numbers, the first ones where there are many."""
    pairs = [
        (k, figure, n, axis)
        for k, figure in enumerate(config.figures, 1)
        for n, axis in enumerate(config.axes, 1)
        if is_scale(axis, members[axis.name]) and members[figure.key].dtype.kind == "f"
    ]
    for k, figure, n, axis in pairs[:MOST_PICTURES]:
        name, caption = f"figure_{k}_axis_{n}", f"{name_figure(figure)} against {name_axis(axis)}."
        if members[figure.key].notna().any():
            yield Figure(name, caption, partial(draw_against, config, members, figure, axis))
        else:
            yield Figure(name, caption, None, "no results")


def _failed_section(config: SweepConfig, members: pd.DataFrame) -> Iterator[PageSection]:
    bad = members[members["reason"] != ""]
    if bad.empty:
        return
    columns = [*(Column(name_axis(axis), kind="text") for axis in config.axes), *_texts("State", "Reason")]
    rows: list[list[str]] = [
        [*(_cell(row.others[axis.name]) for axis in config.axes), row.state, row.reason]
        for row in SweepMemberRow.read(bad.head(MOST_ROWS))
    ]
    yield make_section("Failed members", (), (make_table(_head("failed, or not converged", bad), columns, rows),))


def _member_section(config: SweepConfig, members: pd.DataFrame) -> PageSection:
    names = [*(axis.name for axis in config.axes), *(figure.key for figure in config.figures)]
    columns = [Column(title) for title in (*map(name_axis, config.axes), *map(name_figure, config.figures))]
    rows = [
        [*(_cell(row.others[name]) for name in names), row.state]
        for row in SweepMemberRow.read(members.head(MOST_ROWS))
    ]
    table = make_table(_head("Every member", members), [*columns, *_texts("State")], rows, style="wide")
    blocks: tuple[Block, ...] = (Fold(f"{format_count(len(members))} members", (table,)),)
    return PageSection("Runs", blocks)


def _texts(*titles: str) -> list[Column]:
    return [Column(title, kind="text") for title in titles]


def _head(caption: str, rows: pd.DataFrame) -> str:
    return f"{caption}." if len(rows) <= MOST_ROWS else f"{caption}; the first {MOST_ROWS}, all in members.csv."


def _cell(value: object) -> str:
    return _number(value, 4) if isinstance(value, float) else str(value) or NO_VALUE


def _number(value: float, digits: int) -> str:
    return NO_VALUE if value != value else format_plain(value, digits)


def name_axis(axis: AxisConfig) -> str:
    """Return an axis with its unit, factors said to be such."""
    unit = axis.unit if axis.factors is None else "times"
    return f"{axis.title}{f' ({unit})' if unit else ''}"


def name_figure(figure: FigureConfig) -> str:
    """Return a figure with its unit."""
    return f"{figure.title}{f' ({figure.unit})' if figure.unit else ''}"


def draw_against(config: SweepConfig, members: pd.DataFrame, figure: FigureConfig, axis: AxisConfig) -> mpl.Figure:
    """Return a figure of all members against an axis, with what is required of it."""
    drawn = mpl.Figure(figsize=(9.0, 4.2))
    axes = drawn.subplots()
    known = members[np.isfinite(members[figure.key])]
    lines = list(group_others(config, known, axis))
    if len(lines) <= MOST_LINES:
        _draw_lines(axes, lines, axis.name, figure.key)
    else:
        _draw_spread(axes, known, axis.name, figure.key)
    if figure.limit is not None:
        label = f"{figure.side} {format_plain(figure.limit)}"
        axes.axhline(figure.limit, color=RED, linewidth=1.0, linestyle="--", label=label)
    _scale(axes, known, figure, axis)
    axes.set_xlabel(name_axis(axis))
    axes.set_ylabel(name_figure(figure))
    axes.grid()
    if axes.get_legend_handles_labels()[0]:
        drawn.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=4)
    return drawn


def _draw_lines(axes: Axes, lines: list[tuple[str, pd.DataFrame]], x: str, y: str) -> None:
    """Draw a line for each setting; of repeats the median, and from their least to their most."""
    for k, (label, rows) in enumerate(lines):
        colour, marker = LEG_COLOURS[k % len(LEG_COLOURS)], MARKERS[k % len(MARKERS)]
        repeats = rows.groupby(x)[y]
        middle = repeats.median()
        axes.plot(middle.index, middle, label=label or None, linewidth=1.2, markersize=4.5, color=colour, marker=marker)
        if repeats.size().max() > 1:
            axes.fill_between(middle.index, repeats.min(), repeats.max(), color=colour, alpha=0.2, linewidth=0.0)


def _draw_spread(axes: Axes, known: pd.DataFrame, x: str, y: str) -> None:
    """Draw the median over all other settings, and from their least to their most."""
    groups = known.groupby(x)[y]
    middle, least, most = groups.median(), groups.min(), groups.max()
    axes.fill_between(middle.index, least, most, color=LEG_COLOURS[1], alpha=0.3, linewidth=0.0, label="least to most")
    axes.plot(middle.index, middle, "-o", color=LEG_COLOURS[4], linewidth=1.4, markersize=4.5, label="median")


def _say_minor(value: float, _: object) -> str:
    """Return a number between two powers of ten where it is twice or five times the lower one."""
    return format_plain(value) if f"{value:.0e}"[0] in "25" else ""


def _scale(axes: Axes, known: pd.DataFrame, figure: FigureConfig, axis: AxisConfig) -> None:
    """Set logarithmic scales where they are asked for and all numbers have logarithms; ticks where values are few."""
    if figure.scale == "log" and len(known) and known[figure.key].min() > 0.0:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
        axes.yaxis.set_minor_formatter(FuncFormatter(_say_minor))
    if axis.scale == "log" and len(known) and known[axis.name].min() > 0.0:
        axes.set_xscale("log")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    taken = np.unique(known[axis.name])
    if len(taken) <= MOST_TICKS:
        axes.set_xticks(taken, [format_plain(value, 4) for value in taken])
    axes.tick_params(colors=INK)
