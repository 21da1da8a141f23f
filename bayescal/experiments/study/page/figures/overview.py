"""The variants in the order of their evidence, with their pose errors beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, SymmetricalLogLocator

from bayescal.experiments.study.page.results import ErrorScale
from bayescal.experiments.study.page.styles import Styles
from bayescal.report.numbers import format_fixed, format_pair, format_power
from bayescal.report.style import INK, PALE

THICKNESS = 0.62


def draw_overview(
    groups: Sequence[Sequence[str]],
    behind: Mapping[tuple[str, str], float],
    predictions: pd.DataFrame,
    scales: Sequence[ErrorScale],
    use: str,
    styles: Styles,
) -> Figure:
    """Return panels with a row per variant: evidence, position error, orientation error where it was measured.

    Parameters
    ----------
    groups : sequence of sequences of str
        Variants from top to bottom; those of a group, which the evidence does not tell apart, share a band.
    behind : mapping
        Log-evidence below the best, nats, by variant and setting of the model error.
    predictions : DataFrame
        Rows of all variants, settings of the model error and poses.
    scales : sequence of ErrorScale
        Of the errors that were measured.
    use : str
        The poses whose errors are shown.
    styles : mapping
    """
    names = [name for group in groups for name in group]
    figure = Figure(figsize=(9.4, 0.75 + 0.265 * len(names)))
    axes = figure.subplots(1, 2 + len(scales), sharey=True, width_ratios=[1.0] * (1 + len(scales)) + [0.8])
    for panel in axes:
        _draw_bands(panel, groups)
    _draw_evidence(axes[0], names, behind, styles)
    chosen = predictions[predictions["use"] == use]
    for panel, scale in zip(axes[1:-1], scales, strict=True):
        _draw_errors(panel, names, chosen, scale, styles)
        panel.set_xlabel(f"{scale.label},\n{use}")
    _draw_without(axes[-1], names, behind)
    axes[0].set_yticks(range(len(names)), [styles[name].label for name in names])
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    return figure


def _draw_bands(axes: Axes, groups: Sequence[Sequence[str]]) -> None:
    top = -0.5
    for k, group in enumerate(groups):
        if k % 2 == 0 and len(groups) > 1:
            axes.axhspan(top, top + len(group), color=PALE, alpha=0.4, linewidth=0)
        top += len(group)
    axes.grid(axis="x")
    axes.tick_params(axis="y", length=0)


def _draw_evidence(axes: Axes, names: Sequence[str], behind: Mapping[tuple[str, str], float], styles: Styles) -> None:
    free = [max(0.0, behind[name, "free"]) for name in names]
    axes.barh(range(len(names)), free, height=THICKNESS, color=[styles[n].colour for n in names], linewidth=0)
    _scale_evidence(axes, free)
    _write_beside(axes, free, [format_fixed(-one, 1) for one in free])
    axes.set_xlabel("Log-evidence below\nthe best (nat)")


def _draw_without(axes: Axes, names: Sequence[str], behind: Mapping[tuple[str, str], float]) -> None:
    """Draw the evidence without model error, each below the best of those."""
    zero = [max(0.0, behind[name, "zero"]) for name in names]
    axes.plot(zero, range(len(names)), "D", markersize=4, color="white", markeredgecolor=INK, markeredgewidth=0.8)
    _scale_evidence(axes, zero)
    _write_beside(axes, zero, [format_fixed(-one, 1) for one in zero])
    axes.set_xlabel("The same with τ = 0,\nbelow the best of those")


def _scale_evidence(axes: Axes, values: Sequence[float]) -> None:
    axes.set_xscale("symlog", linthresh=1.0, linscale=0.5)
    axes.set_xlim(0, 100 * max(1.0, *values))
    locator = axes.xaxis.get_major_locator()
    if isinstance(locator, SymmetricalLogLocator):
        locator.set_params(numticks=4)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: format_power(value, 1)))


def _write_beside(axes: Axes, ends: Sequence[float], texts: Sequence[str]) -> None:
    """Write numbers at the ends of the bars that they belong to."""
    for k, (end, text) in enumerate(zip(ends, texts, strict=True)):
        axes.annotate(text, (end, k), (5, 0), textcoords="offset points", va="center", fontsize=8)


def _draw_errors(
    axes: Axes, names: Sequence[str], predictions: pd.DataFrame, scale: ErrorScale, styles: Styles
) -> None:
    errors = scale.factor * predictions.groupby(["variant", "model_error"])[scale.column].agg(["mean", "max"])
    mean, largest = ([float(errors[which][name, "free"]) for name in names] for which in ("mean", "max"))
    rows, colours = range(len(names)), [styles[name].colour for name in names]
    axes.barh(rows, largest, height=THICKNESS, color=colours, alpha=0.35, linewidth=0)
    axes.barh(rows, mean, height=THICKNESS, color=colours, linewidth=0)
    _write_beside(axes, largest, [format_pair(*both, 2) for both in zip(mean, largest, strict=True)])
    axes.set_xlim(0, 1.45 * max(largest) or 1.0)
