"""Figures of sensor placement: accuracy of every set against price and number of sensors, predicted and simulated."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from bayescal.report.numbers import format_count, format_plain
from bayescal.report.style import GREY, INK, LEG_COLOURS, MARKERS, PALE, RED
from bayescal.report.symbols import quote

FRONT = "#0072B2"
SIMULATED = "#D55E00"
SHOWN = 30.0  # times the best error, above which sets are left out of the pictures
TICKS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
KINDS = {"phi": "φ", "psi": "ψ", "rho": "ρ"}


def write_sensors(text: str) -> str:
    """Return names of sensors as the page writes them: ``phi[2]`` is φ2, ``tilt_a[3]`` is tilt-a3."""
    text = re.sub(r"\b(phi|psi|rho)(?![a-z])", lambda m: KINDS[m[1]], text)
    text = re.sub(r"\btilt_([ab])", r"tilt-\1", text)
    return re.sub(r"\[(\d+)\]", r"\1", text).replace("_", " ")


def draw_front(sets: pd.DataFrame, front: pd.DataFrame, named: pd.DataFrame, simulated: pd.DataFrame) -> Figure:
    """Return the error of every set against its price, the Pareto front, named sets and simulated calibrations."""
    figure = Figure(figsize=(9.0, 5.4))
    axes = figure.subplots()
    top = _limit(axes, sets)
    _draw_cloud(axes, sets, "price", top)
    shown = front[front["rms_um"] < top]
    axes.step(shown["price"], shown["rms_um"], where="post", color=FRONT, linewidth=1.4)
    axes.plot(shown["price"], shown["rms_um"], "o", color=FRONT, markersize=4.5, label="Pareto front")
    _draw_named(axes, named, "price", top)
    good = simulated[simulated["predicted_um"] < top]
    axes.errorbar(
        good["price"],
        good["simulated_um"],
        yerr=2.0 * good["simulated_error_um"],
        fmt="none",
        ecolor=SIMULATED,
        elinewidth=1.6,
        capsize=3.0,
        label="simulated, ± 2 standard errors",
        zorder=5,
    )
    axes.set_xlabel("Price")
    axes.legend(loc="upper right")
    return figure


def draw_numbers(sets: pd.DataFrame, front: pd.DataFrame, named: pd.DataFrame) -> Figure:
    """Return the error of every set against its number of sensors, the front, and the parts of its error."""
    figure = Figure(figsize=(9.0, 4.6))
    axes = figure.subplots()
    top = _limit(axes, sets)
    _draw_cloud(axes, sets, "n_sensors", top)
    shown = front[front["rms_um"] < top]
    axes.plot(shown["n_sensors"], shown["rms_um"], "-o", color=FRONT, markersize=4.5, label="best of each number")
    axes.plot(shown["n_sensors"], shown["calibration_um"], "--", color=FRONT, linewidth=1.2, label="of it calibration")
    axes.plot(shown["n_sensors"], shown["noise_um"], ":", color=FRONT, linewidth=1.6, label="of it noise in use")
    axes.set_ylim(bottom=0.7 * min(shown["calibration_um"].min(), shown["noise_um"].min()))
    _draw_named(axes, named, "n_sensors", top)
    _scale_log(axes.yaxis)
    axes.set_xlabel("Number of sensors")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(loc="upper right")
    return figure


def draw_simulated(simulated: pd.DataFrame) -> Figure:
    """Return simulated over predicted errors, set by set."""
    figure = Figure(figsize=(9.0, 3.2))
    axes = figure.subplots()
    ratio = simulated["simulated_um"] / simulated["predicted_um"]
    error = 2.0 * simulated["simulated_error_um"] / simulated["predicted_um"]
    place = np.arange(len(simulated))
    axes.axhline(1.0, color=INK, linewidth=0.8)
    axes.errorbar(place, ratio, yerr=error, fmt="o", color=SIMULATED, markersize=4.5, capsize=3.0)
    pairs = zip(simulated["n_sensors"], simulated["price"], strict=True)
    labels = [f"{n} for\n{format_plain(price)}" for n, price in pairs]
    axes.set_xticks(place, labels)
    axes.set_xlabel("Set: number of sensors and price")
    axes.set_ylabel("Simulated / predicted error")
    return figure


def _limit(axes: Axes, sets: pd.DataFrame) -> float:
    """Set the scale of errors; return the largest that is shown."""
    best = float(sets.loc[sets["reason"] == "", "rms_um"].min())
    axes.set_yscale("log")
    top = min(SHOWN * best, float(1.2 * sets["rms_um"].max()))
    axes.set_ylim(0.9 * best, top)
    _scale_log(axes.yaxis)
    axes.grid(axis="y")
    axes.set_ylabel("Error of the tool's centre, rms (µm)")
    return top


def _draw_cloud(axes: Axes, sets: pd.DataFrame, against: str, top: float) -> None:
    """Draw all sets; those of one number or price side by side where they would hide each other."""
    steps = np.diff(np.unique(sets[against]))
    width = 0.5 * min(float(steps.min()), 1.0) if len(steps) else 0.0
    shift = width * (((0.618034 * np.arange(len(sets))) % 1.0) - 0.5)
    labels = {"": ("feasible sets", PALE, "."), "tolerances": ("left to the tolerances", RED, "x")}
    for reason, (label, colour, marker) in labels.items():
        rows = (sets["reason"] == reason) & (sets["rms_um"] < top)
        if rows.any():
            x, y = sets.loc[rows, against] + shift[rows], sets.loc[rows, "rms_um"]
            size = 3.0 if reason else 4.0
            shown = f"{label} ({format_count(rows.sum())} shown)"
            axes.plot(x, y, marker, color=colour, markersize=size, label=shown, zorder=1)


def _draw_named(axes: Axes, named: pd.DataFrame, against: str, top: float) -> None:
    colours = (LEG_COLOURS[2], LEG_COLOURS[3], LEG_COLOURS[0], INK)
    for k, (_, row) in enumerate(named.iterrows()):
        if row["rms_um"] < top:
            label = quote(str(row["name"])) + ("" if row["reason"] == "" else " (no good)")
            style: dict[str, Any] = {"markersize": 9.0, "mfc": "none", "mew": 1.6, "linestyle": "none"}
            marker = MARKERS[1 + k % (len(MARKERS) - 1)]
            colour = GREY if row["reason"] else colours[k % len(colours)]
            axes.plot(row[against], row["rms_um"], marker=marker, color=colour, label=label, zorder=4, **style)


def _scale_log(axis: Axis) -> None:
    """Put ticks at round numbers of every decade within view."""
    low, high = axis.get_view_interval()
    places = [m * 10.0**e for e in range(-6, 7) for m in TICKS if low <= m * 10.0**e <= high]
    axis.set_ticks(places)
    axis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    axis.set_minor_formatter(NullFormatter())
