"""Figure of the two pose methods against the number of targets, after RR-8096 figure 5."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from bayescal.report.numbers import format_plain

STYLES: dict[str, dict[str, Any]] = {
    "line": {"color": "tab:red", "marker": "s", "label": "Line through the targets"},
    "robust": {"color": "black", "marker": "o", "label": "Robust rigid fit"},
}
PANELS = (
    ("position_error_mm", 1000.0, "Position error of the barycentre (µm)", False),
    ("orientation_error_deg", 1.0, "Orientation error (degrees)", True),
)


def draw_pose_methods(summary: pd.DataFrame) -> Figure:
    """Return the figure: position and orientation errors of both methods, mean and standard deviation over repeats.

    Parameters
    ----------
    summary : pandas.DataFrame
        From `bayescal.reproductions.rr8096.pose_methods.comparison.summarise_comparison`.
    """
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    for axes, (column, factor, label, logarithmic) in zip(figure.subplots(1, 2), PANELS, strict=True):
        for k, (method, rows) in enumerate(summary.groupby("method", sort=True)):
            _draw_method(axes, str(method), rows, column, factor, logarithmic, shift=0.24 * (k - 0.5))
        if logarithmic:
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
        else:
            axes.set_ylim(bottom=0)
        axes.set_xlabel("Number of targets")
        axes.set_ylabel(label)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(alpha=0.3, which="major")
    figure.axes[0].legend(frameon=False, title="Mean ± sd over repeats", alignment="left")
    return figure


def _draw_method(
    axes: Axes, method: str, rows: pd.DataFrame, column: str, factor: float, logarithmic: bool, shift: float
) -> None:
    """Draw the points of one method; on a logarithmic axis a bar's lower end stays above a tenth of the mean."""
    mean = factor * rows[f"{column}_mean"].to_numpy()
    below = above = factor * rows[f"{column}_sd"].fillna(0.0).to_numpy()
    if logarithmic:
        below = np.minimum(below, 0.9 * mean)
    axes.errorbar(
        rows["n_targets"].to_numpy() + shift,
        mean,
        yerr=np.stack([below, above]),
        linestyle="none",
        markersize=4.5,
        elinewidth=1.0,
        capsize=2.0,
        **STYLES[method],
    )
