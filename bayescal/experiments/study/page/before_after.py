"""The first figure: errors at the tool of the machine before and after its calibration, against what is required."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing

from bayescal.experiments.study.page.results import ALL, StudyResults
from bayescal.report.blocks import Block, Cell, Column, Figure, Section, Table, make_table
from bayescal.report.numbers import format_percent, format_significant
from bayescal.report.style import GREY, LEG_COLOURS, RED
from bayescal.report.symbols import shown_in

BEFORE, AFTER = GREY, LEG_COLOURS[4]
HELD = (
    "Position errors at the tool of {n} held-back poses, which the calibration has not seen: share of poses whose "
    "error is not larger, before it (the machine as its tolerances expect it) and after it. {frame}"
)
PREDICTED = (
    "Predicted standard uncertainty of the tool, rms over the workspace: before the calibration by the tolerances, "
    "after it by what remains unknown. No poses are held back whose position an instrument saw. {frame}"
)
ALIGNED = "Base frames are fitted to the calibration poses, for both alike."
POSITION = "position"


def show_before_after(study: StudyResults) -> Section | None:
    """Return errors at the tool before and after; None where nothing tells where it is."""
    blocks: list[Block] = []
    held = study.table("before_after", study.chosen)
    held = held[held["use"] == "verification"]
    known = [row for row in study.rows("accuracy", study.chosen) if math.isfinite(row["after"])]
    if len(held):
        frame = ALIGNED if study.aligned else ""
        caption = HELD.format(n=len(held), frame=frame).strip()
        limit = _find_limit(study)
        blocks.append(Figure("before_after", caption, partial(draw_held_back, held, limit)))
        blocks.append(_tabulate_held_back(held))
    elif known:
        caption = PREDICTED.format(frame="Base and tool are aligned." if study.aligned else "").strip()
        blocks.append(Figure("before_after", caption, partial(draw_predicted, pd.DataFrame(known))))
    if required := _tabulate_required(study):
        blocks.append(required)
    return Section("Before and after", tuple(blocks)) if blocks else None


def _find_limit(study: StudyResults) -> float | None:
    """Return the largest position error that is allowed, mm; None where none is stated."""
    for row in study.rows("requirements", study.chosen):
        if row["requirement"] == POSITION:
            return float(row["limit_inner"])
    return None


def draw_held_back(held: pd.DataFrame, limit: float | None) -> Drawing:
    """Return the shares of poses whose error is not larger, errors in µm."""
    figure = Drawing(figsize=(6.4, 2.9), layout="constrained")
    axes = figure.subplots()
    for column, colour, label in (("before_mm", BEFORE, "before"), ("after_mm", AFTER, "after")):
        size = np.sort(1e3 * held[column].to_numpy())
        share = 100.0 * np.arange(1, len(size) + 1) / len(size)
        axes.step(size, share, where="post", color=colour, linewidth=1.4)
        rms = format_significant(float(np.sqrt(np.mean(size**2))), 2)
        axes.plot(size, share, "o", color=colour, markersize=4, label=f"{label} (rms {rms} µm)")
    if limit is not None:
        axes.axvline(1e3 * limit, color=RED, linewidth=1.2, label=f"required: {format_significant(1e3 * limit, 2)} µm")
    axes.set_xscale("log")
    axes.set_ylim(0.0, 105.0)
    axes.set_xlabel("Position error at the tool in µm")
    axes.set_ylabel("Share of poses in %")
    axes.grid(True)
    figure.legend(loc="outside upper left", ncols=3)
    return figure


def draw_predicted(known: pd.DataFrame) -> Drawing:
    """Return predicted uncertainties of the tool's numbers, a panel for each unit."""
    units = list(dict.fromkeys(known["unit"]))
    figure = Drawing(figsize=(6.4, 1.0 + 0.45 * len(known)), layout="constrained")
    ratios = [int((known["unit"] == unit).sum()) for unit in units]
    panels = np.atleast_1d(figure.subplots(len(units), height_ratios=ratios))
    for axes, unit in zip(panels, units, strict=True):
        rows = known[known["unit"] == unit]
        factor, name = shown_in(unit, None)
        place = np.arange(len(rows))
        axes.hlines(place, factor * rows["before"], factor * rows["after"], color=GREY, linewidth=1.0)
        for column, colour in (("before", BEFORE), ("after", AFTER)):
            axes.plot(factor * rows[column], place, "o", color=colour, markersize=6, label=column)
        axes.set_ylim(-0.6, len(rows) - 0.4)
        axes.grid(visible=True, axis="x")
        axes.set_yticks(place, list(rows["coordinate"]))
        axes.invert_yaxis()
        if (rows[["before", "after"]] > 0.0).to_numpy().all():
            axes.set_xscale("log")
        axes.set_xlabel(f"Standard uncertainty in {name}" if name else "Standard uncertainty")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)
    return figure


def _tabulate_held_back(held: pd.DataFrame) -> Table:
    columns = [Column("Machine", kind="text"), *(Column(one, "µm") for one in ("rms", "mean", "largest"))]
    rows: list[list[str | Cell]] = []
    for column, label in (("before_mm", "before the calibration"), ("after_mm", "after it")):
        size = 1e3 * held[column].to_numpy()
        numbers = np.sqrt(np.mean(size**2)), size.mean(), size.max()
        rows.append([label, *(format_significant(float(one), 2) for one in numbers)])
    return make_table("Position errors of held-back poses.", columns, rows)


def _tabulate_required(study: StudyResults) -> Table | None:
    rows: list[list[str | Cell]] = []
    for row in study.rows("requirements", study.chosen):
        unit, every = str(row["unit"]), row["requirement"] == ALL
        values = ["", ""] if every else [format_significant(row[one], 2) for one in ("limit", "error")]
        name = "all together" if every else str(row["requirement"])
        rows.append([name, "" if every else unit, *values, format_percent(row["probability"], 1)])
    if not rows:
        return None
    columns = [Column("Requirement", kind="text"), Column("Unit", kind="text"), Column("allowed")]
    columns += [Column("kept with 95 %"), Column("Probability")]
    return make_table(
        "Errors at every pose of the workspace, and with which probability they are allowed.", columns, rows
    )
