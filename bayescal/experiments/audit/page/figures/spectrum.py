"""The spectra that decide: over a wide workspace against rounding, and of the plan against the tolerances."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayescal.experiments.audit.page.results import TOLD_LIMITS
from bayescal.limits import DEAD, INFORMED
from bayescal.report.numbers import format_plain
from bayescal.report.style import GREY, INK, RED

BLUE = "#0072B2"
ORANGE = "#D55E00"
FLOOR = 1e-3  # of what rounding or the thresholds are, below which values are drawn at the floor


def draw_spectrum(spectrum: pd.DataFrame) -> Figure:
    """Return two panels: singular values of the noise-free Jacobian, and what the plan tells per tolerance.

    Parameters
    ----------
    spectrum : DataFrame
        The audit's table.
    """
    figure = Figure(figsize=(9.4, 3.3))
    left, right = figure.subplots(1, 2)
    _draw_structure(left, spectrum)
    _draw_plan(right, spectrum)
    for axes in (left, right):
        axes.set_yscale("log")
        axes.set_xlabel("Number, largest first")
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.grid(axis="y")
    return figure


def _draw_structure(axes: Axes, spectrum: pd.DataFrame) -> None:
    counts = spectrum["counts"].to_numpy(dtype=bool)
    number, values = spectrum["number"].to_numpy(), spectrum["wide_workspace"].to_numpy(dtype=float)
    rounding = float(spectrum["rounding"].iloc[0])
    shown = np.maximum(values, FLOOR * rounding if rounding > 0.0 else np.finfo(float).tiny)
    axes.plot(number[counts], shown[counts], linestyle="none", marker="o", markersize=3.5, color=BLUE, label="seen")
    if not counts.all():
        axes.plot(
            *(number[~counts], shown[~counts]),
            linestyle="none",
            marker="s",
            markersize=3.5,
            color=RED,
            label="never seen",
        )
    axes.axhline(rounding, color=GREY, linestyle="--", linewidth=1.0, label="rounding")
    rank = int(counts.sum())
    if 0 < rank < len(counts):
        axes.axvline(rank + 0.5, color=INK, linewidth=0.6, linestyle=":")
    axes.set_ylabel("Singular value per tolerance")
    axes.set_title(f"Any measurement of this kind: rank {rank} of {len(counts)}")
    axes.legend(loc="best")


def _draw_plan(axes: Axes, spectrum: pd.DataFrame) -> None:
    planned = spectrum["planned"].to_numpy(dtype=float)
    number = spectrum["number"].to_numpy()
    low, high = TOLD_LIMITS
    shown = np.maximum(planned, FLOOR * low)
    groups = (
        (planned >= high, BLUE, "o", "determined"),
        ((planned >= low) & (planned < high), ORANGE, "^", "in part"),
        (planned < low, RED, "s", "hardly or never"),
    )
    for chosen, colour, marker, label in groups:
        if chosen.any():
            axes.plot(
                *(number[chosen], shown[chosen]),
                linestyle="none",
                marker=marker,
                markersize=3.5,
                color=colour,
                label=label,
            )
    for value, contraction in ((high, INFORMED), (low, DEAD)):
        axes.axhline(value, color=GREY, linestyle="--", linewidth=1.0)
        axes.text(1, value * 1.12, f"contraction {format_plain(contraction)}", fontsize=8, color="#555555")
    axes.set_ylabel("Tolerance / what the noise leaves")
    axes.set_title("The planned measurements")
    axes.legend(loc="best")
