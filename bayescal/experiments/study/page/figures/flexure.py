"""How the end of a bent flexure joint moves, and how well a circle and a pivot stand in for it (RR-8096 figure 9)."""

from __future__ import annotations

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from bayescal.experiments.study.page.styles import DEFORMATION_COLOURS
from bayescal.report.numbers import format_plain, format_significant
from bayescal.report.style import INK

ORANGE, BLUE, _ = DEFORMATION_COLOURS.values()
NANOMETRES = 1e3  # in a micrometre
SMALLEST = 1e-4  # nm: below, an error is that of the numbers themselves


def choose_flexure(flexure: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the longest flexure, by bending angle, with the pivot's error (nm) added."""
    rows = flexure[flexure["flexure_length_mm"] == flexure["flexure_length_mm"].max()].sort_values("bending_deg")
    return rows.assign(pivot_error_nm=NANOMETRES * (rows["along_pivot_um"] - rows["along_beam_um"]))


def draw_flexure(rows: pd.DataFrame) -> Figure:
    """Return the paths of the flexure's end (left) and the errors of circle and pivot (right).

    Parameters
    ----------
    rows : DataFrame
        From `choose_flexure`: bending_deg, across_um, along_beam_um, along_pivot_um, along_circle_um and the errors
        circle_error_nm and pivot_error_nm.
    """
    figure = Figure(figsize=(9.4, 3.1))
    left, right = figure.subplots(1, 2)
    left.plot(rows["along_pivot_um"], rows["across_um"], color=ORANGE, linewidth=1.6, label="ideal pivot")
    left.plot(rows["along_beam_um"], rows["across_um"], color=INK, linewidth=1.6, label="bent beam")
    every = max(1, len(rows) // 12)
    left.plot(
        rows["along_circle_um"][::every],
        rows["across_um"][::every],
        "o",
        markersize=5.5,
        color="none",
        markeredgecolor=BLUE,
        label="circle",
    )
    left.set_xlabel("Shortening Δx (µm)")
    left.set_ylabel("Deflection Δy (µm)")
    left.set_title(f"Path of the end, up to {format_plain(rows['bending_deg'].max())} deg")
    left.set_xlim(left=0)
    left.set_ylim(bottom=0)
    left.legend(loc="lower right")
    left.grid()
    for column, colour, label in (("pivot_error_nm", ORANGE, "ideal pivot"), ("circle_error_nm", BLUE, "circle")):
        _draw_error(right, rows["bending_deg"], rows[column].abs(), colour, label)
    right.set_yscale("log")
    right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    right.set_xlim(left=0)
    right.set_xlabel("Bending δ (deg)")
    right.set_ylabel("Distance from the beam along x (nm)")
    right.set_title("Error of what stands in for the beam")
    right.grid()
    return figure


def _draw_error(axes: Axes, bending: pd.Series, error: pd.Series, colour: str, label: str) -> None:
    shown = error >= SMALLEST
    axes.plot(bending[shown], error[shown], color=colour, linewidth=1.6)
    if shown.any():
        last = float(error.iloc[-1])
        text = f"{label}: {format_significant(last, 2)} nm"
        axes.annotate(text, (float(bending.iloc[-1]), last), (-4, -24), textcoords="offset points", ha="right")
