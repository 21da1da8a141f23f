"""Where the parameters moved, leg by leg: posterior intervals of the geometry and of the model error."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayescal.experiments.study.page.styles import Styles, count_columns, list_keys
from bayescal.report.numbers import MICROMETRES
from bayescal.report.style import GREY, INK, PALE
from bayescal.report.symbols import MODEL_ERROR, Asked, is_model_error, scale_of, set_mathematics

PRIOR_90 = 1.645  # prior standard deviations to the 5 and 95 % points of a normal prior
MANY = 8  # symbols from which the panels stand three in a row


def draw_parameters(parameters: pd.DataFrame, published: pd.DataFrame, styles: Styles, asked: Asked = None) -> Figure:
    """Return the 90 % posterior intervals of all geometry, as offsets from nominal, a panel per symbol.

    Parameters
    ----------
    parameters : DataFrame
        Posterior summaries with columns variant, symbol, leg, unit, nominal, mean, q05, q95, prior_sd.
    published : DataFrame
        Columns variant, parameter, leg and published_offset; NaN where nothing was published.
    styles : mapping
        Of the variants shown, from left to right at each leg.
    asked : mapping or None
        Units of the config.
    """
    rows = parameters[~parameters["symbol"].map(is_model_error) & parameters["variant"].isin(list(styles))]
    published = published[published["variant"].isin(list(styles))]
    symbols = list(dict.fromkeys(rows["symbol"]))
    n_columns = 2 if len(symbols) <= MANY else 3
    n_rows = math.ceil(len(symbols) / n_columns)
    figure = Figure(figsize=(9.4, 0.5 + 1.7 * n_rows))
    grid = figure.subplots(n_rows, n_columns, squeeze=False).ravel()
    for axes, symbol in zip(grid, symbols, strict=False):
        chosen = rows[rows["symbol"] == symbol]
        there = {name: style for name, style in styles.items() if name in set(chosen["variant"])}
        factor, unit = scale_of(symbol, str(chosen["unit"].iloc[0]), asked)
        _draw_prior(axes, chosen, factor)
        _draw_intervals(axes, chosen, there, factor)
        _draw_published(axes, published[published["parameter"] == symbol], chosen, there, factor)
        axes.axhline(0, color=INK, linewidth=0.8)
        axes.set_ylabel(f"{set_mathematics(symbol, 'Δ')} ({unit})")
        _label_legs(axes, chosen)
    for axes in grid[len(symbols) :]:
        axes.set_axis_off()
    handles = [*list_keys(styles, 1.6), Patch(color=PALE, alpha=0.55, label="prior, central 90 %")]
    if published["published_offset"].notna().any():
        handles.append(Line2D([], [], color=INK, marker="x", markersize=4.5, linestyle="none", label="published"))
    figure.legend(handles=handles, loc="outside upper left", ncols=count_columns(styles, 5), borderaxespad=0.2)
    return figure


def draw_model_error(parameters: pd.DataFrame, styles: Styles, prior_scale_um: float | None) -> Figure:
    """Return the 90 % posterior intervals of the model error τ of each leg, µm: a panel per deformation."""
    rows = parameters[parameters["symbol"] == MODEL_ERROR].assign(nominal=0.0)
    deformations = list(dict.fromkeys(style.deformation for style in styles.values()))
    figure = Figure(figsize=(9.4, 2.5))
    grid = figure.subplots(1, len(deformations), sharey=True, squeeze=False)[0]
    handles = list_keys(styles, 1.6)
    for axes, deformation in zip(grid, deformations, strict=True):
        _draw_intervals(axes, rows, {n: s for n, s in styles.items() if s.deformation == deformation}, MICROMETRES)
        axes.set_title(deformation)
        _label_legs(axes, rows)
        if prior_scale_um is not None:
            axes.axhline(prior_scale_um, color=GREY, linestyle="--", linewidth=1.0)
    if prior_scale_um is not None:
        label = "scale of the half-normal prior"
        handles.append(Line2D([], [], color=GREY, linestyle="--", linewidth=1.0, label=label))
    grid[0].set_ylim(bottom=0)
    grid[0].set_ylabel("Model error τ (µm)")
    columns = count_columns(styles, 8)
    figure.legend(handles=handles, loc="outside upper left", ncols=columns, borderaxespad=0.2, columnspacing=1.4)
    return figure


def _shift(k: int, n: int) -> float:
    return min(0.72, 0.24 * n) * ((k + 0.5) / n - 0.5)


def _draw_prior(axes: Axes, rows: pd.DataFrame, factor: float) -> None:
    """Shade the prior's 90 %; where it is far wider than the posteriors it fills the panel."""
    widths = factor * PRIOR_90 * rows.groupby("leg")["prior_sd"].max()
    axes.bar(widths.index, 2 * widths, 0.9, -widths, color=PALE, alpha=0.55, linewidth=0)


def _draw_intervals(axes: Axes, rows: pd.DataFrame, styles: Styles, factor: float) -> None:
    for k, (name, style) in enumerate(styles.items()):
        chosen = rows[rows["variant"] == name]
        leg = chosen["leg"].to_numpy() + _shift(k, len(styles))
        mean, low, high = (factor * (chosen[c] - chosen["nominal"]).to_numpy() for c in ("mean", "q05", "q95"))
        axes.vlines(leg, low, high, color=style.colour, linewidth=1.6)
        axes.plot(leg, mean, linestyle="none", marker=style.marker, markersize=3.8, color=style.colour)


def _draw_published(axes: Axes, published: pd.DataFrame, rows: pd.DataFrame, styles: Styles, factor: float) -> None:
    single = set(rows["leg"]) == {0}
    for k, name in enumerate(styles):
        chosen = published[published["variant"] == name]
        leg = (0.0 if single else chosen["leg"].to_numpy()) + np.full(len(chosen), _shift(k, len(styles)))
        offset = factor * chosen["published_offset"].to_numpy()
        axes.plot(leg, offset, linestyle="none", marker="x", markersize=4.5, color=INK, markeredgewidth=0.9)


def _label_legs(axes: Axes, rows: pd.DataFrame) -> None:
    legs = sorted(set(rows["leg"]))
    axes.set_xticks(legs, [f"leg {leg}" if leg else "machine" for leg in legs])
    axes.set_xlim(min(legs) - 0.5, max(legs) + 0.5)
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y")
