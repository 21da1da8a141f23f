"""Figures of what to measure with: sets of sensors, numbers of poses."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from bayescal.report.numbers import format_plain
from bayescal.report.style import GREY, INK, LEG_COLOURS, MARKERS, PALE, RED
from bayescal.report.symbols import Asked, quote, shown_in

BEST = LEG_COLOURS[4]
HALVED = 0.75  # contraction that halves a tolerance
CROWDED = 40  # parameters, beyond which their names are smaller
SHOWN = 1e3  # times the best error, above which sets are left out of the picture


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
        axes.axhline(1.0, color=RED, linewidth=0.9, label="standard deviation equal to the limit")
    _scale_log(axes, "y")
    axes.set_ylabel("Largest sd as a share of its limit" if required else "Error, lengths together")
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
