"""Errors of sensors that are functions with a stated scale: of what a sensor reads, of the rows' order."""

from __future__ import annotations

import math
from functools import partial

import pandas as pd
from matplotlib.figure import Figure as Drawing

from bayescal.experiments.frame.results import Row
from bayescal.experiments.shared.study_schema import stem_of
from bayescal.experiments.study.page.model_error import bracket
from bayescal.experiments.study.page.results import StudyResults
from bayescal.report.blocks import Block, Column, Figure, Level, Section, Statement, make_table
from bayescal.report.numbers import format_fixed, format_significant, join_words
from bayescal.report.style import GREY, LEG_COLOURS
from bayescal.report.symbols import quote, set_parameter, split_name

SHARE, CERTAIN = 0.5, 0.9995
UNITS = {"um": "µm"}
INPUTS = {"reading": "what they read", "commands": "where the machine is", "order": "the order of the rows"}
FUNCTIONS = (
    "A scale that is off, an encoder that sits askew or a drift is the same function every time: of the sensor's own "
    "reading, of where the machine is, or of the order of the rows. Whether there is such an error is for the "
    "readings to say, its prior probability being one half. A geometry that is off imitates much of it, and the part "
    "of an error that the readings do not determine is as wide as its scale: the intervals hold it."
)
SCALES = (
    "Scale: what a sensor errs by at the end of its range, one standard deviation, where there is an error; left of "
    "prior: sd of its logarithm over that of its prior, near 100 % where the scale is what was stated."
)


def _title_functions(study: StudyResults) -> dict[str, str]:
    """Return titles of the variants whose sensors may have such errors, by name."""
    rows = study.table("variants")
    own = rows[rows["variant"].isin(study.table("functions")["variant"])]
    return dict(zip(own["variant"].astype(str), own["title"].astype(str), strict=True))


def state_functions(study: StudyResults) -> list[Statement]:
    """Return in a sentence for each variant which sensors err by how much."""
    statements = []
    for name, title in (_title_functions(study) if study.has("functions") else {}).items():
        kinds: dict[tuple[str, str], list[Row]] = {}
        for row in study.rows("functions", name):
            kinds.setdefault((split_name(str(row["sensor"]))[0], INPUTS[row["of"]]), []).append(row)
        parts = list[str]()
        level: Level = "good"
        for (kind, of), own in kinds.items():
            largest = max(own, key=lambda row: row["rms"])
            present = max(row["present"] for row in own)
            percent = "above 99.9 %" if present > CERTAIN else f"{format_fixed(100.0 * present, 1)} %"
            text = f"need none of {of} (probability {percent})"
            if present > SHARE:
                level = "warning"
                size = f"{format_significant(largest['rms'], 2)} {_name_unit(largest)} rms"
                text = f"err by functions of {of} (probability {percent}), {largest['sensor']} most, {size}"
            parts.append(f"sensors {kind} {text}")
        statements.append(Statement(f"“{title}”: {join_words(parts)}.", level, "Sensors' errors"))
    return statements


def _name_unit(row: Row) -> str:
    return UNITS.get(str(row["unit"]), str(row["unit"]))


def show_functions(study: StudyResults) -> Section | None:
    """Return whether sensors err by functions, how large these are and of what; None where no variant has any."""
    if not study.has("functions"):
        return None
    titles = _title_functions(study)
    columns = [Column("Variant", kind="text"), Column("Kernel", kind="text"), Column("Sensor", kind="text")]
    columns += [Column("Function of", kind="text")]
    columns += [Column("Unit", kind="text"), Column("Present", "%"), Column("Scale stated"), Column("Scale found")]
    columns += [Column("left of prior", "%"), Column("Size", "rms over the poses, mean [5 %, 95 %]")]
    rows = [
        [
            titles[str(row["variant"])],
            str(row["kernel"]),
            str(row["sensor"]),
            INPUTS[row["of"]].replace("they read", "it reads"),
            _name_unit(row),
            format_fixed(100.0 * row["present"], 1),
            format_significant(row["scale_stated"]),
            format_significant(row["scale"], 2),
            format_significant(100.0 * row["left"], 2),
            bracket(format_significant(row[key], 2) for key in ("rms", "rms_low", "rms_high")),
        ]
        for row in study.rows("functions")
    ]
    table = make_table("Sensors' errors that are functions.", columns, rows, [Statement(SCALES)], style="wide")
    blocks: list[Block] = [FUNCTIONS, table]
    for name, title in titles.items():
        own = study.table("function_curves", name)
        caption = f"{title}: errors over what they depend on, mean and 90 % interval."
        blocks += [] if own.empty else [Figure(f"functions_{stem_of(name)}", caption, partial(_draw_functions, own))]
    return Section("Errors that are functions", tuple(blocks))


def _draw_functions(curves: pd.DataFrame) -> Drawing:
    """Return a panel for each kind of sensor and input: errors with their 90 % intervals over what they depend on."""
    kinds: dict[tuple[str, str], list[str]] = {}
    for sensor, of in dict.fromkeys(zip(curves["sensor"].astype(str), curves["of"].astype(str), strict=True)):
        kinds.setdefault((split_name(sensor)[0], of), []).append(sensor)
    n_rows = math.ceil(len(kinds) / 2)
    figure = Drawing(figsize=(9.4, 0.4 + 2.8 * n_rows))
    grid = figure.subplots(n_rows, 2, squeeze=False).ravel()
    for axes, ((kind, of), sensors) in zip(grid, kinds.items(), strict=False):
        for k, sensor in enumerate(sensors):
            own, colour = curves[(curves["sensor"] == sensor) & (curves["of"] == of)], LEG_COLOURS[k % len(LEG_COLOURS)]
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
