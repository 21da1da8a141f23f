"""The first figure: errors at the tool of the machine before and after its calibration, against what is required."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing

from bayescal.experiments.shared.knowledge_page import AFTER, BEFORE, illustrate_predicted
from bayescal.experiments.shared.rows import ToolUncertaintyRow
from bayescal.experiments.study.page.results import ALL, StudyResults
from bayescal.experiments.study.rows import RequirementResultRow
from bayescal.report.blocks import Block, Cell, Column, Figure, PageSection, Table, make_table
from bayescal.report.numbers import format_percent, format_significant
from bayescal.report.style import RED

HELD = "Position errors of {n} verification poses, before and after. {frame}"
ALIGNED = "Base frames fitted to calibration poses."
POSITION = "position"


def show_before_after(study: StudyResults) -> PageSection | None:
    """Return errors at the tool before and after; None where nothing tells where it is."""
    blocks: list[Block] = []
    held = study.table("before_after", study.chosen)
    held = held[held["use"] == "verification"]
    known = [row for row in study.rows(ToolUncertaintyRow, study.chosen) if math.isfinite(row.posterior_sd)]
    if len(held):
        frame = ALIGNED if study.aligned else ""
        caption = HELD.format(n=len(held), frame=frame).strip()
        limit = _find_limit(study)
        blocks.append(Figure("before_after", caption, partial(draw_held_back, held, limit)))
        blocks.append(_tabulate_held_back(held))
    elif known:
        blocks.append(illustrate_predicted(known, study.aligned))
    if required := _tabulate_required(study):
        blocks.append(required)
    return PageSection("Before and after", tuple(blocks)) if blocks else None


def _find_limit(study: StudyResults) -> float | None:
    """Return the largest position error that is allowed, mm; None where none is stated."""
    for row in study.rows(RequirementResultRow, study.chosen):
        if row.requirement == POSITION:
            return row.limit_inner
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
    axes.set_xlabel("Position error (µm)")
    axes.set_ylabel("Share of poses in %")
    axes.grid(True)
    figure.legend(loc="outside upper left", ncols=3)
    return figure


def _tabulate_held_back(held: pd.DataFrame) -> Table:
    columns = [Column("Machine", kind="text"), *(Column(one, "µm") for one in ("rms", "mean", "largest"))]
    rows: list[list[str | Cell]] = []
    for column, label in (("before_mm", "before the calibration"), ("after_mm", "after it")):
        size = 1e3 * held[column].to_numpy()
        numbers = np.sqrt(np.mean(size**2)), size.mean(), size.max()
        rows.append([label, *(format_significant(float(one), 2) for one in numbers)])
    return make_table("Verification position errors.", columns, rows)


def _tabulate_required(study: StudyResults) -> Table | None:
    rows: list[list[str | Cell]] = []
    for row in study.rows(RequirementResultRow, study.chosen):
        unit, every = row.unit, row.requirement == ALL
        values = ["", ""] if every else [format_significant(one, 2) for one in (row.limit, row.error)]
        name = "all together" if every else row.requirement
        rows.append([name, "" if every else unit, *values, format_percent(row.probability, 1)])
    if not rows:
        return None
    columns = [Column("Requirement", kind="text"), Column("Unit", kind="text"), Column("allowed")]
    columns += [Column("kept with 95 %"), Column("Probability")]
    return make_table("Workspace errors, probability to meet limits.", columns, rows)
