"""Errors that are functions, on pages: whether there are any, how large, of which sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

import pandas as pd
from matplotlib.figure import Figure as Drawing

from bayescal.experiments.frame.results import Row, list_rows
from bayescal.experiments.shared.study_schema import stem_of
from bayescal.report.blocks import Block, Cell, Column, Figure, Level, Section, Statement, make_table
from bayescal.report.numbers import NOTHING, format_fixed, format_significant, join_words
from bayescal.report.style import GREY, LEG_COLOURS
from bayescal.report.symbols import quote, set_parameter, split_name

COLUMNS = 2
SHARE, CERTAIN = 0.5, 0.9995
SHOWN = {"um": "µm"}
INPUTS = {"reading": "what they read", "commands": "where the machine is", "order": "the order of the rows"}
TEXT = (
    "A scale that is off, an encoder that sits askew or a drift is the same function every time: of the sensor's own "
    "reading, of where the machine is, or of the order of the rows. Whether there is such an error is for the "
    "readings to say, its prior probability being one half. A geometry that is off imitates much of it, and the part "
    "of an error that the readings do not determine is as wide as its scale: the intervals hold it."
)
NOTE = (
    "Scale: what a sensor errs by at the end of its range, one standard deviation, where there is an error; left of "
    "prior: sd of its logarithm over that of its prior, near 100 % where the scale is what was stated."
)


def show_functions(tables: Mapping[str, pd.DataFrame]) -> list[Section]:
    """Return the section on such errors; nothing where no variant has any."""
    if "functions" not in tables:
        return []
    blocks: list[Block] = [TEXT, _tabulate(tables)]
    curves = tables.get("function_curves", pd.DataFrame(columns=["variant"]))
    for name, title in _list_titles(tables).items():
        own = curves[curves["variant"] == name]
        caption = f"{title}: errors over what they depend on, mean and 90 % interval."
        blocks += [] if own.empty else [Figure(f"functions_{stem_of(name)}", caption, partial(draw_functions, own))]
    return [Section("Errors that are functions", tuple(blocks))]


def judge_functions(tables: Mapping[str, pd.DataFrame]) -> list[Statement]:
    """Return in a sentence for each variant which sensors err by how much."""
    if "functions" not in tables:
        return []
    table = tables["functions"]
    return [_judge(title, list_rows(table[table["variant"] == name])) for name, title in _list_titles(tables).items()]


def _judge(title: str, rows: list[Row]) -> Statement:
    kinds: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        kinds.setdefault((split_name(str(row["sensor"]))[0], INPUTS[row["of"]]), []).append(row)
    parts = []
    level: Level = "good"
    for (kind, of), own in kinds.items():
        largest = max(own, key=lambda row: row["rms"])
        present = max(row["present"] for row in own)
        chance = _format_chance(present)
        if present > SHARE:
            level = "warning"
            size = f"{format_significant(largest['rms'], 2)} {_unit(largest['unit'])} rms"
            parts.append(f"sensors {kind} err by functions of {of} ({chance}), {largest['sensor']} most, {size}")
        else:
            parts.append(f"sensors {kind} need none of {of} ({chance})")
    return Statement(f"“{title}”: {join_words(parts)}.", level, "Sensors' errors")


def _unit(name: str) -> str:
    return SHOWN.get(name, name)


def _format_chance(present: float) -> str:
    if present > CERTAIN:
        return "probability above 99.9 %"
    return f"probability {format_fixed(100.0 * present, 1)} %"


def _list_titles(tables: Mapping[str, pd.DataFrame]) -> dict[str, str]:
    """Return names and titles of the variants with such errors."""
    rows = tables["variants"]
    own = rows[rows["variant"].isin(tables["functions"]["variant"])]
    return dict(zip(own["variant"].astype(str), own["title"].astype(str), strict=True))


def _tabulate(tables: Mapping[str, pd.DataFrame]) -> Block:
    titles = _list_titles(tables)
    columns = [Column("Variant", kind="text"), Column("Kernel", kind="text"), Column("Sensor", kind="text")]
    columns += [Column("Function of", kind="text")]
    columns += [Column("Unit", kind="text"), Column("Present", "%"), Column("Scale stated"), Column("Scale found")]
    columns += [Column("left of prior", "%"), Column("Size", "rms over the poses, mean [5 %, 95 %]")]
    rows: list[list[str | Cell]] = []
    for row in list_rows(tables["functions"]):
        line: list[str | Cell] = [titles[str(row["variant"])], str(row["kernel"]), str(row["sensor"])]
        line += [INPUTS[row["of"]].replace("they read", "it reads"), _unit(row["unit"])]
        line += [format_fixed(100.0 * row["present"], 1), format_significant(row["scale_stated"])]
        line += [_or_nothing(row["scale"], 2), _or_nothing(100.0 * row["left"], 2), _format_size(row)]
        rows.append(line)
    caption = "Sensors' errors that are functions."
    return make_table(caption, columns, rows, [Statement(NOTE)], style="wide")


def _or_nothing(value: float, digits: int) -> str:
    return NOTHING if math.isnan(value) else format_significant(value, digits)


def _format_size(row: Row) -> str:
    mean, low, high = (format_significant(row[key], 2) for key in ("rms", "rms_low", "rms_high"))
    return f"{mean} [{low}, {high}]"


def draw_functions(curves: pd.DataFrame) -> Drawing:
    """Return a panel for each kind of sensor and input: errors with their 90 % intervals over what they depend on."""
    kinds: dict[tuple[str, str], list[str]] = {}
    for sensor, of in dict.fromkeys(zip(curves["sensor"].astype(str), curves["of"].astype(str), strict=True)):
        kinds.setdefault((split_name(sensor)[0], of), []).append(sensor)
    n_rows = math.ceil(len(kinds) / COLUMNS)
    figure = Drawing(figsize=(9.4, 0.4 + 2.8 * n_rows))
    grid = figure.subplots(n_rows, COLUMNS, squeeze=False).ravel()
    for axes, ((kind, of), sensors) in zip(grid, kinds.items(), strict=False):
        for k, sensor in enumerate(sensors):
            own, colour = curves[(curves["sensor"] == sensor) & (curves["of"] == of)], LEG_COLOURS[k % len(LEG_COLOURS)]
            axes.fill_between(own["reading"], own["low"], own["high"], color=colour, alpha=0.2, linewidth=0.0)
            axes.plot(own["reading"], own["mean"], color=colour, label=set_parameter(sensor))
        unit = str(curves[curves["sensor"] == sensors[0]]["unit"].iloc[0])
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        inner = {"um": "mm", "arcsec": "rad"}.get(unit, unit)
        axes.set_xlabel(f"reading of {quote(kind)} ({inner})" if of == "reading" else "row")
        axes.set_ylabel(f"error of {quote(kind)} ({_unit(unit)})")
        axes.legend(ncols=2)
    for axes in grid[len(kinds) :]:
        axes.set_axis_off()
    return figure
