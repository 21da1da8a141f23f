"""Sensors and poses to choose on the page of an audit: variants, sets of sensors, selected poses and their number."""

from __future__ import annotations

import math
from functools import partial

import pandas as pd

from bayescal.experiments.audit.page.figures import draw_counts, draw_sets
from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.verdict import find_last_that_pays
from bayescal.experiments.audit.page.wording import format_probability, format_share
from bayescal.experiments.audit.rows import (
    ERROR,
    PARAMETER_ERROR,
    RANDOM_ERROR,
    InfeasibleSetRow,
    PoseCountRow,
    SelectedPoseRow,
    SensorSetRow,
)
from bayescal.experiments.shared.headline import UNDETERMINED, rate_probability
from bayescal.report.blocks import Cell, Column, Figure, PageSection, Table, make_section, make_table
from bayescal.report.numbers import (
    NO_VALUE,
    format_count,
    format_fixed,
    format_percent,
    format_plain,
    format_significant,
    join_words,
)
from bayescal.report.symbols import ChosenUnits, format_place, name_unit, shown_in

MAX_LISTED_SETS = 12  # sets that are listed
REASONS = {
    "calibration": "calibration readings do not determine the pose",
    "use": UNDETERMINED,
}


def _head(name: str, asked: ChosenUnits, group: str = "") -> Column:
    """Return the column of values such as ``x_mm``, in the unit that errors are shown in."""
    stem, _, unit = name.rpartition("_")
    return Column(stem, shown_in(unit, asked)[1], group)


def _write(name: str, value: float, asked: ChosenUnits) -> str:
    return format_significant(shown_in(name.rpartition("_")[2], asked)[0] * value)


def _list_parts(table: pd.DataFrame, start: str) -> list[str]:
    return [str(name).removeprefix(start) for name in table.columns if str(name).startswith(start)]


def show_variants(audit: AuditResults) -> list[PageSection]:
    """Return how sets of sensors compare; nothing of a single one."""
    if len(audit.variants) < 2:
        return []
    columns = [Column("Sensors", kind="text"), Column("Readings", kind="text"), Column("Free"), Column("Equations")]
    columns += [Column("Identifiable"), Column("Error, posterior / prior"), Column("sd / tightest limit")]
    columns += [Column("Requirements", "probability of all"), Column("", kind="text")]
    rows: list[list[str | Cell]] = []
    for row in audit.variants:
        ratio = format_percent(row.error_ratio, 1) if math.isfinite(row.error_ratio) else NO_VALUE
        chosen = Cell("shown below", "good", badge=True) if row.variant == audit.best else Cell("")
        words = (row.title, row.data_set, str(row.n_parameters), str(row.n_equations), str(row.n_identifiable))
        limits = format_share(row.sd_over_limit), format_probability(row.probability)
        rows.append([*words, ratio, *limits, chosen])
    text = ("Equations: readings less pose coordinates. Error: tool, rms.",)
    return [make_section("Sensors", text, (make_table("Sets of sensors.", columns, rows),))]


def show_selected(audit: AuditResults) -> list[PageSection]:
    """Return the poses that are chosen, the first first."""
    mine, asked = audit.of_best("selected"), audit.summary["units"]
    if mine.empty:
        return []
    errors = _list_parts(mine, PARAMETER_ERROR)
    names = [n for n in map(str, mine.columns) if n not in ("variant", "step") and not n.startswith(PARAMETER_ERROR)]
    columns = [Column("Pose"), *(Column(name.rpartition("_")[0], name_unit(name, asked)) for name in names)]
    columns += [Column(name.rpartition("_")[0], name_unit(name, asked), "resulting error, rms") for name in errors]
    rows = [
        [
            str(row.step),
            *(format_place(name, row.others[name], asked) for name in names),
            *(_write(name, row.others[f"{PARAMETER_ERROR}{name}"], asked) for name in errors),
        ]
        for row in SelectedPoseRow.read(mine)
    ]
    text = ("Greedy selection.",)
    return [make_section("Poses", text, (make_table("Chosen poses.", columns, rows),))]


