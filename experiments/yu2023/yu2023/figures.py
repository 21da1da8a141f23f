"""Figures of simulated calibrations, after figures 5 and 8 to 10 of Yu, Wu and Wang (2023)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from bayescal.report.numbers import format_plain
from bayescal.report.style import GREY, INK, LEG_COLOURS, RED
from bayescal.report.symbols import quote

POSES_COLOURS = {"optimal": "#0072B2", "random": "#D55E00"}
WEIGHTED_COLOUR = "#009E73"
INDEX_COLOURS = {"O1": "#D55E00", "O2": "#56B4E9", "O3": "#009E73", "O4": "#CC79A7", "O5": INK}
FIGURE_TITLES = {
    "position_max_mm": "Position, largest (µm)",
    "position_mean_mm": "Position, mean (µm)",
    "attitude_max_deg": "Attitude, largest (mdeg)",
    "attitude_mean_deg": "Attitude, mean (mdeg)",
}
THOUSAND = 1e3
LINES = {"unweighted": "-", "weighted": "--"}
LABELS = {"unweighted": "as in the paper", "weighted": "weighted by the noise"}
RANDOM_AS_GOOD = 50
"""Random poses that do about as well as 20 selected ones, says the paper of its figure 10."""
COARSE, FINE = (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)


def draw_table8(repeats: pd.DataFrame, table: pd.DataFrame) -> Figure:
    """Return histograms of table 8's figures over the repeats, the published ones marked."""
    figure = Figure(figsize=(9.0, 5.4))
    shown = [(poses, "unweighted", colour) for poses, colour in POSES_COLOURS.items()]
    shown.append(("optimal", "weighted", WEIGHTED_COLOUR))
    for axes, (name, title) in zip(figure.subplots(2, 2).flat, FIGURE_TITLES.items(), strict=True):
        groups = [
            THOUSAND * repeats.loc[(repeats["poses"] == poses) & (repeats["weighting"] == weighting), name].to_numpy()
            for poses, weighting, _ in shown
        ]
        every = np.concatenate(groups)
        bins = np.geomspace(every.min(), every.max(), 45)
        for (poses, weighting, colour), ours in zip(shown, groups, strict=True):
            axes.hist(ours, bins, color=colour, alpha=0.45, label=f"{poses} poses, {LABELS[weighting]}")
            if weighting == "unweighted":
                _mark_published(axes, table, poses, name, colour)
        axes.set_xscale("log")
        _scale_log(axes.xaxis)
        axes.set_xlabel(title)
        axes.set_ylabel("Repeats")
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=3, title="Dashed: published")
    return figure


def _mark_published(axes: Axes, table: pd.DataFrame, poses: str, name: str, colour: str) -> None:
    if "published" not in table:
        return
    rows = table[(table["poses"] == poses) & (table["figure"] == name)].dropna(subset=["published"])
    for value in rows["published"]:
        axes.axvline(THOUSAND * value, color=colour, linestyle="--", linewidth=1.6)


def _scale_log(axis: Axis) -> None:
    """Put ticks at 1, 2 and 5 of a decade, at more where these are few, what is drawn already deciding the range."""
    low, high = axis.get_view_interval()
    coarse, fine = (
        [m * 10.0**e for e in range(-6, 4) for m in multiples if low <= m * 10.0**e <= high]
        for multiples in (COARSE, FINE)
    )
    axis.set_ticks(coarse if len(coarse) > 2 else fine)
    axis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    axis.set_minor_formatter(NullFormatter())


