"""Figures of simulated calibrations, after figures 5 and 8 to 10 of Yu, Wu and Wang (2023)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from bayescal.report.figures.style import GREY, INK, LEG_COLOURS, RED
from bayescal.report.symbols import quote

POSES_COLOURS = {"optimal": "#0072B2", "random": "#D55E00"}
INDEX_COLOURS = dict(zip(("O1", "O2", "O3", "O4", "O5"), LEG_COLOURS, strict=False))
FIGURE_TITLES = {
    "position_max_mm": "Position, largest (µm)",
    "position_mean_mm": "Position, mean (µm)",
    "attitude_max_deg": "Attitude, largest (mdeg)",
    "attitude_mean_deg": "Attitude, mean (mdeg)",
}
THOUSAND = 1e3
LINES = {"unweighted": "-", "weighted": "--"}
LABELS = {"unweighted": "as in the paper", "weighted": "weighted by the noise"}


def draw_table8(repeats: pd.DataFrame, table: pd.DataFrame) -> Figure:
    """Return histograms of table 8's figures over the repeats, the published ones marked."""
    figure = Figure(figsize=(9.0, 5.0))
    plain = repeats[repeats["weighting"] == "unweighted"]
    for axes, (name, title) in zip(figure.subplots(2, 2).flat, FIGURE_TITLES.items(), strict=True):
        values = THOUSAND * plain[name].to_numpy()
        bins = np.geomspace(values.min(), values.max(), 40)
        for poses, colour in POSES_COLOURS.items():
            ours = THOUSAND * plain.loc[plain["poses"] == poses, name]
            axes.hist(ours, bins, color=colour, alpha=0.45, label=f"{poses} poses")
            _mark_published(axes, table, poses, name, colour)
        axes.set_xscale("log")
        _scale_log(axes.xaxis)
        axes.set_xlabel(title)
        axes.set_ylabel("Repeats")
    figure.axes[0].legend(title="Dashed: published", alignment="left")
    return figure


def _mark_published(axes: Axes, table: pd.DataFrame, poses: str, name: str, colour: str) -> None:
    if "published" not in table:
        return
    rows = table[(table["poses"] == poses) & (table["figure"] == name)].dropna(subset=["published"])
    for value in rows["published"]:
        axes.axvline(THOUSAND * value, color=colour, linestyle="--", linewidth=1.6)


def _scale_log(axis: Axis) -> None:
    """Put ticks at 1, 2 and 5 of a decade, what is drawn already deciding the range."""
    low, high = axis.get_view_interval()
    axis.set_ticks([m * 10.0**e for e in range(-6, 4) for m in (1, 2, 5) if low <= m * 10.0**e <= high])
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def draw_convergence(convergence: pd.DataFrame) -> Figure:
    """Return the remaining errors of the first hardpoint's parameters after each iteration (figure 8)."""
    figure = Figure(figsize=(9.0, 3.4))
    left, right = figure.subplots(1, 2)
    for k, (name, rows) in enumerate(convergence.groupby("parameter", sort=False)):
        colour = (*LEG_COLOURS, INK)[k % 7]
        left.plot(rows["iteration"], rows["error_mm"], marker="o", markersize=3.5, color=colour, label=quote(str(name)))
        step = rows["error_mm"].diff().abs().iloc[1:]
        right.plot(rows["iteration"].iloc[1:], step, marker="o", markersize=3.5, color=colour)
    left.axhline(0.0, color=GREY, linewidth=0.7)
    left.set_ylabel("Remaining error (mm)")
    left.legend(ncols=2)
    right.set_yscale("log")
    right.set_ylabel("Correction (mm)")
    for axes in (left, right):
        axes.set_xlabel("Iteration")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def draw_verification(verification: pd.DataFrame) -> Figure:
    """Return position and attitude errors at every verification pose of one repeat (figure 9)."""
    figure = Figure(figsize=(9.0, 5.0))
    panels = figure.subplots(2, 1, sharex=True)
    titles = (("position_mm", "Position error (µm)"), ("attitude_deg", "Attitude error (mdeg)"))
    chosen = (("random", "unweighted"), ("optimal", "unweighted"), ("optimal", "weighted"))
    colours = (POSES_COLOURS["random"], POSES_COLOURS["optimal"], "#009E73")
    for axes, (column, title) in zip(panels, titles, strict=True):
        for (poses, weighting), colour in zip(chosen, colours, strict=True):
            rows = verification[(verification["poses"] == poses) & (verification["weighting"] == weighting)]
            label = f"{poses} poses, {LABELS[weighting]}"
            axes.plot(rows["pose"], THOUSAND * rows[column], ".", markersize=4.0, color=colour, label=label)
        axes.set_ylabel(title)
        axes.set_ylim(bottom=0.0)
    panels[0].legend(loc="upper right")
    panels[-1].set_xlabel("Verification pose")
    return figure


