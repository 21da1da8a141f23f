"""Figures of an audit: sets of sensors, counts of poses."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayescal.experiments.calibration.page.verdict import shown_in
from bayescal.report.style import GREY, INK, LEG_COLOURS, MARKERS, PALE, RED
from bayescal.report.symbols import quote

BEST = LEG_COLOURS[4]
SHOWN = 1e3  # times the best error, above which sets are left out of the picture


def draw_sets(sets: pd.DataFrame, best: pd.DataFrame, required: bool) -> Figure:
    """Return the error of every set of sensors against their number, the best of each joined."""
    figure = Figure(figsize=(8.4, 4.0))
    axes = figure.subplots()
    good = sets[sets["goal"] < SHOWN * best["goal"].min()]
    shift = 0.5 * (((0.618034 * np.arange(len(good))) % 1.0) - 0.5)
    axes.plot(good["n_sensors"] + shift, good["goal"], ".", color=PALE, markersize=5.0, label="a set of sensors")
    axes.plot(best["n_sensors"], best["goal"], "-o", color=BEST, markersize=5.0, label="best of each number")
    if required:
        axes.axhline(1.0, color=RED, linewidth=0.9, label="what is required")
    axes.set_yscale("log")
    axes.set_ylabel("Largest share of a limit" if required else "Error, lengths together")
    axes.set_xlabel("Number of sensors")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(axis="y")
    axes.legend(loc="upper right")
    return figure


def draw_counts(counts: pd.DataFrame, enough: int) -> Figure:
    """Return the error of each coordinate against the number of poses, chosen and at random."""
    names = [str(name).removeprefix("after_") for name in counts.columns if str(name).startswith("after_")]
    units = list(dict.fromkeys(name.rpartition("_")[2] for name in names))
    figure = Figure(figsize=(8.4, 3.8))
    for axes, unit in zip(np.atleast_1d(figure.subplots(1, len(units))), units, strict=True):
        factor, shown = shown_in(unit)
        for k, name in enumerate(one for one in names if one.rpartition("_")[2] == unit):
            colour, label = LEG_COLOURS[(k + 4) % 6], quote(name.rpartition("_")[0])
            marker = MARKERS[k % len(MARKERS)]
            axes.plot(
                counts["n_poses"], factor * counts[f"after_{name}"], "-", marker=marker, color=colour, label=label
            )
            axes.plot(counts["n_poses"], factor * counts[f"random_{name}"], ":", color=colour)
        axes.plot([], [], ":", color=GREY, label="at random")
        axes.axvline(enough, color=INK, linewidth=0.8, linestyle="--")
        axes.set_yscale("log")
        axes.set_xlabel("Number of poses; beyond the dashed line more hardly pay")
        axes.set_ylabel(f"rms over the workspace ({shown})" if shown else "rms over the workspace")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(axis="y")
        axes.legend(loc="upper right")
    return figure
