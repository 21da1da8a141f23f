"""How the evidence moves with the widths of the priors."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from bayescal.experiments.study.page.styles import Styles, count_columns, list_keys
from bayescal.report.numbers import format_plain

SPREAD = 0.08  # of the axis between the first and the last model at one factor


def draw_sensitivity(wide: pd.DataFrame, styles: Styles) -> Figure:
    """Return two panels: each variant's evidence below its own maximum, and its difference to the best variant.

    Parameters
    ----------
    wide : DataFrame
        Log-evidence with a row per factor on the priors and a column per variant.
    styles : mapping
    """
    figure = Figure(figsize=(9.4, 3.3))
    left, right = figure.subplots(1, 2)
    _draw_lines(left, wide - wide.max(axis=0), styles)
    left.set_ylabel("below its own largest (nat)")
    left.set_title("What the width costs each variant")
    _draw_lines(right, wide.sub(wide.max(axis=1), axis=0), styles)
    right.set_yscale("symlog", linthresh=1.0, linscale=0.6)
    right.set_ylim(min(-1.0, 1.6 * float(right.dataLim.y0)), 0.5)
    right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    right.set_ylabel("below the best there (nat, logarithmic)")
    right.set_title("What separates the variants")
    figure.legend(
        handles=list_keys(styles, 1.2), loc="outside upper left", ncols=count_columns(styles, 8), borderaxespad=0.2
    )
    return figure


def _draw_lines(axes: Axes, wide: pd.DataFrame, styles: Styles) -> None:
    """Draw a line per variant; models stand side by side, so that those that agree are seen."""
    models = list(dict.fromkeys(style.model for style in styles.values()))
    logarithm = np.log(wide.index.to_numpy(dtype=float))
    span = float(np.ptp(logarithm)) or 1.0
    for name, style in styles.items():
        place = (models.index(style.model) + 0.5) / len(models) - 0.5
        axes.plot(
            np.exp(logarithm + SPREAD * span * place),
            wide[name],
            color=style.colour,
            marker=style.marker,
            markersize=5,
            linewidth=0.8,
        )
    axes.set_xscale("log")
    axes.set_xticks(list(wide.index))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.minorticks_off()
    axes.set_xlabel("Factor on the widths of all priors")
    axes.grid()