def draw_convergence(convergence: pd.DataFrame, parameters: pd.DataFrame) -> Figure:
    """Return the remaining errors of the first hardpoint's parameters after each iteration (figure 8)."""
    figure = Figure(figsize=(9.0, 3.6))
    left, right = figure.subplots(1, 2)
    ends = _published_ends(parameters)
    last = int(convergence["iteration"].max())
    for k, (name, rows) in enumerate(convergence.groupby("parameter", sort=False)):
        colour = (*LEG_COLOURS, INK)[k % 7]
        left.plot(rows["iteration"], rows["error_mm"], marker="o", markersize=3.5, color=colour, label=quote(str(name)))
        if str(name) in ends:
            left.plot([last + 0.3], [ends[str(name)]], marker="D", markersize=5.0, mfc="none", color=colour)
        step = rows["error_mm"].diff().abs().iloc[1:]
        right.plot(rows["iteration"].iloc[1:], step, marker="o", markersize=3.5, color=colour)
    left.axhline(0.0, color=GREY, linewidth=0.7)
    left.set_ylabel("Remaining error (mm)")
    left.legend(ncols=2, title="Diamonds: published end" if ends else None)
    right.axvline(3, color=GREY, linestyle="--", linewidth=1.0, label="published: settled after three")
    right.set_yscale("log")
    right.set_ylabel("Correction (mm)")
    right.legend()
    for axes in (left, right):
        axes.set_xlabel("Iteration")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def _published_ends(parameters: pd.DataFrame) -> dict[str, float]:
    """Return what the published calibration left of the errors, by parameter."""
    if "published_mm" not in parameters:
        return {}
    rows = parameters.dropna(subset=["published_mm"])
    return dict(zip(rows["parameter"], rows["published_mm"] - rows["preset_mm"], strict=True))


def draw_verification(verification: pd.DataFrame, table: pd.DataFrame) -> Figure:
    """Return position and attitude errors at every verification pose of one repeat (figure 9)."""
    figure = Figure(figsize=(9.0, 5.4))
    panels = figure.subplots(2, 1, sharex=True)
    titles = (("position_mm", "Position error (µm)"), ("attitude_deg", "Attitude error (mdeg)"))
    chosen = (("random", "unweighted"), ("optimal", "unweighted"), ("optimal", "weighted"))
    colours = (POSES_COLOURS["random"], POSES_COLOURS["optimal"], WEIGHTED_COLOUR)
    for axes, (column, title) in zip(panels, titles, strict=True):
        for (poses, weighting), colour in zip(chosen, colours, strict=True):
            rows = verification[(verification["poses"] == poses) & (verification["weighting"] == weighting)]
            label = f"{poses} poses, {LABELS[weighting]}"
            axes.plot(rows["pose"], THOUSAND * rows[column], ".", markersize=5.0, color=colour, label=label)
        _mark_levels(axes, table, column.partition("_")[0])
        axes.set_ylabel(title)
        axes.set_ylim(bottom=0.0)
    handles, names = panels[0].get_legend_handles_labels()
    key = "Published: mean dashed, largest dotted" if "published" in table else None
    figure.legend(handles, names, loc="outside upper center", ncols=3, title=key)
    panels[-1].set_xlabel("Verification pose")
    return figure


def _mark_levels(axes: Axes, table: pd.DataFrame, what: str) -> None:
    """Mark the published mean and largest errors."""
    if "published" not in table:
        return
    rows = table[table["figure"].str.startswith(what)].dropna(subset=["published"])
    for poses, name, value in zip(rows["poses"], rows["figure"], rows["published"], strict=True):
        line = "--" if "_mean_" in str(name) else ":"
        axes.axhline(THOUSAND * value, color=POSES_COLOURS[str(poses)], linestyle=line, linewidth=1.2)


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
    _mark_equality(axes, table)
    axes.set_yscale("log")
    _scale_log(axes.yaxis)
    axes.set_xlabel("Number of measured poses")
    axes.set_ylabel("Integrated error (mm and deg)")
    axes.legend(title="Mean; shaded: middle 95 %", alignment="left")
    return figure


def _mark_equality(axes: Axes, table: pd.DataFrame) -> None:
    """Mark what is published: the fewest selected poses do as well as 50 random ones."""
    rows = table[(table["poses"] == "optimal") & (table["weighting"] == "unweighted")]
    n, level = rows["n_poses"].iloc[0], rows["mean"].iloc[0]
    axes.plot([n, RANDOM_AS_GOOD], [level, level], ":", color=INK, linewidth=1.2)
    label = f"published: {n} selected poses as good as {RANDOM_AS_GOOD} random ones"
    axes.plot([RANDOM_AS_GOOD], [level], "D", mfc="none", markersize=8.0, color=INK, label=label)


