"""Contractions as heat maps with numbers: of parameters by leg, and of weak combinations under other plans."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from bayescal.experiments.audit.page.wording import format_contraction
from bayescal.limits import DEAD, INFORMED
from bayescal.numerics.geometry import Array
from bayescal.report.style import INK
from bayescal.report.symbols import quote, set_mathematics, set_parameter

# orange where nothing is learnt, pale about what is learnt in part, blue where the tolerance is at least halved
COLOURS = LinearSegmentedColormap.from_list(
    "contraction", [(0.0, "#e08344"), (DEAD, "#f3c39d"), (0.5, "#f5f1ea"), (INFORMED, "#b9d6ea"), (1.0, "#3f86bd")]
)
CELL = 0.24  # inches, height of a row
NUMBERED = 26  # columns with legible numbers
WIDTH = 9.4


def draw_contraction(values: Array, symbols: Sequence[str], legs: Sequence[str], free: Array) -> Figure:
    """Return the contraction of every parameter: a row per symbol, a column per leg.

    Parameters
    ----------
    values : ndarray, shape (symbols, legs)
        NaN where there is no such parameter.
    symbols : sequence of str
    legs : sequence of str
        As they are called.
    free : ndarray of bool, shape (symbols, legs)
        Outlined.
    """
    width = min(WIDTH, 1.6 + 0.75 * len(legs))
    figure = Figure(figsize=(width, 0.75 + CELL * len(symbols)))
    axes = figure.subplots()
    _draw(axes, values)
    axes.set_xticks(range(len(legs)), list(legs))
    axes.xaxis.tick_top()
    axes.set_yticks(range(len(symbols)), [set_mathematics(symbol) for symbol in symbols])
    for row, column in np.argwhere(free):
        place = (float(column) - 0.46, float(row) - 0.42)
        axes.add_patch(Rectangle(place, 0.92, 0.84, fill=False, edgecolor=INK, linewidth=1.1))
    return figure


def draw_changes(values: Array, changes: Sequence[str], ridges: Sequence[str]) -> Figure:
    """Return the contraction of weak combinations under each plan: a row per plan, a column per combination.

    Parameters
    ----------
    values : ndarray, shape (changes, ridges)
        NaN where a plan is impossible.
    changes : sequence of str
    ridges : sequence of str
        Parameters that they are named after.
    """
    figure = Figure(figsize=(min(WIDTH, 2.8 + 0.75 * len(ridges)), 0.85 + CELL * len(changes)))
    axes = figure.subplots()
    _draw(axes, values)
    axes.set_xticks(
        range(len(ridges)), [set_parameter(name) for name in ridges], rotation=90 * (len(ridges) > NUMBERED)
    )
    axes.xaxis.tick_top()
    axes.set_yticks(range(len(changes)), [quote(name) for name in changes])
    axes.axhline(0.5, color=INK, linewidth=1.0)
    return figure


def _draw(axes: Axes, values: Array) -> None:
    rows, columns = values.shape
    axes.imshow(np.ma.masked_invalid(values), cmap=COLOURS, vmin=0.0, vmax=1.0, aspect="auto")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_xticks(np.arange(columns + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(rows + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=1.5)
    axes.tick_params(which="minor", length=0)
    size = 8.0 if columns <= NUMBERED // 2 else 6.6
    for i, j in np.ndindex(rows, columns):
        if np.isfinite(values[i, j]) and columns <= NUMBERED:
            text = format_contraction(float(values[i, j]))
            axes.text(j, i, text, ha="center", va="center", fontsize=size, color=INK)
