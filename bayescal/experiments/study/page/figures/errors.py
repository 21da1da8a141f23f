"""Pose errors of the models, a figure per deformation (RR-8096 figures 15 to 17), and errors against their bounds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from bayescal.experiments.study.page.results import SETTINGS, ErrorScale
from bayescal.experiments.study.page.styles import Styles
from bayescal.report.numbers import MICROMETRES, format_plain, format_significant
from bayescal.report.style import GREY, INK, RED

SHADES = {"calibration": 0.85, "verification": 0.35}
WIDTH = 0.38
CROWDED = 4  # variants beyond which labels and numbers stand aslant
MARGINS = {"left": 0.065, "right": 0.995, "bottom": 0.11, "top": 0.89, "wspace": 0.16}
CROWDED_MARGINS = MARGINS | {"bottom": 0.34, "top": 0.93}
SLANTED: dict[str, Any] = {"rotation": 25, "ha": "right", "rotation_mode": "anchor", "fontsize": 7}
BOUND = "position_bound_95_mm"


def draw_error_bars(
    predictions: pd.DataFrame, scales: Sequence[ErrorScale], variants: Sequence[str], styles: Styles, title: str
) -> Figure:
    """Return bars of some variants: as high as the largest error, a line at the mean.

    Parameters
    ----------
    predictions : DataFrame
        Rows of all variants of the study, from which all such figures take the same axes.
    scales : sequence of ErrorScale
        Of the errors that were measured.
    variants : sequence of str
        From left to right: the variants of one deformation, or of one model.
    styles : mapping
    title : str
    """
    crowded = len(variants) > CROWDED
    figure = Figure(figsize=(9.4, 3.6 if crowded else 2.2))
    figure.set_layout_engine("none")  # fixed margins take half the time
    frame = predictions[predictions["model_error"] == "free"]
    uses = [use for use in SHADES if (frame["use"] == use).any()]
    panels = figure.subplots(1, len(scales), gridspec_kw=CROWDED_MARGINS if crowded else MARGINS, squeeze=False)[0]
    models, deformations = ({getattr(styles[name], what) for name in variants} for what in ("model", "deformation"))
    by_model = len(models) > 1 and len(deformations) == 1
    labels = [styles[name].model if by_model else styles[name].label for name in variants]
    for axes, scale in zip(panels, scales, strict=True):
        errors = scale.factor * frame.groupby(["variant", "use"])[scale.column].agg(["mean", "max"])
        for k, name in enumerate(variants):
            for use, side in zip(uses, (-1, 1) if len(uses) > 1 else (0,), strict=True):
                mean, largest = (float(errors[what][name, use]) for what in ("mean", "max"))
                _draw_bar(axes, k, side, mean, largest, styles[name].colour, SHADES[use], crowded)
        axes.set_ylim(0, (1.35 if crowded else 1.3) * float(errors["max"].max()) or 1.0)
        axes.set_xlim(-0.6, max(len(variants), 3) - 0.4)
        axes.set_xticks(range(len(variants)), labels, **(SLANTED if crowded else {}))
        axes.tick_params(axis="x", length=0)
        axes.set_ylabel(scale.label)
        axes.grid(axis="y")
    colours = {styles[name].colour for name in variants}
    colour = colours.pop() if len(colours) == 1 else GREY
    panels[0].set_title(title)
    panels[-1].legend(
        handles=[Patch(color=colour, alpha=SHADES[use], linewidth=0, label=f"{use} poses") for use in uses],
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=2,
        borderaxespad=0.0,
    )
    return figure


def _draw_bar(
    axes: Axes, place: float, side: int, mean: float, largest: float, colour: str, shade: float, upright: bool
) -> None:
    """Draw a bar left (-1) or right (1) of a place or on it (0); its numbers reach away from its neighbour, or up."""
    centre = place + 0.5 * side * WIDTH
    axes.bar(centre, largest, width=0.94 * WIDTH, color=colour, alpha=shade, linewidth=0)
    axes.hlines(mean, centre - 0.47 * WIDTH, centre + 0.47 * WIDTH, color=INK, linewidth=1.6)
    numbers = format_significant(mean, 2), format_significant(largest, 2)
    if upright:
        text = "/".join(numbers)
        axes.annotate(text, (centre, largest), (0, 2), textcoords="offset points", ha="center", fontsize=6, rotation=90)
        return
    align, text = {-1: "right", 0: "center", 1: "left"}[side], "/\n".join(numbers)  # in degrees they are long
    axes.annotate(text, (place, largest), (3 * side, 2), textcoords="offset points", ha=align, fontsize=7)


def draw_bounds(predictions: pd.DataFrame, variants: Sequence[str], styles: Styles) -> Figure:
    """Return every pose's position error in units of its 95 % bound: a row per variant, a column per setting."""
    figure = Figure(figsize=(9.4, 0.8 + 0.265 * len(variants)))
    grid = figure.subplots(1, 2, sharex=True, sharey=True)
    ratio = predictions["position_error_mm"] / predictions[BOUND]
    frame = predictions.assign(ratio=ratio.clip(lower=1e-6))
    for axes, (setting, words) in zip(grid, SETTINGS.items(), strict=True):
        for k, name in enumerate(variants):
            rows = frame[(frame["variant"] == name) & (frame["model_error"] == setting)]
            _draw_strip(axes, rows, k, styles[name].colour)
        axes.axvline(1.0, color=INK, linewidth=0.9)
        axes.set_title(f"{words[0].upper()}{words[1:]}")
        axes.set_xlabel("Position error / its 95 % bound")
        axes.grid(axis="x")
        axes.tick_params(axis="y", length=0)
    low, high = max(0.002, 0.7 * frame["ratio"].min()), 1.25 * max(1.0, frame["ratio"].max())
    grid[0].set_xscale("log")  # shared
    grid[0].set_xlim(low, high)
    grid[0].xaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    grid[0].set_yticks(range(len(variants)), [styles[name].label for name in variants])
    grid[0].set_ylim(len(variants) - 0.5, -0.5)
    return figure


def _draw_strip(axes: Axes, rows: pd.DataFrame, k: int, colour: str) -> None:
    """Draw one variant's poses; their order in the survey spreads them over the row's height."""
    ratio = rows["ratio"].to_numpy()
    height = k + 0.56 * ((np.arange(len(rows)) + 0.5) / max(len(rows), 1) - 0.5)
    held = (rows["use"] == "verification").to_numpy()
    for chosen, fill in ((~held, colour), (held, "white")):
        axes.plot(
            ratio[chosen], height[chosen], "o", markersize=3.2, color=fill, markeredgecolor=colour, markeredgewidth=0.8
        )
    beyond = int((ratio > 1).sum())
    expected = 0.05 * len(rows)
    bound = format_significant(MICROMETRES * float(rows[BOUND].median()), 2)
    axes.annotate(
        f"{beyond} of {len(rows)} beyond, bound {bound} µm",
        (1.02, k),
        xycoords=("axes fraction", "data"),
        va="center",
        fontsize=7.5,
        color=INK if beyond <= expected + 2 * math.sqrt(0.95 * expected) else RED,
    )
    axes.axhline(k + 0.5, color=GREY, linewidth=0.3, alpha=0.4)
