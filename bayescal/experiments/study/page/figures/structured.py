"""The structured model error of every leg along the actuator that tells most of it."""

from __future__ import annotations

import math

import pandas as pd
from matplotlib.figure import Figure

from bayescal.report.style import GREY, INK

COLUMNS = 3


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