def draw_numbers(table: pd.DataFrame) -> Figure:
    """Return the integrated error against the number of poses, with the middle 95 % (figure 10)."""
    figure = Figure(figsize=(7.0, 4.2))
    axes = figure.subplots()
    for (poses, weighting), rows in table.groupby(["poses", "weighting"], sort=False):
        colour, line = POSES_COLOURS[str(poses)], LINES[str(weighting)]
        label = f"{poses} poses, {LABELS[str(weighting)]}"
        axes.plot(rows["n_poses"], rows["mean"], line, marker="o", markersize=3.5, color=colour, label=label)
        if weighting == "unweighted":
            axes.fill_between(rows["n_poses"], rows["low"], rows["high"], color=colour, alpha=0.15, linewidth=0.0)
    axes.set_yscale("log")
    _scale_log(axes.yaxis)
    axes.set_xlabel("Number of measured poses")
    axes.set_ylabel("Integrated error, mm and deg")
    axes.legend(title="Mean; shaded: middle 95 %", alignment="left")
    return figure


def draw_indices(sets: pd.DataFrame, unit: str = "deg") -> Figure:
    """Return histograms of the integrated error over parameter sets, all with one draw of the noise (figure 5)."""
    return _draw_by_condition(sets[sets["selection"] == 1], unit, "Calibrations")


def draw_indices_noise(draws: pd.DataFrame, unit: str = "deg") -> Figure:
    """Return the same over draws of the noise and selections."""
    return _draw_by_condition(draws, unit, "Share of calibrations", share=True)


def _draw_by_condition(table: pd.DataFrame, unit: str, label: str, share: bool = False) -> Figure:
    conditions = list(dict.fromkeys(table["condition"]))
    figure = Figure(figsize=(9.0, 2.6 * -(-len(conditions) // 2)))
    for axes, condition in zip(
        figure.subplots(-(-len(conditions) // 2), 2, squeeze=False).flat, conditions, strict=False
    ):
        rows = table[table["condition"] == condition]
        values = rows[unit].dropna().to_numpy()
        bins = np.geomspace(values.min(), values.max() * (1 + 1e-9), 50)
        for index, ours in rows.groupby("index", sort=False):
            found = ours[unit].dropna().to_numpy()
            weights = np.full(len(found), 1.0 / len(found)) if share else None
            style = {"color": INDEX_COLOURS[str(index)], "label": str(index)}
            axes.hist(found, bins, weights=weights, histtype="stepfilled", alpha=0.35, **style)
            axes.axvline(found.mean(), color=INDEX_COLOURS[str(index)], linewidth=1.4)
        axes.set_xscale("log")
        _scale_log(axes.xaxis)
        axes.set_title(f"Condition {condition}")
        axes.set_xlabel("Integrated error, mm and deg")
        axes.set_ylabel(label)
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside right upper", title="Line: mean", alignment="left")
    return figure


def draw_best(best: pd.DataFrame, unit: str = "deg") -> Figure:
    """Return each index's mean error by that of the first, with two standard errors."""
    rows = best[best["unit"] == unit]
    figure = Figure(figsize=(7.0, 3.6))
    axes = figure.subplots()
    conditions = list(dict.fromkeys(rows["condition"]))
    for k, (index, ours) in enumerate(rows.groupby("index", sort=False)):
        place = np.arange(len(conditions)) + 0.12 * (k - 2)
        colour = INDEX_COLOURS[str(index)]
        error = 2.0 * ours["standard_error"].fillna(0.0)
        axes.errorbar(place, ours["ratio"], yerr=error, fmt="o", color=colour, capsize=2.0, label=str(index))
    axes.axhline(1.0, color=RED, linewidth=0.7)
    axes.set_xticks(np.arange(len(conditions)), conditions)
    axes.set_xlabel("Measurement condition")
    axes.set_ylabel("Mean integrated error, O1 = 1")
    axes.legend(ncols=5)
    return figure
