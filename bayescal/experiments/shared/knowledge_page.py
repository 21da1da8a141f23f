"""How accurate a machine is, what its readings do not determine and where to measure next, as blocks of any page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bayescal.experiments.shared.rows import CandidatePoseRow, CombinationRow, ToolUncertaintyRow
from bayescal.report.blocks import (
    Block,
    Cell,
    Column,
    Figure,
    Fold,
    KeyFigure,
    Level,
    PageSection,
    Statement,
    Table,
    make_section,
    make_table,
)
from bayescal.report.numbers import format_fixed, format_percent, format_significant
from bayescal.report.row_tables import tabulate_rows
from bayescal.report.style import GREY, LEG_COLOURS
from bayescal.report.symbols import ChosenUnits, format_place, name_unit, shown_in

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure as Drawing

VERDICT_LEVELS: dict[str, Level] = {
    "identifiable": "good",
    "weak": "warning",
    "not": "bad",
    "noise": "plain",
    "several": "warning",
}
"""How good the news of a parameter's verdict is."""
NO_TOOL = "No tool in the machine's class: coordinates are reported."
TOOL_ACTION = "State tool_channels and tool()."
BEFORE, AFTER = GREY, LEG_COLOURS[4]
WORTHWHILE = 0.01  # of the mean squared error; what promises less is no advice
SENSORS = {"all": "all", "own": "own"}


def name_titles(tables: Mapping[str, pd.DataFrame]) -> dict[str, str]:
    """Return what the variants are called by their names."""
    return (
        dict(zip(tables["variants"]["variant"], tables["variants"]["title"], strict=True))
        if "variants" in tables
        else {}
    )


def is_aligned(accuracy: pd.DataFrame) -> bool:
    """Whether a table of accuracies says what remains of errors once base and tool are aligned."""
    return bool((accuracy["frame"] == "aligned").any())


def show_predicted_error(known: Sequence[ToolUncertaintyRow], asked: ChosenUnits = None) -> KeyFigure:
    """Return the predicted sd before and after calibration of the tool's least known length, else of its first."""
    lengths = [row for row in known if row.unit == "mm"] or list(known[:1])
    worst = max(lengths, key=lambda row: row.posterior_sd)
    factor, unit = shown_in(worst.unit, asked)
    before, after = (format_significant(factor * one, 2) for one in (worst.prior_sd, worst.posterior_sd))
    level: Level = "good" if worst.posterior_sd < 0.5 * worst.prior_sd else "warning"
    return KeyFigure(f"Predicted sd of {worst.coordinate}", f"{before} → {after}", unit, level)


def show_predicted(rows: Sequence[ToolUncertaintyRow], aligned: bool) -> list[PageSection]:
    """Return the tool's uncertainty before and after calibration as a section; none where nothing tells it."""
    known = [row for row in rows if math.isfinite(row.posterior_sd)]
    return [PageSection("Before, after", (illustrate_predicted(known, aligned),))] if known else []


def illustrate_predicted(known: Sequence[ToolUncertaintyRow], aligned: bool) -> Figure:
    """Return the tool's uncertainty before and after calibration in a picture."""
    caption = "Predicted tool uncertainty, rms over the workspace."
    caption += " After best-fit alignment." if aligned else ""
    return Figure("before_after", caption, partial(draw_predicted, ToolUncertaintyRow.collect(known)))


def draw_predicted(known: pd.DataFrame) -> Drawing:
    """Return predicted uncertainties of the tool's numbers, a panel for each unit."""
    from matplotlib.figure import Figure as Drawing  # a second to import, for those who draw

    units = list(dict.fromkeys(known["unit"]))
    figure = Drawing(figsize=(6.4, 1.0 + 0.45 * len(known)), layout="constrained")
    ratios = [int((known["unit"] == unit).sum()) for unit in units]
    panels = np.atleast_1d(figure.subplots(len(units), height_ratios=ratios))
    for axes, unit in zip(panels, units, strict=True):
        rows = known[known["unit"] == unit]
        factor, name = shown_in(unit, None)
        place = np.arange(len(rows))
        axes.hlines(place, factor * rows["prior_sd"], factor * rows["posterior_sd"], color=GREY, linewidth=1.0)
        for column, colour, label in (("prior_sd", BEFORE, "before"), ("posterior_sd", AFTER, "after")):
            axes.plot(factor * rows[column], place, "o", color=colour, markersize=6, label=label)
        axes.set_ylim(-0.6, len(rows) - 0.4)
        axes.grid(visible=True, axis="x")
        axes.set_yticks(place, list(rows["coordinate"]))
        axes.invert_yaxis()
        if (rows[["prior_sd", "posterior_sd"]] > 0.0).to_numpy().all():
            axes.set_xscale("log")
        axes.set_xlabel(f"Standard uncertainty in {name}" if name else "Standard uncertainty")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)
    return figure


