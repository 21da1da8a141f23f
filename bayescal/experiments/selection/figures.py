"""Figures of experiments on pose selection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from bayescal.report.numbers import format_fixed, format_plain
from bayescal.report.style import GREY, INK, LEG_COLOURS, MARKERS, PALE, RED

COLOURS = (LEG_COLOURS[4], LEG_COLOURS[5], LEG_COLOURS[2], LEG_COLOURS[3], LEG_COLOURS[0], LEG_COLOURS[1])


@dataclass(frozen=True)
class Quantity:
    """A column of errors, its name on an axis, and the column with its error bars, empty without any."""

    column: str
    label: str
    bars: str = ""


def draw_traces(traces: pd.DataFrame, criterion: str, n_poses: int, published: Mapping[str, int]) -> Figure:
    """Return the criterion by iteration, one line per repeat, after Yu, Wu and Wang 2023, figure 6.

    Parameters
    ----------
    traces : pandas.DataFrame
        Columns ``label``, ``criterion``, ``n_poses``, ``repeat``, ``iteration`` and ``value``.
    criterion : str
    n_poses : int
    published : mapping of label to int
        How many iterations were printed.
    """
    rows = traces[(traces["criterion"] == criterion) & (traces["n_poses"] == n_poses)]
    figure = Figure(figsize=(7.2, 3.6), layout="constrained")
    axes = figure.subplots()
    for k, (label, part) in enumerate(rows.groupby("label", sort=False)):
        colour = COLOURS[k % len(COLOURS)]
        for repeat, one in part.groupby("repeat"):
            first = repeat == part["repeat"].min()
            axes.plot(
                one["iteration"],
                one["value"],
                color=colour,
                linewidth=1.6 if first else 0.7,
                alpha=1.0 if first else 0.35,
                label=str(label) if first else None,
                zorder=4.0 - 0.1 * k,  # lines begin alike: that of the first label, the shorter one, stays visible
            )
        if label in published:
            name = f"{published[str(label)]} iterations printed ({label})"
            axes.axvline(published[str(label)], color=colour, linewidth=0.8, linestyle=":", label=name)
    axes.set(xlabel="Iteration", ylabel=f"{criterion} of {n_poses} poses")
    axes.grid(visible=True)
    axes.legend(loc="lower right")
    return figure


def draw_random_sets(sets: pd.DataFrame, criterion: str, mean: float | None, largest: float | None) -> Figure:
    """Return the histogram of a criterion over random sets of the first repeat, after figure 7.

    Parameters
    ----------
    sets : pandas.DataFrame
        Columns ``repeat`` and ``value``.
    criterion : str
    mean, largest : float, optional
        As published.
    """
    values = sets.loc[sets["repeat"] == sets["repeat"].min(), "value"].to_numpy()
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.hist(values, bins=40, color=PALE, edgecolor=GREY, linewidth=0.5)
    for value, label, style in ((values.mean(), "mean", "-"), (values.max(), "largest", "--")):
        axes.axvline(value, color=INK, linewidth=1.3, linestyle=style, label=f"{label} found {format_fixed(value, 5)}")
    for published, label, style in ((mean, "mean", "-"), (largest, "largest", "--")):
        if published is not None:
            name = f"{label} published {format_fixed(published, 5)}"
            axes.axvline(published, color=RED, linewidth=1.3, linestyle=style, label=name)
    axes.set(xlabel=criterion, ylabel=f"Sets of {len(values)}")
    axes.legend(loc="upper left")
    return figure


def draw_ratios(table: pd.DataFrame) -> Figure:
    """Return values found by those published, best and mean with standard deviation over repeats.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``label``, ``criterion``, ``n_poses``, ``published``, ``best``, ``mean`` and ``sd``.
    """
    labels = list(dict.fromkeys(table["label"]))
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    all_axes = figure.subplots(1, len(labels), sharey=True, squeeze=False)[0]
    for axes, label in zip(all_axes, labels, strict=True):
        rows = table[table["label"] == label]
        at = np.arange(len(rows))
        mean, sd = rows["mean"] / rows["published"], rows["sd"].fillna(0.0) / rows["published"]
        axes.axhline(1.0, color=RED, linewidth=1.0, label="published")
        axes.errorbar(
            at, mean, yerr=sd, color=INK, marker="o", markersize=4, linestyle="none", capsize=2, label="mean ± sd"
        )
        axes.plot(at, rows["best"] / rows["published"], "^", color=COLOURS[0], markersize=5, label="best")
        names = [f"{c} {n}" for c, n in zip(rows["criterion"], rows["n_poses"], strict=True)]
        axes.set_xticks(at, names, rotation=90)
        axes.set_title(label)
        axes.grid(visible=True, axis="y")
    all_axes[0].set_ylabel("Found / published")
    all_axes[-1].legend(loc="best")
    return figure


def draw_errors(
    summary: pd.DataFrame, names: Sequence[str], designs: pd.DataFrame, quantities: Sequence[Quantity]
) -> Figure:
    """Return errors after calibration against the number of poses, one line per way to choose them.

    Parameters
    ----------
    summary : pandas.DataFrame
        Columns ``name``, ``n_poses`` and those of the quantities.
    names : sequence of str
        Which lines, in the order of their colours.
    designs : pandas.DataFrame
        The same columns, for sets of poses that somebody else has chosen: single points.
    quantities : sequence of Quantity
        One panel each.
    """
    figure = Figure(figsize=(4.6 * len(quantities), 3.7), layout="constrained")
    panels = figure.subplots(1, len(quantities), squeeze=False)[0]
    for axes, quantity in zip(panels, quantities, strict=True):
        for k, name in enumerate(names):
            rows = summary[summary["name"] == name]
            shift = 1.0 + 0.012 * (k - 0.5 * (len(names) - 1))
            _draw_bars(axes, rows, quantity, shift, COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)], name, "-")
        for k, (design, rows) in enumerate(designs.groupby("name", sort=False)):
            _draw_bars(axes, rows, quantity, 1.0, INK, MARKERS[-1 - k % len(MARKERS)], str(design), "none")
        axes.set(xscale="log", yscale="log", xlabel="Number of poses", ylabel=quantity.label)
        ticks = sorted(set(summary["n_poses"]))
        axes.set_xticks(ticks, [str(n) for n in ticks])
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.grid(visible=True)
    panels[0].legend()
    return figure


def _draw_bars(
    axes: Axes, rows: pd.DataFrame, quantity: Quantity, shift: float, colour: str, marker: str, name: str, line: str
) -> None:
    mean = rows[quantity.column].to_numpy(dtype=float)
    bars = np.nan_to_num(rows[quantity.bars].to_numpy(dtype=float)) if quantity.bars else np.zeros(len(mean))
    axes.errorbar(
        rows["n_poses"] * shift,
        mean,
        yerr=np.stack([np.minimum(bars, 0.9 * mean), bars]),
        color=colour,
        marker=marker,
        markersize=4.5,
        linestyle=line,
        linewidth=1.0,
        capsize=2.0,
        label=name,
    )


def draw_paired(table: pd.DataFrame, reference: str) -> Figure:
    """Return errors by those of a reference with the same machines, predicted and simulated, with standard errors.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``name``, ``n_poses``, ``predicted``, ``simulated`` and ``simulated_se``, ratios all.
    reference : str
    """
    numbers = sorted(set(table["n_poses"]))
    names = list(dict.fromkeys(table["name"]))
    figure = Figure(figsize=(3.0 * len(numbers), 3.4), layout="constrained")
    panels = figure.subplots(1, len(numbers), sharey=True, squeeze=False)[0]
    for axes, n in zip(panels, numbers, strict=True):
        rows = table[table["n_poses"] == n].set_index("name").reindex(names)
        at = np.arange(len(names))
        axes.axhline(1.0, color=GREY, linewidth=1.0)
        axes.plot(at - 0.1, rows["predicted"], "s", color=COLOURS[1], markersize=5, label="predicted")
        axes.errorbar(
            at + 0.1,
            rows["simulated"],
            yerr=2.0 * rows["simulated_se"],
            color=INK,
            marker="o",
            markersize=4.5,
            linestyle="none",
            capsize=2.5,
            label="simulated ± 2 standard errors",
        )
        axes.set_xticks(at, names, rotation=30, ha="right")
        axes.set_title(f"{n} poses")
        axes.grid(visible=True, axis="y")
        axes.yaxis.set_major_locator(MaxNLocator(6))
    panels[0].set_ylabel(f"Error by that of {reference}")
    panels[0].legend(loc="upper left")
    return figure
