"""Sensors and poses to choose on the page of an audit: variants, sets of sensors, chosen poses and how many of them."""

from __future__ import annotations

import math
from functools import partial

import pandas as pd

from bayescal.experiments.audit.page.figures import draw_counts, draw_sets
from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.verdict import find_last_that_pays
from bayescal.experiments.audit.page.wording import format_probability, format_share
from bayescal.experiments.frame.results import list_rows
from bayescal.experiments.shared.headline import rate_probability
from bayescal.report.blocks import Cell, Column, Figure, Section, Table, make_section, make_table
from bayescal.report.numbers import (
    NOTHING,
    format_count,
    format_fixed,
    format_percent,
    format_plain,
    format_significant,
    join_words,
)
from bayescal.report.symbols import Asked, format_place, name_unit, shown_in

MANY = 12  # sets that are listed
REASONS = {
    "calibration": "readings do not determine where the machine is in the calibration",
    "use": "the machine's own sensors of the set do not determine where it is in use",
}


def _head(name: str, asked: Asked, group: str = "") -> Column:
    """Return the column of values such as ``x_mm``, in the unit that errors are shown in."""
    stem, _, unit = name.rpartition("_")
    return Column(stem, shown_in(unit, asked)[1], group)


def _write(name: str, value: float, asked: Asked) -> str:
    return format_significant(shown_in(name.rpartition("_")[2], asked)[0] * value)


def _list_parts(table: pd.DataFrame, start: str) -> list[str]:
    return [str(name).removeprefix(start) for name in table.columns if str(name).startswith(start)]


def show_variants(audit: AuditResults) -> list[Section]:
    """Return how sets of sensors compare; nothing of a single one."""
    if "variants" not in audit.tables or len(audit.tables["variants"]) < 2:
        return []
    columns = [Column("Sensors", kind="text"), Column("Readings", kind="text"), Column("Free"), Column("Equations")]
    columns += [Column("Identifiable"), Column("Error left"), Column("Of the tightest limit")]
    columns += [Column("Requirements", "probability of all"), Column("", kind="text")]
    rows: list[list[str | Cell]] = []
    for row in list_rows(audit.tables["variants"]):
        found = (row.get(name) for name in ("share_of_limit", "probability"))
        share, probability = (math.nan if value in (None, "") else float(value) for value in found)
        left = format_percent(row["left"], 1) if math.isfinite(row["left"]) else NOTHING
        chosen = Cell("shown below", "good", badge=True) if row["variant"] == audit.best else Cell("")
        words = (str(row[name]) for name in ("title", "data", "n_parameters", "n_equations", "n_identifiable"))
        rows.append([*words, left, format_share(share), format_probability(probability), chosen])
    text = (
        "Equations are readings less coordinates of the poses. Identifiable: uncertainty at least halved. Error left: "
        "what unknown parameters do to where the machine is, rms, after the calibration against before.",
    )
    return [make_section("Which sensors", text, (make_table("Sets of sensors.", columns, rows),))]


def show_selected(audit: AuditResults) -> list[Section]:
    """Return the poses that are chosen, the first first."""
    mine, asked = audit.of_best("selected"), audit.summary["units"]
    if mine.empty:
        return []
    after = _list_parts(mine, "after_")
    names = [n for n in map(str, mine.columns) if n not in ("variant", "step") and not n.startswith("after_")]
    columns = [Column("Pose"), *(Column(name.rpartition("_")[0], name_unit(name, asked)) for name in names)]
    columns += [Column(name.rpartition("_")[0], name_unit(name, asked), "rms then left") for name in after]
    rows = [
        [
            str(row["step"]),
            *(format_place(name, row[name], asked) for name in names),
            *(_write(name, row[f"after_{name}"], asked) for name in after),
        ]
        for row in list_rows(mine)
    ]
    text = (
        "In the order in which each lowers the mean squared error over the workspace most, given all before it. Beside "
        "each, what is then left of the error by unknown parameters.",
    )
    return [make_section("Poses to measure", text, (make_table("The poses chosen.", columns, rows),))]