def draw_indices(sets: pd.DataFrame, table: pd.DataFrame, unit: str = "deg") -> Figure:
    """Return histograms of the integrated error over parameter sets, all with one draw of the noise (figure 5)."""
    return _draw_by_condition(sets, table, unit)


def draw_indices_noise(draws: pd.DataFrame, table: pd.DataFrame, unit: str = "deg") -> Figure:
    """Return the same over draws of the noise and selections."""
    return _draw_by_condition(draws, table, unit)


def _draw_by_condition(errors: pd.DataFrame, table: pd.DataFrame, unit: str) -> Figure:
    conditions = list(dict.fromkeys(errors["condition"]))
    n_rows = -(-len(conditions) // 2)
    figure = Figure(figsize=(9.0, 2.7 * n_rows + 0.4))
    panels = figure.subplots(n_rows, 2, squeeze=False).flat
    for condition, axes in zip(conditions, panels, strict=False):
        _draw_condition(axes, errors[errors["condition"] == condition], table[table["condition"] == condition], unit)
        axes.set_title(f"Condition {condition}")
    for axes in list(panels):
        axes.set_visible(False)
    handles, names = figure.axes[0].get_legend_handles_labels()
    title = "Full line: mean found; dashed: published mean" if "published" in table else "Line: mean"
    figure.legend(handles, names, loc="outside upper center", ncols=5, title=title)
    return figure


def _draw_condition(axes: Axes, errors: pd.DataFrame, table: pd.DataFrame, unit: str) -> None:
    published = dict(zip(table["index"], table["published"], strict=True)) if "published" in table else {}
    values = errors[unit].dropna().to_numpy()
    bins = np.geomspace(values.min(), values.max() * (1 + 1e-9), 50).tolist()
    for index, ours in errors.groupby("index", sort=False):
        found, colour = ours[unit].dropna().to_numpy(), INDEX_COLOURS[str(index)]
        weights = np.full(len(found), 100.0 / len(found))
        axes.hist(found, bins, weights=weights, histtype="stepfilled", alpha=0.3, color=colour, label=str(index))
        axes.axvline(found.mean(), color=colour, linewidth=1.4)
        if index in published:
            axes.axvline(published[str(index)], color=colour, linewidth=1.4, linestyle="--")
    axes.set_xscale("log")
    _scale_log(axes.xaxis)
    axes.set_xlabel(f"Integrated error (mm and {unit})")
    axes.set_ylabel("Calibrations (%)")


def draw_best(best: pd.DataFrame, table: pd.DataFrame, unit: str = "deg") -> Figure:
    """Return each index's mean error by that of the first, with its interval and the published ratio."""
    rows = best[best["unit"] == unit]
    figure = Figure(figsize=(8.0, 3.8))
    axes = figure.subplots()
    conditions = list(dict.fromkeys(rows["condition"]))
    first = str(rows["index"].iloc[0])
    for k, (index, ours) in enumerate(rows.groupby("index", sort=False)):
        place = np.arange(len(conditions)) + 0.15 * (k - 2)
        colour = INDEX_COLOURS[str(index)]
        half = ours["high"] - ours["ratio"]
        axes.errorbar(place, ours["ratio"], yerr=half, fmt="o", color=colour, capsize=2.0, label=str(index))
        if "published" in table:
            pairs = table.set_index(["index", "condition"])["published"]
            ratio = [pairs[index, c] / pairs[first, c] for c in conditions]
            axes.plot(place + 0.05, ratio, "D", mfc="none", markersize=5.0, color=colour)
    axes.axhline(1.0, color=RED, linewidth=0.7)
    axes.set_yscale("log")
    _scale_log(axes.yaxis)
    axes.set_xticks(np.arange(len(conditions)), conditions)
    axes.set_xlabel("Measurement condition")
    axes.set_ylabel(f"Mean integrated error, {first} = 1")
    title = "Dots: found, 95 % intervals; diamonds: published" if "published" in table else None
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=5, title=title)
    return figure
