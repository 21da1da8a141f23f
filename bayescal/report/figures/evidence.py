"""How the evidence moves with the tolerance of the lengths."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from bayescal.report.figures.style import assign_styles


def draw_sensitivity(sensitivity: pd.DataFrame, variants: Sequence[str]) -> Figure:
    """Return two panels: each variant's evidence below its own maximum, and its difference to the best variant."""
    wide = sensitivity.pivot(index="tolerance_mm", columns="variant", values="log_evidence").sort_index()
    n_lines = -(-len(variants) // 4)
    figure = Figure(figsize=(9.4, 3.0 + 0.17 * n_lines))
    left, right = figure.subplots(1, 2)
    _draw_lines(left, wide - wide.max(axis=0), variants)
    left.set_ylabel("below the variant's own largest (nat)")
    left.set_title("What the tolerance costs each variant")
    _draw_lines(right, wide.sub(wide.max(axis=1), axis=0), variants)
    right.set_ylabel("below the best at that tolerance (nat)")
    right.set_title("What separates the variants")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=4, borderaxespad=0.2)
    return figure


def _draw_lines(axes: Axes, wide: pd.DataFrame, variants: Sequence[str]) -> None:
    for name, style in assign_styles(variants).items():
        axes.plot(
            wide.index, wide[name], color=style.colour, marker=style.marker, markersize=5, linewidth=1.2, label=style.label
        )
    axes.set_xscale("log")
    axes.set_xticks(list(wide.index))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.minorticks_off()
    axes.set_xlabel("Tolerance of the lengths, prior sd (mm)")
    axes.grid()
