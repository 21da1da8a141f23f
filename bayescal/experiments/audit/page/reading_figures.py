"""Figures of an audit: contraction, requirements, sets of sensors, counts of poses."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from bayescal.report.numbers import format_plain
from bayescal.report.style import GREY, INK, LEG_COLOURS, MARKERS, PALE, RED
from bayescal.report.symbols import quote
from bayescal.report.units import Asked, shown_in

BEST = LEG_COLOURS[4]
HALVED = 0.75  # contraction that halves a tolerance
CROWDED = 40  # parameters, beyond which their names are smaller
SHOWN = 1e3  # times the best error, above which sets are left out of the picture


def draw_contraction(parameters: pd.DataFrame, titles: dict[str, str]) -> Figure:
    """Return the contraction of every parameter as bars, sets of sensors below each other."""
    names = list(dict.fromkeys(str(name) for name in parameters["parameter"]))
    figure = Figure(figsize=(9.4, 0.9 + 1.25 * len(titles)))
    rows = np.atleast_1d(figure.subplots(len(titles), 1, sharex=True))
    for k, (axes, (variant, title)) in enumerate(zip(rows, titles.items(), strict=True)):
        mine = parameters[parameters["variant"] == variant]
        place = [names.index(str(name)) for name in mine["parameter"]]
        axes.bar(place, mine["contraction"], color=LEG_COLOURS[(k + 4) % 6], width=0.7)
        axes.axhline(HALVED, color=GREY, linewidth=0.8)
        axes.set_ylim(0.0, 1.0)
        axes.set_title(quote(title))
        axes.grid(axis="y")
    rows[-1].set_xticks(range(len(names)), [quote(name) for name in names], rotation=60)
    rows[-1].tick_params(axis="x", labelsize=8.0 if len(names) <= CROWDED else 6.0)
    figure.supylabel("Contraction", fontsize=9.0)
    return figure


def draw_requirements(requirements: pd.DataFrame, titles: dict[str, str]) -> Figure:
    """Return errors over their limits, one line a set of sensors and coordinate: before, after, at the worst pose."""
    figure = Figure(figsize=(8.4, 1.3 + 0.3 * len(requirements)))
    axes = figure.subplots()
    place = np.arange(len(requirements))[::-1]
    limit = requirements["limit"]
    before, after = requirements["before"] / limit, requirements["error"] / limit
    axes.hlines(place, after, before, color=PALE, linewidth=2.0)
    axes.plot(before, place, "o", color=GREY, markersize=5.0, mfc="none", label="before, rms")
    for met, colour in ((True, BEST), (False, RED)):
        mine = (requirements["met"] == met).to_numpy()
        if mine.any():
            label = "after, rms" if met else "after, rms, too much"
            axes.plot(after[mine], place[mine], "o" if met else "D", color=colour, markersize=5.5, label=label)
    axes.plot(requirements["worst"] / limit, place, "|", color=INK, markersize=9.0, label="after, at the worst pose")
    axes.axvline(1.0, color=RED, linewidth=0.9)
    lines = zip(requirements["variant"], requirements["coordinate"], strict=True)
    axes.set_yticks(place, [quote(f"{titles[str(variant)]}: {coordinate}") for variant, coordinate in lines])
    _scale_log(axes, "x")
    axes.set_xlabel("Error over its limit")
    axes.grid(axis="x")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def draw_sets(sets: pd.DataFrame, best: pd.DataFrame, required: bool, against: str = "number") -> Figure:
    """Return the error of every set of sensors against their number or price, the best of each joined."""
    figure = Figure(figsize=(8.4, 4.0))
    axes = figure.subplots()
    good = sets[(sets["goal"] < SHOWN * best["goal"].min()) & ~sets["sensors"].isin(best["sensors"])]
    by_number = against == "number"
    column, shift = (
        ("n_sensors", 0.3 * (((0.618034 * np.arange(len(good))) % 1.0) - 0.5)) if by_number else ("price", 0.0)
    )
    axes.plot(good[column] + shift, good["goal"], ".", color=PALE, markersize=5.0, label="another set")
    axes.plot(best[column], best["goal"], "-o", color=BEST, markersize=5.0, label=f"best of each {against}")
    if required:
        axes.axhline(1.0, color=RED, linewidth=0.9, label="what is required")
    _scale_log(axes, "y")
    axes.set_ylabel("Largest share of a limit" if required else "Error, lengths together")
    axes.set_xlabel("Number of sensors" if by_number else "Price")
    axes.xaxis.set_major_locator(MaxNLocator(integer=by_number))
    axes.grid(axis="y")
    axes.legend(loc="upper right")
    return figure


def draw_counts(counts: pd.DataFrame, enough: int, asked: Asked) -> Figure:
    """Return the error of each coordinate against the number of poses, chosen and at random."""
    names = [str(name).removeprefix("after_") for name in counts.columns if str(name).startswith("after_")]
    units = list(dict.fromkeys(name.rpartition("_")[2] for name in names))
    figure = Figure(figsize=(8.4, 3.8))
    for axes, unit in zip(np.atleast_1d(figure.subplots(1, len(units))), units, strict=True):
        factor, shown = shown_in(unit, asked)
        for k, name in enumerate(one for one in names if one.rpartition("_")[2] == unit):
            colour, label = LEG_COLOURS[(k + 4) % 6], quote(name.rpartition("_")[0])
            marker = MARKERS[k % len(MARKERS)]
            axes.plot(
                counts["n_poses"], factor * counts[f"after_{name}"], "-", marker=marker, color=colour, label=label
            )
            axes.plot(counts["n_poses"], factor * counts[f"random_{name}"], ":", color=colour)
        axes.plot([], [], ":", color=GREY, label="at random")
        if flat := enough < counts["n_poses"].max():
            axes.axvline(enough, color=INK, linewidth=0.8, linestyle="--")
        _scale_log(axes, "y")
        axes.set_xlabel(f"Number of poses{'; beyond the dashed line more hardly pay' if flat else ''}")
        axes.set_ylabel(f"rms over the workspace ({shown})" if shown else "rms over the workspace")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(axis="y")
        axes.legend(loc="upper right")
    return figure


def _scale_log(axes: Axes, which: Literal["x", "y"]) -> None:
    """Make an axis logarithmic, its ticks plain numbers, several in a decade."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    axes.set(**{f"{which}scale": "log"})
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    axis.set_minor_formatter(NullFormatter())
