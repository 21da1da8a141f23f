"""Figures of a self-calibration: what is known of parameters and tool, before and after, and the truth beside."""

from __future__ import annotations

import textwrap

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from bayescal.report.numbers import format_plain
from bayescal.report.style import GREY, INK, LEG_COLOURS, PALE, RED
from bayescal.report.symbols import quote, set_parameter, split_name

MARKERS = ("o", "s", "^", "D", "v", "P")
NINETY = 1.645  # standard deviations to either side that hold 90 % of a normal
MICROMETRES = 1e3
NARROW = 24  # letters of a title above a narrow panel


def draw_tool(variants: pd.DataFrame) -> Figure:
    """Return the tool's errors over the workspace, before and after, predicted and true."""
    rows = variants.iloc[::-1]
    figure = Figure(figsize=(8.2, 1.3 + 0.42 * len(rows)))
    axes = figure.subplots()
    place = np.arange(len(rows))
    axes.hlines(place, rows["tool_after_um"], rows["tool_before_um"], color=PALE, linewidth=4.0)
    shown = [
        ("tool_before_um", "|", GREY, "predicted before, from the tolerances"),
        ("tool_after_um", "o", LEG_COLOURS[4], "predicted after, from the posterior"),
        ("tool_calibrated_error_um", "D", RED, "true error after"),
        ("tool_noise_um", ".", GREY, "from the noise of one pose's readings"),
    ]
    for column, marker, colour, label in shown:
        if rows[column].notna().any():
            filled = colour if marker != "D" else "none"
            axes.plot(rows[column], place, marker, color=colour, mfc=filled, mew=1.5, markersize=7.5, label=label)
    axes.set_yticks(place, [quote(str(title)) for title in rows["title"]])
    axes.set_ylim(-0.6, len(rows) - 0.4)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(axis="x")
    axes.set_xlabel("Error of the tool's centre over the workspace, rms (µm)")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def draw_parameters(parameters: pd.DataFrame, titles: dict[str, str]) -> Figure:
    """Return what remains of each tolerance with each set of sensors, and how far the truth is from the mean."""
    some = parameters[parameters["variant"].isin(list(titles))]
    names = order_parameters(some)
    known = "true" in some
    figure = Figure(figsize=(9.4, 5.6 if known else 3.4))
    panels = list(figure.subplots(2 if known else 1, 1, sharex=True, squeeze=False).flat)
    for k, (variant, title) in enumerate(titles.items()):
        rows = some[some["variant"] == variant].set_index("parameter")
        shift = 0.16 * (k - 0.5 * (len(titles) - 1))
        place = np.array([names.index(str(name)) for name in rows.index]) + shift
        style = {"color": LEG_COLOURS[k % 6], "marker": MARKERS[k % 6], "linestyle": "", "markersize": 4.5}
        panels[0].plot(place, rows["sd"] / rows["prior_sd"], label=quote(title), **style)
        if known:
            panels[1].plot(place, (rows["true"] - rows["mean"]) / rows["sd"], **style)
    panels[0].set_yscale("log")
    panels[0].axhline(1.0, color=GREY, linewidth=0.8)
    panels[0].set_ylabel("Posterior sd / tolerance")
    panels[0].grid(axis="y")
    if known:
        panels[1].axhspan(-NINETY, NINETY, color=PALE, alpha=0.5, linewidth=0.0)
        panels[1].axhline(0.0, color=GREY, linewidth=0.8)
        panels[1].set_ylabel("(True − mean) / sd")
    panels[-1].set_xticks(np.arange(len(names)), [set_parameter(str(name)) for name in names])
    panels[-1].tick_params(axis="x", labelsize=8.0, rotation=55)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(titles))
    return figure


def order_parameters(parameters: pd.DataFrame) -> list[str]:
    """Return the parameters of a table by symbol, in the order in which these first come, then by leg."""
    names = [str(name) for name in dict.fromkeys(parameters["parameter"])]
    symbols = list(dict.fromkeys(split_name(name)[0] for name in names))
    return sorted(names, key=lambda name: (symbols.index(split_name(name)[0]), split_name(name)[1]))


def draw_predictions(predictions: pd.DataFrame, titles: dict[str, str]) -> Figure:
    """Return the tool's centre at each verification pose with its 90 % interval, counted from the truth if known."""
    figure = Figure(figsize=(9.4, 4.6))
    panels = figure.subplots(2, len(titles), squeeze=False, sharex=True)
    known = predictions["x_true_mm"].notna().all()
    for k, (variant, title) in enumerate(titles.items()):
        rows = predictions[predictions["variant"] == variant]
        for axes, axis in zip(panels[:, k], "xy", strict=True):
            _draw_intervals(axes, rows, axis, LEG_COLOURS[k % 6], bool(known))
        panels[0, k].set_title(textwrap.fill(quote(title), NARROW), fontsize=8.5)
        panels[1, k].set_xlabel("Verification pose")
    what = "Predicted − true" if known else "Interval about the mean"
    panels[0, 0].set_ylabel(f"{what}, x (µm)")
    panels[1, 0].set_ylabel(f"{what}, y (µm)")
    return figure


def _draw_intervals(axes: Axes, rows: pd.DataFrame, axis: str, colour: str, known: bool) -> None:
    zero = rows[f"{axis}_true_mm"] if known else rows[f"{axis}_mm"]
    place = np.arange(1, len(rows) + 1)
    low, high, mean = (MICROMETRES * (rows[f"{axis}_{end}mm"] - zero) for end in ("low_", "high_", ""))
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.vlines(place, low, high, color=colour, linewidth=3.0, alpha=0.55)
    axes.plot(place, mean, "o", color=colour, markersize=4.0)
    axes.grid(axis="y")