def show_accuracy(
    tables: Mapping[str, pd.DataFrame], variant: str = "", asked: ChosenUnits = None
) -> PageSection | None:
    """Return how accurate each variant's tool is, or its coordinates where no tool is stated.

    All others are folded behind a ``variant`` that is named.
    """
    if "accuracy" not in tables:
        return None
    text = "Standard uncertainty (k = 1) of the tool"
    text += ", after best-fit alignment" if is_aligned(tables["accuracy"]) else "."
    first = tables["accuracy"]["variant"] == variant
    every, titles = tables["accuracy"], name_titles(tables)
    blocks: list[Block] = [_tabulate_accuracy(every[first] if first.any() else every, titles, asked)]
    if first.any() and not first.all():
        blocks.append(Fold("Other variants", (_tabulate_accuracy(every[~first], titles, asked),)))
    return PageSection("Tool uncertainty", (text, *blocks))


def _tabulate_accuracy(accuracy: pd.DataFrame, titles: Mapping[str, str], asked: ChosenUnits) -> Table:
    """Return the rows of some variants."""
    rows = [replace(row, variant=titles[row.variant]) for row in ToolUncertaintyRow.read(accuracy)]
    without = () if is_aligned(accuracy) else ("unaligned_sd", "max_unaligned_sd")
    return tabulate_rows("Predicted uncertainty.", rows, asked, without)


def state_ridges(tables: Mapping[str, pd.DataFrame], variant: str) -> list[Statement]:
    """Return the combinations that a variant's readings leave undetermined; nothing where there are none."""
    if "ridges" not in tables:
        return []
    mine = tables["ridges"][tables["ridges"]["variant"] == variant]
    return [
        Statement(f"Contraction {format_fixed(row.contraction, 2)}: {row.text}") for row in CombinationRow.read(mine)
    ]


def _read_candidates(tables: Mapping[str, pd.DataFrame], variant: str) -> list[CandidatePoseRow]:
    """Return a variant's candidate poses whose variance reduction is known, with its coordinates alone."""
    found = [one for one in CandidatePoseRow.read(tables["next"]) if one.variant == variant] if "next" in tables else []
    known = [one for one in found if math.isfinite(one.variance_reduction)]
    return [replace(one, others={name: x for name, x in one.others.items() if math.isfinite(x)}) for one in known]


def state_next(tables: Mapping[str, pd.DataFrame], variant: str, asked: ChosenUnits = None) -> list[Statement]:
    """Return where to measure next with each set of sensors, where that promises something."""
    first = {one.sensors: one for one in reversed(_read_candidates(tables, variant))}
    found = []
    for sensors, row in reversed(first.items()):
        if row.variance_reduction < WORTHWHILE:
            continue
        place = [
            f"{name.rpartition('_')[0]} = {format_place(name, value, asked)} {name_unit(name, asked)}"
            for name, value in row.others.items()
        ]
        text = f"Best candidate pose ({SENSORS[sensors]} sensors): {', '.join(place)}."
        gain = 1.0 - math.sqrt(max(0.0, 1.0 - row.variance_reduction))
        action = f"Measure it: error −{format_percent(gain, 1)}."
        found.append(Statement(text, lead="Next", value=100.0 * gain, unit="%", action=action))
    return found


def show_next(tables: Mapping[str, pd.DataFrame], variant: str, asked: ChosenUnits = None) -> list[PageSection]:
    """Return the candidate poses that reduce a variant's error most."""
    mine = _read_candidates(tables, variant)
    if not mine:
        return []
    names = list(mine[0].others)
    columns = [Column("Sensors", kind="text")]
    columns += [Column(name.rpartition("_")[0], name_unit(name, asked)) for name in names]
    columns.append(Column("Error falls by"))
    rows: list[list[str | Cell]] = [
        [
            SENSORS[row.sensors],
            *(format_place(name, row.others[name], asked) for name in names),
            format_percent(1.0 - math.sqrt(max(0.0, 1.0 - row.variance_reduction)), 1),  # of the error itself
        ]
        for row in mine
    ]
    text = ("Error: rms tool uncertainty over the workspace.",)
    table = make_table("Best candidate pose.", columns, rows)
    return [make_section("Next measurement", text, (table,))]
