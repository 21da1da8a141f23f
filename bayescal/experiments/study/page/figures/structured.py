"""The structured model error: its slopes, its size, and its course along the actuator that tells most of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bayescal.report.numbers import format_fixed
from bayescal.report.style import GREY, INK

COLUMNS = 3
PALE = 0.55  # share of the colours' range up to which dark numbers are read


def draw_slopes(one: dict[str, Any]) -> Figure:
    """Return the matrix of slopes, leg by actuator, and the size of each leg's error.

    Parameters
    ----------
    one : mapping
        ``slope_um`` and ``slope_sd_um``, N rows of N numbers, and ``rms_um`` with ``mean``, ``q05`` and ``q95``.
    """
    slopes, sd = np.array(one["slope_um"]), np.array(one["slope_sd_um"])
    n_legs = len(slopes)
    figure = Figure(figsize=(9.4, 0.9 + 0.36 * n_legs))
    left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": (2.2, 1.0)})
    top = float(np.abs(slopes).max()) or 1.0
    left.imshow(slopes, cmap="RdBu_r", vmin=-top, vmax=top, aspect="auto")
    for i, j in np.ndindex(*slopes.shape):
        text = f"{format_fixed(float(slopes[i, j]), 0, sign=True)} ± {format_fixed(float(sd[i, j]), 0)}"
        colour = INK if abs(slopes[i, j]) < PALE * top else "white"
        left.text(j, i, text, ha="center", va="center", fontsize=8, color=colour)
    left.set_xticks(range(n_legs), [f"actuator {k + 1}" for k in range(n_legs)])
    left.set_yticks(range(n_legs), [f"leg {k + 1}" for k in range(n_legs)])
    left.tick_params(length=0)
    left.spines[:].set_visible(False)
    left.set_title("Error with the actuator at the end of its range (µm)")
    mean, low, high = (np.array(one["rms_um"][key]) for key in ("mean", "q05", "q95"))
    right.errorbar(mean, range(n_legs), xerr=[mean - low, high - mean], fmt="o", color=INK, markersize=4)
    right.set_ylim(n_legs - 0.5, -0.5)
    right.set_yticks(range(n_legs), [f"leg {k + 1}" for k in range(n_legs)])
    right.set_xlim(left=0.0)
    right.grid(axis="x")
    right.set_title("Size over the poses (µm, rms)")
    return figure


def draw_structured(rows: pd.DataFrame) -> Figure:
    """Return a panel per leg: error in µm with its 90 % interval against the travel of one actuator.

    Parameters
    ----------
    rows : DataFrame
        Of one variant, with the columns of the table ``structured``.
    """
    legs = sorted(set(rows["leg"]))
    n_rows = math.ceil(len(legs) / COLUMNS)
    figure = Figure(figsize=(9.4, 0.4 + 1.9 * n_rows))
    grid = figure.subplots(n_rows, COLUMNS, squeeze=False, sharey=True).ravel()
    for axes, leg in zip(grid, legs, strict=False):
        own = rows[rows["leg"] == leg]
        for use, filled in (("calibration", True), ("verification", False)):
            part = own[own["use"] == use]
            around = [part["mean_um"] - part["low_um"], part["high_um"] - part["mean_um"]]
            axes.errorbar(
                part["travel_mm"],
                part["mean_um"],
                [one.clip(lower=0.0) for one in around],
                fmt="o",
                color=INK,
                ecolor=GREY,
                markersize=3.5,
                markerfacecolor=INK if filled else "white",
                linewidth=0.8,
            )
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set_title(f"leg {leg}")
        axes.set_xlabel(f"travel of actuator {int(own['actuator'].iloc[0])} (mm)")
    for axes in grid[::COLUMNS]:
        axes.set_ylabel("error (µm)")
    for axes in grid[len(legs) :]:
        axes.set_axis_off()
    return figure
