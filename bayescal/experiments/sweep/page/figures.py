"""Pictures of a sweep: a figure against what was swept, a line for each setting of the rest, or their spread."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from bayescal.experiments.sweep.answers import group_others
from bayescal.experiments.sweep.schema import AxisConfig, FigureConfig, SweepConfig
from bayescal.report.numbers import format_plain
from bayescal.report.style import INK, LEG_COLOURS, MARKERS, RED

MOST_LINES = 8
MOST_TICKS = 9


def name_axis(axis: AxisConfig) -> str:
    """Return an axis with its unit, factors said to be such."""
    unit = axis.unit if axis.factors is None else "times"
    return f"{axis.label or axis.name}{f' ({unit})' if unit else ''}"


def name_figure(figure: FigureConfig) -> str:
    """Return a figure with its unit."""
    return f"{figure.label or figure.key}{f' ({figure.unit})' if figure.unit else ''}"


def draw_against(config: SweepConfig, members: pd.DataFrame, figure: FigureConfig, axis: AxisConfig) -> Figure:
    """Return a figure of all members against an axis, with what is required of it."""
    drawn = Figure(figsize=(9.0, 4.2))
    axes = drawn.subplots()
    known = members[np.isfinite(members[figure.key])]
    lines = list(group_others(config, known, axis))
    if len(lines) <= MOST_LINES:
        _draw_lines(axes, lines, axis.name, figure.key)
    else:
        _draw_spread(axes, known, axis.name, figure.key)
    _draw_limit(axes, figure)
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


def _draw_limit(axes: Axes, figure: FigureConfig) -> None:
    limit = figure.at_most if figure.at_most is not None else figure.at_least
    if limit is not None:
        word = "at most" if figure.at_most is not None else "at least"
        axes.axhline(limit, color=RED, linewidth=1.0, linestyle="--", label=f"{word} {format_plain(limit)}")


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
