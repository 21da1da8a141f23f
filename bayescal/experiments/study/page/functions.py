"""Errors of sensors that are functions with a stated scale: of what a sensor reads, of the rows' order."""

from __future__ import annotations

import math
from functools import partial

import pandas as pd
from matplotlib.figure import Figure as Drawing

from bayescal.experiments.shared.rows import ErrorFunctionRow
from bayescal.experiments.shared.study_schema import stem_of
from bayescal.experiments.study.page.model_error import bracket
from bayescal.experiments.study.page.results import StudyResults
from bayescal.report.blocks import Block, Column, Figure, Level, PageSection, Statement, make_table
from bayescal.report.numbers import format_fixed, format_significant
from bayescal.report.style import GREY, LEG_COLOURS
from bayescal.report.symbols import quote, set_parameter, split_name

SHARE, CERTAIN = 0.5, 0.9995
OPEN = 0.2
"""How far from its prior a probability has to be to say something: odds of 7 to 3."""
UNITS = {"um": "µm"}
INPUTS = {"reading": "the reading", "commands": "the machine's position", "order": "the order of rows"}
SCALES = "Scale: sd at the end of the range. sd / prior sd: of its logarithm."


def _title_functions(study: StudyResults) -> dict[str, str]:
    """Return titles of the variants whose sensors may have such errors, by name."""
    rows = study.table("variants")
    own = rows[rows["variant"].isin(study.table("functions")["variant"])]
    return dict(zip(own["variant"].astype(str), own["title"].astype(str), strict=True))


def state_functions(study: StudyResults) -> list[Statement]:
    """Return for each variant and kind of sensors whether they have systematic errors, and how large."""
    found = list[Statement]()
    for name in _title_functions(study) if study.has("functions") else ():
        kinds: dict[tuple[str, str], list[ErrorFunctionRow]] = {}
        for row in study.rows(ErrorFunctionRow, name):
            kinds.setdefault((split_name(row.sensor)[0], INPUTS[row.input]), []).append(row)
        for (kind, of), own in kinds.items():
            largest = max(own, key=lambda row: row.rms)
            present = max(row.probability_present for row in own)
            percent = "P > 99.9 %" if present > CERTAIN else f"P = {format_fixed(100.0 * present, 1)} %"
            level: Level = "good"
            text = f"{study.label(name)}: no systematic error needed in {kind} ({percent})."
            if abs(present - SHARE) < OPEN:
                text, level = f"{study.label(name)}: systematic error in {kind} not determined ({percent}).", "plain"
            elif present > SHARE:
                size = f"{largest.sensor} {format_significant(largest.rms, 2)} {_name_unit(largest)} rms"
                text, level = (
                    f"{study.label(name)}: systematic error in {kind} by {of} ({percent}); {size}.",
                    "warning",
                )
            value = largest.rms if present > SHARE else math.nan
            unit = _name_unit(largest) if present > SHARE else ""
            found.append(Statement(text, level, "Sensors' errors", value=value, unit=unit))
    return found


def _name_unit(row: ErrorFunctionRow) -> str:
    return UNITS.get(row.unit, row.unit)


def show_functions(study: StudyResults) -> PageSection | None:
    """Return whether sensors err by functions, how large these are and of what; None where no variant has any."""
    if not study.has("functions"):
        return None
    titles = _title_functions(study)
    columns = [Column("Variant", kind="text"), Column("Kernel", kind="text"), Column("Sensor", kind="text")]
    columns += [Column("Function of", kind="text")]
    columns += [Column("Unit", kind="text"), Column("Present", "%"), Column("Scale stated"), Column("Scale found")]
    columns += [Column("sd / prior sd", "%"), Column("Size", "rms, mean [5 %, 95 %]")]
    rows = [
        [
            titles[row.variant],
            row.kernel,
            row.sensor,
            INPUTS[row.input],
            _name_unit(row),
            format_fixed(100.0 * row.probability_present, 1),
            format_significant(row.scale_stated),
            format_significant(row.scale, 2),
            format_significant(100.0 * row.log_scale_sd_ratio, 2),
            bracket(format_significant(one, 2) for one in (row.rms, row.rms_low, row.rms_high)),
        ]
        for row in study.rows(ErrorFunctionRow)
    ]
    table = make_table("Systematic sensor errors.", columns, rows, [Statement(SCALES)], style="wide")
    blocks: list[Block] = [table]
    for name, title in titles.items():
        own = study.table("function_curves", name)
        caption = f"{title}: systematic errors, mean and 90 % interval."
        blocks += [] if own.empty else [Figure(f"functions_{stem_of(name)}", caption, partial(_draw_functions, own))]
    return PageSection("Systematic sensor errors", tuple(blocks))


def _draw_functions(curves: pd.DataFrame) -> Drawing:
    """Return a panel for each kind of sensor and input: errors with their 90 % intervals over what they depend on."""
    kinds: dict[tuple[str, str], list[str]] = {}
    for sensor, of in dict.fromkeys(zip(curves["sensor"].astype(str), curves["input"].astype(str), strict=True)):
        kinds.setdefault((split_name(sensor)[0], of), []).append(sensor)
    n_rows = math.ceil(len(kinds) / 2)
    figure = Drawing(figsize=(9.4, 0.4 + 2.8 * n_rows))
    grid = figure.subplots(n_rows, 2, squeeze=False).ravel()
    for axes, ((kind, of), sensors) in zip(grid, kinds.items(), strict=False):
        for k, sensor in enumerate(sensors):
            own, colour = (
                curves[(curves["sensor"] == sensor) & (curves["input"] == of)],
                LEG_COLOURS[k % len(LEG_COLOURS)],
            )
            axes.fill_between(own["reading"], own["low"], own["high"], color=colour, alpha=0.2, linewidth=0.0)
            axes.plot(own["reading"], own["mean"], color=colour, label=set_parameter(sensor))
        unit = str(curves[curves["sensor"] == sensors[0]]["unit"].iloc[0])
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        inner = {"um": "mm", "arcsec": "rad"}.get(unit, unit)
        axes.set_xlabel(f"reading of {quote(kind)} ({inner})" if of == "reading" else "row")
        axes.set_ylabel(f"error of {quote(kind)} ({UNITS.get(unit, unit)})")
        axes.legend(ncols=2)
    for axes in grid[len(kinds) :]:
        axes.set_axis_off()
    return figure
