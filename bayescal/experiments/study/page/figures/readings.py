"""Figures of readings: what the calibration left of the tolerances, held-back readings, residuals of poses."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from bayescal.report.style import GREY, LEG_COLOURS, PALE, RED
from bayescal.report.symbols import quote

NINETY = 1.645


def draw_reduction(parameters: pd.DataFrame, titles: dict[str, str]) -> Figure:
    """Return each parameter's posterior standard deviation over its tolerance, by variant."""
    some = parameters[parameters["verdict"] != "noise"]
    names = list(dict.fromkeys(str(name) for name in some["parameter"]))
    figure = Figure(figsize=(9.4, 3.6))
    axes = figure.subplots()
    for k, (variant, title) in enumerate(titles.items()):
        rows = some[some["variant"] == variant]
        place = np.array([names.index(str(name)) for name in rows["parameter"]]) + 0.1 * (k - 0.5 * (len(titles) - 1))
        remains = rows["sd"] / rows["prior_sd"]
        axes.plot(
            place,
            remains,
            "osD^vPX*p"[k % 9],
            color=LEG_COLOURS[k % 6],
            markersize=4.5,
            label=quote(title),
        )
    axes.axhline(1.0, color=GREY, linewidth=0.8)
    axes.set_yscale("log")
    axes.set_ylabel("Posterior sd / tolerance")
    axes.set_xticks(range(len(names)), [quote(name) for name in names], rotation=60)
    axes.tick_params(axis="x", labelsize=8.0)
    axes.grid(axis="y")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def draw_predictions(predictions: pd.DataFrame) -> Figure:
    """Return how far held-back readings lie from what is predicted, in its standard deviations, by channel."""
    channels = list(dict.fromkeys(str(name) for name in predictions["channel"]))
    figure = Figure(figsize=(8.2, 1.2 + 0.36 * len(channels)))
    axes = figure.subplots()
    axes.axvspan(-NINETY, NINETY, color=PALE, alpha=0.5, linewidth=0.0)
    for row, channel in enumerate(reversed(channels)):
        mine = predictions[predictions["channel"] == channel]
        z = ((mine["measured"] - mine["mean"]) / mine["sd"]).to_numpy()
        spread = row + 0.28 * np.linspace(-1.0, 1.0, len(z)) if len(z) > 1 else np.array([float(row)])
        inside = mine["inside"].to_numpy(dtype=bool)
        axes.plot(z[inside], spread[inside], "o", color=LEG_COLOURS[0], markersize=3.5)
        axes.plot(z[~inside], spread[~inside], "D", color=RED, markersize=4.0)
    axes.set_yticks(range(len(channels)), [quote(name) for name in reversed(channels)])
    axes.set_xlabel("(Measured − predicted) / sd of the prediction; grey holds 90 % of a normal, red lie outside")
    axes.grid(axis="x")
    return figure


def draw_poses(poses: pd.DataFrame) -> Figure:
    """Return the residuals of the best machine at each pose, in units of their noise."""
    figure = Figure(figsize=(9.4, 2.9))
    axes = figure.subplots()
    size = np.sqrt(poses["square"] / np.maximum(poses["equations"], 1))
    contradicting = poses["contradicting"].to_numpy(dtype=bool)
    place = np.arange(len(poses))
    axes.bar(place[~contradicting], size[~contradicting], color=LEG_COLOURS[0], width=0.7)
    axes.bar(place[contradicting], size[contradicting], color=RED, width=0.7)
    axes.axhline(1.0, color=GREY, linewidth=0.8)
    step = max(1, len(poses) // 50)
    axes.set_xticks(place[::step], [quote(str(name)) for name in poses["pose"]][::step], rotation=60)
    axes.tick_params(axis="x", labelsize=7.5)
    axes.set_ylabel("Residual / noise")
    axes.set_xlabel("Pose; red: the others contradict it")
    axes.grid(axis="y")
    return figure
