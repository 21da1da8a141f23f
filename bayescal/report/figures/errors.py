"""Pose errors of the variants: bars as in RR-8096 figures 15 to 17, and every pose with its predictive bound."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from bayescal.report.figures.style import GREY, INK, PALE, VariantStyle, assign_styles
from bayescal.report.numbers import ARCSECONDS, MICROMETRES, format_significant
from bayescal.report.results import SETTINGS

QUANTITIES = (
    ("position_error_mm", MICROMETRES, "Position error (µm)"),
    ("orientation_error_deg", ARCSECONDS, "Orientation error (arcsec)"),
)
BOUND = "position_bound_95_mm"


def draw_error_bars(predictions: pd.DataFrame, variants: Sequence[str]) -> Figure:
    """Return bars of the largest error with the mean in them, for each use of the poses and each quantity.

    Parameters
    ----------
    predictions : DataFrame
        Rows of all variants, settings of the model error and poses.
    variants : sequence of str
        From top to bottom.
    """
    uses = [use for use in ("calibration", "verification") if (predictions["use"] == use).any()]
    figure = Figure(figsize=(9.4, 0.55 + len(uses) * (0.55 + 0.30 * len(variants))))
    grid = figure.subplots(len(uses), 2, sharex="col", sharey=True, squeeze=False)
    styles = assign_styles(variants)
    for axes, (column, factor, _) in zip(grid[0], QUANTITIES, strict=True):
        axes.set_xlim(0, 1.2 * factor * predictions[column].max())  # shared by the column
    for row, use in zip(grid, uses, strict=True):
        for axes, (column, factor, label) in zip(row, QUANTITIES, strict=True):
            _draw_bars(axes, predictions[predictions["use"] == use], column, factor, styles)
            axes.set_title(f"{use.capitalize()} poses")
            if use == uses[-1]:
                axes.set_xlabel(label)
    return figure


def _draw_bars(
    axes: Axes, predictions: pd.DataFrame, column: str, factor: float, styles: dict[str, VariantStyle]
) -> None:
    for k, (name, style) in enumerate(styles.items()):
        of_variant = predictions[predictions["variant"] == name]
        free, zero = (factor * of_variant[of_variant["model_error"] == s][column].to_numpy(float) for s in SETTINGS)
        mean, largest = free.mean(), free.max()
        axes.barh(k, largest, height=0.62, color=style.colour, alpha=0.35, linewidth=0)
        axes.barh(k, mean, height=0.62, color=style.colour, linewidth=0)
        text = f"{format_significant(mean, 2)} / {format_significant(largest, 2)}"
        axes.annotate(text, (largest, k), (4, 0), textcoords="offset points", va="center", fontsize=8)
        axes.plot(zero.mean(), k, marker="D", markersize=4, color="white", markeredgecolor=INK, markeredgewidth=0.8)
    axes.set_yticks(range(len(styles)), [style.label for style in styles.values()])
    axes.set_ylim(len(styles) - 0.5, -0.5)
    axes.grid(axis="x")
    axes.tick_params(axis="y", length=0)


def draw_bounds(predictions: pd.DataFrame, variants: Sequence[str]) -> Figure:
    """Return every pose's position error with its 95 % bound: a row per variant, a column per setting."""
    figure = Figure(figsize=(9.4, 0.7 + 1.35 * len(variants)))
    grid = figure.subplots(len(variants), 2, sharex=True, sharey=True, squeeze=False)
    styles = assign_styles(variants)
    for row, name in zip(grid, variants, strict=True):
        for axes, (setting, words) in zip(row, SETTINGS.items(), strict=True):
            chosen = (predictions["variant"] == name) & (predictions["model_error"] == setting)
            _draw_poses(axes, predictions[chosen], styles[name])
            axes.set_title(f"{styles[name].label}, {words}", fontsize=8.5)
    for axes in grid[-1]:
        axes.set_xlabel("Pose, in the order of the survey")
    values = MICROMETRES * predictions[["position_error_mm", BOUND]].to_numpy()
    grid[0, 0].set_yscale("log")  # shared
    grid[0, 0].set_ylim(0.7 * values[values > 0].min(), 1.5 * values.max())
    grid[0, 0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    figure.supylabel("Position error (µm)", fontsize=9)
    return figure


def _draw_poses(axes: Axes, rows: pd.DataFrame, style: VariantStyle) -> None:
    number = np.arange(1, len(rows) + 1)
    error = MICROMETRES * rows["position_error_mm"].to_numpy()
    bound = MICROMETRES * rows[BOUND].to_numpy()
    held = (rows["use"] == "verification").to_numpy()
    outside = error > bound
    axes.vlines(number, 1e-9, bound, color=PALE, linewidth=2.0)
    axes.plot(number, bound, linestyle="none", marker="_", markersize=5, color=GREY)
    for use, fill in ((~held, style.colour), (held, "white")):
        axes.plot(
            number[use],
            error[use],
            linestyle="none",
            marker="o",
            markersize=3.6,
            color=fill,
            markeredgecolor=style.colour,
        )
    axes.plot(
        number[outside], error[outside], linestyle="none", marker="x", markersize=6, color=INK, markeredgewidth=1.1
    )
    axes.grid(axis="y")
