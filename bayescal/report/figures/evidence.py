"""How the evidence moves with the tolerance of the lengths."""

from __future__ import annotations

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from bayescal.report.figures.style import assign_styles


def draw_sensitivity(wide: pd.DataFrame) -> Figure:
    """Return two panels: each variant's evidence below its own maximum, and its difference to the best variant.

    Parameters
    ----------
    wide : DataFrame
        Log-evidence with a row per tolerance (mm) and a column per variant.
    """
    n_lines = -(-wide.shape[1] // 4)
    figure = Figure(figsize=(9.4, 3.0 + 0.17 * n_lines))
    left, right = figure.subplots(1, 2)
    _draw_lines(left, wide - wide.max(axis=0))
    left.set_ylabel("below its own largest (nat)")
    left.set_title("What the tolerance costs each variant")
    _draw_lines(right, wide.sub(wide.max(axis=1), axis=0))
    right.set_yscale("symlog", linthresh=1.0, linscale=0.6)
    right.set_ylim(min(-1.0, 1.6 * float(right.dataLim.y0)), 0.5)
    right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "−")))
    right.set_ylabel("below the best there (nat, logarithmic)")
    right.set_title("What separates the variants")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=4, borderaxespad=0.2)
    return figure


def _draw_lines(axes: Axes, wide: pd.DataFrame) -> None:
    for name, style in assign_styles(list(wide.columns)).items():
        axes.plot(
            wide.index,
            wide[name],
            color=style.colour,
            marker=style.marker,
            markersize=5,
            linewidth=1.2,
            label=style.label,
        )
    axes.set_xscale("log")
    axes.set_xticks(list(wide.index))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.minorticks_off()
    axes.set_xlabel("Tolerance of the lengths, prior sd (mm)")
    axes.grid()