def show_counts(audit: AuditResults) -> list[PageSection]:
    """Return the error with every number of poses."""
    mine, asked = audit.of_best("pose_counts"), audit.summary["units"]
    if mine.empty:
        return []
    names = _list_parts(mine, PARAMETER_ERROR)
    columns = [Column("Poses")]
    columns += [_head(n, asked, group) for group in ("rms error, selected poses", "random poses") for n in names]
    columns += [Column("last pose gains")]
    rows = [
        [
            str(row.n_poses),
            *(_write(n, row.others[f"{part}{n}"], asked) for part in (PARAMETER_ERROR, RANDOM_ERROR) for n in names),
            format_percent(row.error_reduction, 1),
        ]
        for row in PoseCountRow.read(mine)
    ]
    figure = Figure(
        "pose_counts",
        "Selected and random poses.",
        partial(draw_counts, mine, find_last_that_pays(mine), asked),
    )
    text = ()
    return [make_section("Number of poses", text, (make_table("By number of poses.", columns, rows),), (figure,))]


# --- sets of sensors -------------------------------------------------------------------------------------------------


def show_sets(audit: AuditResults) -> list[PageSection]:
    """Return the best sets of every number of sensors, and the largest that are infeasible."""
    tables = audit.tables
    if "sensor_sets" not in tables:
        return []
    shown, drawn = [], []
    required = "requirements" in tables
    what = "largest sd / limit" if required else "rms over the workspace"
    for table, name, against, caption in (
        ("best_sets", "sensor_sets", "number", "Best set by number"),
        ("front", "front", "cost", "Pareto front (cost, error)"),
    ):
        if table in tables:
            shown.append(_tabulate_best(audit, tables[table], caption))
            draw = partial(draw_sets, tables["sensor_sets"], tables[table], required, against)
            drawn.append(Figure(name, f"Error of sensor sets by {against}, {what}.", draw))
    if "best_sets" in tables:
        shown.append(_tabulate_parameters(tables["best_set_parameters"]))
    if "infeasible_sets" in tables:
        lines = sorted(InfeasibleSetRow.read(tables["infeasible_sets"]), key=lambda row: -row.n_sensors)
        columns = [Column("Sensors", kind="text"), Column("Reason", kind="text")]
        rows = [[row.sensors if row.n_sensors else "none", REASONS[row.reason]] for row in lines[:MAX_LISTED_SETS]]
        more = f", the first {MAX_LISTED_SETS} of {len(lines)}" if len(lines) > MAX_LISTED_SETS else ""
        shown.append(make_table(f"Infeasible sets (maximal){more}.", columns, rows))
    text = ("Error: parameters and noise in use.",)
    return [make_section("Sensor selection", text, shown, drawn)]


def _tabulate_best(audit: AuditResults, best: pd.DataFrame, caption: str) -> Table:
    asked, names, required = audit.summary["units"], _list_parts(best, ERROR), "requirements" in audit.tables
    columns = [Column("Sensors"), Column("Names", kind="text")]
    columns += [Column("Cost")] if "cost" in best else []
    columns += [Column("Sets"), Column("infeasible")] if "n_sets" in best else []
    columns += [_head(name, asked, "rms error") for name in names]
    columns += [Column("Requirements", "probability of all")] if required else []
    rows: list[list[str | Cell]] = []
    for row in SensorSetRow.read(best):
        cells: list[str | Cell] = [str(row.n_sensors), row.sensors if row.n_sensors else NO_VALUE]
        cells += [] if row.cost is None else [format_plain(row.cost)]
        cells += [] if row.n_sets is None else [format_count(row.n_sets), format_count(row.n_infeasible or 0)]
        cells += [_write(name, row.others[f"{ERROR}{name}"], asked) for name in names]
        if row.probability is not None:
            cells.append(Cell(format_probability(row.probability), rate_probability(row.probability)))
        rows.append(cells)
    always = [str(one) for one in audit.summary["sensor_selection"]["required_sensors"]]
    return make_table(f"{caption}{f', besides {join_words(always)}' if always else ''}.", columns, rows)


def _tabulate_parameters(every: pd.DataFrame) -> Table:
    """Return posterior sds over prior sds with each number of sensors, a symbol a row."""
    every = every.assign(symbol=every["parameter"].str.partition("[")[0], share=every["sd"] / every["prior_sd"])
    shares = every.groupby(["symbol", "n_sensors"], sort=False)["share"].max().unstack()
    columns = [Column("Parameter", kind="text")]
    columns += [Column(f"{int(n)}", group="by number") for n in shares.columns]
    rows = [
        [str(symbol), *(format_fixed(float(one), 3) for one in values)]
        for symbol, values in zip(shares.index, shares.to_numpy(), strict=True)
    ]
    caption = "Posterior sd / prior sd, best sets."
    return make_table(caption, columns, rows)