def show_counts(audit: AuditResults) -> list[Section]:
    """Return what every number of poses leaves of the error."""
    mine, asked = audit.of_best("pose_counts"), audit.summary["units"]
    if mine.empty:
        return []
    names = _list_parts(mine, "after_")
    columns = [Column("Poses")]
    columns += [_head(n, asked, group) for group in ("chosen, rms then left", "at random") for n in names]
    columns += [Column("the last lowers the error by")]
    rows = [
        [
            str(row["n_poses"]),
            *(_write(name, row[f"{part}_{name}"], asked) for part in ("after", "random") for name in names),
            format_percent(row["gain"], 1),
        ]
        for row in list_rows(mine)
    ]
    figure = Figure(
        "pose_counts",
        "Error over the workspace by unknown parameters, by the number of poses: chosen, and as many at random.",
        partial(draw_counts, mine, find_last_that_pays(mine), asked),
    )
    text = ("The best set of poses found of every number; where the curve is flat more of them do not pay.",)
    return [make_section("How many poses", text, (make_table("By the number of poses.", columns, rows),), (figure,))]


# --- sets of sensors -------------------------------------------------------------------------------------------------


def show_sets(audit: AuditResults) -> list[Section]:
    """Return the best sets of every number of sensors, and the largest that are no good."""
    tables = audit.tables
    if "sensor_sets" not in tables:
        return []
    shown, drawn = [], []
    required = "requirements" in tables
    what = "the largest standard deviation as a share of its limit" if required else "rms over the workspace"
    for table, name, against, caption in (
        ("best_sets", "sensor_sets", "number", "The best set of every number of sensors"),
        ("front", "front", "price", "The sets that no other one beats at their price or below"),
    ):
        if table in tables:
            shown.append(_tabulate_best(audit, tables[table], caption))
            draw = partial(draw_sets, tables["sensor_sets"], tables[table], required, against)
            drawn.append(Figure(name, f"Error of every set of sensors against their {against}, {what}.", draw))
    if "best_sets" in tables:
        shown.append(_tabulate_parameters(tables["best_set_parameters"]))
    if "hopeless_sets" in tables:
        lines = list_rows(tables["hopeless_sets"].sort_values("n_sensors", ascending=False, kind="stable"))
        columns = [Column("Sensors", kind="text"), Column("Why not", kind="text")]
        rows = [[str(row["sensors"]) if row["n_sensors"] else "none", REASONS[row["reason"]]] for row in lines[:MANY]]
        more = f", the first {MANY} of {len(lines)}" if len(lines) > MANY else ""
        shown.append(make_table(f"The largest sets that are no good, nor is any part of them{more}.", columns, rows))
    text = (
        "Each set takes in the planned poses. An external sensor serves the calibration alone; in use the "
        "machine's own sensors of the set determine where it is. Error is that of unknown parameters and of the noise "
        "in use together.",
    )
    return [make_section("Which sensors to take", text, shown, drawn)]


def _tabulate_best(audit: AuditResults, best: pd.DataFrame, caption: str) -> Table:
    asked, names, required = audit.summary["units"], _list_parts(best, "error_"), "requirements" in audit.tables
    columns = [Column("Sensors"), Column("Which", kind="text")]
    columns += [Column("Price")] if "price" in best else []
    columns += [Column("Sets"), Column("of them no good")] if "n_sets" in best else []
    columns += [_head(name, asked, "rms error over the workspace") for name in names]
    columns += [Column("Requirements", "probability of all")] if required else []
    rows: list[list[str | Cell]] = []
    for row in list_rows(best):
        cells: list[str | Cell] = [str(int(row["n_sensors"])), str(row["sensors"]) if row["n_sensors"] else "–"]
        cells += [format_plain(row["price"])] if "price" in best else []
        cells += [format_count(row["n_sets"]), format_count(row["n_hopeless"])] if "n_sets" in best else []
        cells += [_write(name, row[f"error_{name}"], asked) for name in names]
        if required:
            cells.append(Cell(format_probability(row["probability"]), rate_probability(row["probability"])))
        rows.append(cells)
    always = [str(one) for one in audit.summary["sensor_choice"]["always"]]
    return make_table(f"{caption}{f', besides {join_words(always)}' if always else ''}.", columns, rows)


def _tabulate_parameters(every: pd.DataFrame) -> Table:
    """Return what each number of sensors leaves of the parameters' tolerances, a symbol a row."""
    every = every.assign(symbol=every["parameter"].str.partition("[")[0], share=every["sd"] / every["prior_sd"])
    shares = every.groupby(["symbol", "n_sensors"], sort=False)["share"].max().unstack()
    columns = [Column("Parameter", kind="text")]
    columns += [Column(f"{int(n)}", group="by the number of sensors") for n in shares.columns]
    rows = [
        [str(symbol), *(format_fixed(float(one), 3) for one in values)]
        for symbol, values in zip(shares.index, shares.to_numpy(), strict=True)
    ]
    caption = "What the best sets leave of tolerances; of several of a symbol the largest share."
    return make_table(caption, columns, rows)
