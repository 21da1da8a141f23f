"""Correlations of a posterior: what the measurements cannot tell apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayescal.report.numbers import format_fixed
from bayescal.report.style import INK
from bayescal.report.symbols import set_mathematics

SHOWN_DRAWS = 1500
FEW = 10  # parameters of which the correlations are written as numbers


def draw_ridges(
    draws: pd.DataFrame,
    nominal: pd.Series,
    scales: Mapping[str, tuple[float, str]],
    pairs: Sequence[tuple[str, str]],
) -> Figure:
    """Return the correlation matrix of one leg's parameters and the draws of chosen pairs.

    Parameters
    ----------
    draws : DataFrame
        A column per symbol of that leg.
    nominal : Series
        By symbol.
    scales : mapping
        Factor and name of the unit in which offsets are shown, by symbol.
    pairs : sequence of pairs of symbols
        At most three, the most correlated first.
    """
    figure = Figure(figsize=(9.4, 3.9))
    grid = figure.add_gridspec(2, 4, width_ratios=(1.25, 1.25, 1.0, 1.0))
    _draw_matrix(figure.add_subplot(grid[:, :2]), draws)
    step = max(1, len(draws) // SHOWN_DRAWS)
    shown = (draws - nominal).iloc[::step]
    places = ((0, 2), (0, 3), (1, 2), (1, 3))
    for (x, y), (row, column) in zip(pairs, places, strict=False):
        axes = figure.add_subplot(grid[row, column])
        x_factor, x_unit = scales[x]
        y_factor, y_unit = scales[y]
        x_values, y_values = x_factor * shown[x], y_factor * shown[y]
        axes.plot(x_values, y_values, linestyle="none", marker=".", markersize=1.6, color=INK, alpha=0.45)
        axes.set_xlabel(f"{set_mathematics(x, 'Δ')} ({x_unit})")
        axes.set_ylabel(f"{set_mathematics(y, 'Δ')} ({y_unit})")
        axes.locator_params(nbins=4)
        axes.grid()
    return figure


def _draw_matrix(axes: Axes, draws: pd.DataFrame) -> None:
    symbols = list(draws.columns)
    matrix = draws.corr().to_numpy()
    axes.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
    labels = [set_mathematics(symbol) for symbol in symbols]
    axes.set_xticks(range(len(symbols)), labels)
    axes.set_yticks(range(len(symbols)), labels)
    axes.tick_params(length=0)
    for i, j in np.ndindex(*matrix.shape):
        if i != j and len(symbols) <= FEW:
            colour = "white" if abs(matrix[i, j]) > 0.6 else INK
            text = format_fixed(float(matrix[i, j]), 2)
            axes.text(j, i, text, ha="center", va="center", fontsize=8, color=colour)
    axes.spines[:].set_visible(False)
    axes.set_title("Correlation")
