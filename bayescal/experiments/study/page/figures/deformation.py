"""Deflection of the platform at the joints against the travel of the actuators (RR-8096 figure 7)."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayescal.report.numbers import format_estimate
from bayescal.report.style import INK, leg_colour


def draw_deflections(ring: pd.DataFrame, deformation: pd.DataFrame) -> Figure:
    """Return the measured deflection of each leg's joint against its own actuator, with the linear fit."""
    legs = sorted(set(ring["leg"]))
    n_columns = min(3, len(legs))
    n_rows = math.ceil(len(legs) / n_columns)
    figure = Figure(figsize=(9.4, 0.3 + 1.85 * n_rows))
    grid = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False)
    kappa = deformation[deformation["quantity"] == "kappa"].set_index("leg")
    for axes, leg in zip(grid.ravel(), legs, strict=False):
        _draw_leg(axes, ring[ring["leg"] == leg], kappa.loc[leg], leg)
    for axes in grid.ravel()[len(legs) :]:
        axes.set_axis_off()
    figure.supxlabel("Displacement Δρ of the leg's own actuator (mm)", fontsize=9)
    figure.supylabel("Deflection Δb_z of the joint (µm)".replace("Δb_z", r"$Δb_z$"), fontsize=9)
    return figure


def _draw_leg(axes: Axes, rows: pd.DataFrame, kappa: pd.Series, leg: int) -> None:
    colour = leg_colour(leg)
    for use, fill in (("calibration", colour), ("verification", "white")):
        chosen = rows[rows["use"] == use]
        travel, deflection, sd = (chosen[c] for c in ("actuator_displacement_mm", "deflection_um", "deflection_sd_um"))
        axes.vlines(travel, deflection - sd, deflection + sd, color=colour, linewidth=0.8)
        axes.plot(travel, deflection, "o", markersize=4, color=fill, markeredgecolor=colour)
    ends = np.array([rows["actuator_displacement_mm"].min(), rows["actuator_displacement_mm"].max()])
    axes.plot(ends, kappa["mean_1e-3"] * ends, color=INK, linewidth=1.3)  # 1e-3 mm per mm is µm per mm
    axes.set_title(f"Leg {leg}: κ = ({format_estimate(kappa['mean_1e-3'], kappa['sd_1e-3'])})·10⁻³")
    axes.grid()
