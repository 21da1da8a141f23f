"""How the parameters and the predicted errors go with noise, number of poses and displacements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from bayescal.experiments.audit.page.wording import name_requirement
from bayescal.limits import DEAD, INFORMED
from bayescal.report.numbers import format_plain
from bayescal.report.style import GREY, RED
from bayescal.report.symbols import quote, set_mathematics

SWEEPS = {
    "noise": "Noise of the sensors, times the plan's",
    "poses": "Number of poses",
    "workspace": "Displacements, times the plan's",
}
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#555555")
LINES = ("-", "--", ":")


def list_styles(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return a colour and a kind of line for each of many."""
    n = len(COLOURS)
    return {name: {"color": COLOURS[k % n], "linestyle": LINES[k // n % 3]} for k, name in enumerate(names)}


def draw_sweeps(sweeps: pd.DataFrame, requirements: pd.DataFrame | None, plan: Mapping[str, float]) -> Figure:
    """Return a column per sweep: what is left of the tolerances, and below it the predicted errors.

    Parameters
    ----------
    sweeps : DataFrame
        The audit's table.
    requirements : DataFrame or None
        The audit's table of the requirements; None without any.
    plan : mapping of str to float
        Where the plan stands in each sweep.
    """
    kinds = [name for name in SWEEPS if name in set(sweeps["sweep"])]
    rows = 1 if requirements is None else 2
    figure = Figure(figsize=(9.4, 0.5 + 2.9 * rows))
    grid = figure.subplots(rows, len(kinds), squeeze=False, sharex="col", sharey="row")
    for column, kind in enumerate(kinds):
        _draw_left(grid[0, column], sweeps[sweeps["sweep"] == kind])
        if requirements is not None:
            _draw_required(grid[1, column], requirements[requirements["sweep"] == kind])
        for axes in grid[:, column]:
            axes.set_xscale("log")
            axes.axvline(plan[kind], color=GREY, linewidth=0.8)
            axes.grid()
        _label_values(grid[-1, column], sorted(set(sweeps.loc[sweeps["sweep"] == kind, "value"])))
        grid[-1, column].set_xlabel(SWEEPS[kind])
    grid[0, 0].set_ylabel("Left of the tolerance,\nwhere known least")
    _add_legend(grid[0, -1])
    if requirements is not None:
        grid[1, 0].set_ylabel("Predicted sd\nin per cent of the limit")
        _add_legend(grid[1, -1])
    return figure


def _add_legend(axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles, labels, loc="center left", bbox_to_anchor=(1.02, 0.5), handlelength=2.2, labelspacing=0.25)


def _draw_left(axes: Axes, rows: pd.DataFrame) -> None:
    symbols = list(dict.fromkeys(rows["symbol"]))
    styles = list_styles(symbols)
    for symbol, one in rows.groupby("symbol", sort=False):
        line = one.sort_values("value")
        left = 100.0 * np.sqrt(np.maximum(1.0 - line["contraction_least"].to_numpy(dtype=float), 1e-16))
        label = set_mathematics(str(symbol))
        axes.plot(line["value"], left, linewidth=1.2, label=label, **styles[str(symbol)])
        beyond = line["beyond_actuator_range"].to_numpy(dtype=bool)
        colour = styles[str(symbol)]["color"]
        for chosen, face in ((beyond, "white"), (~beyond, colour)):
            x, y = line["value"].to_numpy()[chosen], left[chosen]
            axes.plot(x, y, linestyle="none", marker="o", markersize=3.2, color=colour, markerfacecolor=face)
    for contraction in (INFORMED, DEAD):
        axes.axhline(100.0 * np.sqrt(1.0 - contraction), color=RED, linewidth=0.8, linestyle="--")
    _set_percent(axes)


def _draw_required(axes: Axes, rows: pd.DataFrame) -> None:
    styles = list_styles(list(dict.fromkeys(rows["requirement"])))
    for k, (name, one) in enumerate(rows.groupby("requirement", sort=False)):
        line = one.sort_values("value")
        share = 100.0 * line["predicted_sd"] / line["limit"]
        label = quote(name_requirement(str(name)))
        style = {**styles[str(name)], "linestyle": LINES[k % 2]}  # x and y often lie upon each other
        axes.plot(line["value"], share, marker="o", markersize=3.2, linewidth=1.2, label=label, **style)
    axes.axhline(100.0, color=RED, linewidth=0.8, linestyle="--")
    _set_percent(axes)


def _set_percent(axes: Axes) -> None:
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(base=10.0, subs=(1.0, 2.0, 5.0), numticks=9))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{format_plain(value)} %"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _label_values(axes: Axes, values: list[float]) -> None:
    """Label the values swept, as many as there is room for."""
    kept: list[float] = []
    room = (np.log(values[-1]) - np.log(values[0])) / 6.0 if len(values) > 1 else 0.0
    for value in values:
        if not kept or np.log(value / kept[-1]) >= room * 0.999:
            kept.append(value)
    axes.set_xticks(kept, [format_plain(value) for value in kept])
    axes.minorticks_off()
