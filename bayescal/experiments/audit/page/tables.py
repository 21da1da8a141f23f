"""Tables of an audit: parameters, what to fix, requirements, what would help, and the checks."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

from bayescal.experiments.audit.page.checks import SIMULATED
from bayescal.experiments.audit.page.results import AuditResults, Change
from bayescal.experiments.audit.page.verdict import (
    KEPT,
    choose_for_ridge,
    is_off,
    measure_worst,
    read_drawn_probabilities,
)
from bayescal.experiments.audit.page.wording import (
    count,
    format_contraction,
    format_nominal,
    format_probability,
    format_range,
    format_sd,
    format_share,
    list_names,
    name_requirement,
    name_unit,
)
from bayescal.limits import INFORMED
from bayescal.report.blocks import Cell, Column, Level, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_fixed, format_plain
from bayescal.report.symbols import split_name

LEVELS: dict[str, Level] = {"identifiable": "good", "weak": "warning", "not": "bad"}
EFFECT_LEVELS: dict[str, Level] = {"harmless": "good", "noticeable": "warning", "harmful": "bad", "unknown": "plain"}


# --- parameters ------------------------------------------------------------------------------------------------------


def tabulate_symbols(results: AuditResults) -> Table:
    """Return one row per symbol, the legs as ranges."""
    columns = [
        Column("Symbol", kind="symbol"),
        Column("Unit", kind="text"),
        Column("Tolerance", "sd"),
        Column("remains", "sd", "With all unknown"),
        Column("of tolerance", "", "With all unknown"),
        Column("Contraction", "", "With all unknown"),
        Column("Verdict", kind="text"),
        Column("To do", kind="text"),
        Column("Remains then", "sd"),
        Column("Why, on the leg that is known least", kind="text"),
    ]
    rows: list[list[str | Cell]] = []
    for symbol, group in results.parameters.groupby("symbol", sort=False):
        worst = group.sort_values("contraction").iloc[0]
        leg = f"Leg {worst['leg']}: " if worst["leg"] else ""
        rows.append(
            [
                str(symbol),
                name_unit(str(group["unit"].iloc[0])),
                format_range(list(group["prior_sd"]), format_sd),
                format_range(list(group["posterior_sd"]), format_sd),
                format_range(_remaining(group), format_share).replace(" % to", " to"),
                format_range(list(group["contraction"]), format_contraction),
                _summarise_verdicts(group),
                _recommend(group),
                _format_recommended(group),
                f"{leg}{worst['why']}",
            ]
        )
    notes = [
        Statement(
            "Verdict: identifiable where the tolerance is at least halved (contraction 0.75 or more); not where most "
            "of what is left unknown lies along combinations of which nothing is learnt; weak else."
        ),
        Statement(
            "A parameter may be free though it is not identifiable with all unknown: once those that it trades off "
            "with are held at nominal, it is determined (“Remains then”)."
        ),
    ]
    return make_table("Parameters by symbol; ranges are over the legs.", columns, rows, notes)


def _remaining(group: pd.DataFrame) -> list[float]:
    return list(group["posterior_sd"] / group["prior_sd"])


def _summarise_verdicts(group: pd.DataFrame) -> Cell:
    counts = group["verdict"].value_counts()
    if len(counts) == 1:
        verdict = str(counts.index[0])
        return Cell(name_verdict(verdict), LEVELS[verdict], badge=True)
    words = [f"{counts[verdict]} {name_verdict(verdict)}" for verdict in LEVELS if verdict in counts]
    return Cell(", ".join(words), "warning", badge=True)


def name_verdict(verdict: str) -> str:
    """Return a verdict in words."""
    return "not identifiable" if verdict == "not" else verdict


def _recommend(group: pd.DataFrame) -> Cell:
    free = group["recommended"]
    if free.all():
        return Cell("free")
    return Cell("fix" if not free.any() else f"free {list_legs(group.index[free])}")


def list_legs(names: pd.Index) -> str:
    """Return the legs of some parameters of one symbol: ``1, 2``."""
    return ", ".join(str(split_name(str(name))[1]) for name in names)


def _format_recommended(group: pd.DataFrame) -> str:
    column = group.get("posterior_sd_recommended")
    known = [] if column is None else [float(x) for x in column.dropna()]
    return format_range(known, format_sd) if known else NOTHING


def tabulate_parameters(results: AuditResults) -> Table:
    """Return one row per parameter."""
    columns = [
        Column("Symbol", kind="symbol"),
        Column("Leg"),
        Column("Nominal"),
        Column("Tolerance", "sd"),
        Column("Remains", "sd"),
        Column("Of tolerance"),
        Column("Contraction"),
        Column("Learnt", "nat"),
        Column("Verdict", kind="text"),
        Column("To do", kind="text"),
        Column("Why", kind="text"),
    ]
    rows: list[list[str | Cell]] = []
    for _, row in results.parameters.iterrows():
        unit = name_unit(row["unit"])
        rows.append(
            [
                row["symbol"],
                str(row["leg"]) if row["leg"] else NOTHING,
                f"{format_nominal(row['nominal'], row['prior_sd'])} {unit}".strip(),
                format_sd(row["prior_sd"]),
                format_sd(row["posterior_sd"]),
                format_share(row["posterior_sd"] / row["prior_sd"]),
                format_contraction(row["contraction"]),
                format_fixed(row["nats"], 2),
                Cell(name_verdict(row["verdict"]), LEVELS[row["verdict"]], badge=True),
                "free" if row["recommended"] else "fix",
                row["why"],
            ]
        )
    return make_table("All parameters.", columns, rows)


def tabulate_selection(results: AuditResults) -> Table | None:
    """Return the steps of the selection with the reason of each; None without any."""
    steps = results.summary["selection"]
    if not steps:
        return None
    columns = [
        Column("Symbol", kind="symbol"),
        Column("Learnt", "nat per parameter"),
        Column("Least contraction", "of all chosen, with it"),
        Column("Decision", kind="text"),
        Column("Reason", kind="text"),
    ]
    rows = [
        [
            step["symbol"],
            format_fixed(step["nats"], 2),
            format_contraction(step["contraction"]),
            Cell("free" if step["taken"] else "fix at nominal", "good" if step["taken"] else "plain", badge=True),
            _give_reason(step),
        ]
        for step in steps
    ]
    extra = results.summary["could_also_be_freed"]
    notes = [
        Statement(
            "The symbol that the measurements tell most of, given what is already chosen, is looked at next; it is "
            f"taken where all chosen parameters stay at or above a contraction of {format_plain(INFORMED)}."
        )
    ]
    if extra:
        notes.append(Statement(f"On single legs more could be freed: {list_names(extra)}."))
    return make_table("What to free and what to fix, in the order of the selection.", columns, rows, notes)


def _give_reason(step: dict[str, Any]) -> str:
    least = format_contraction(step["contraction"])
    if step["taken"]:
        return f"all chosen parameters stay determined, the least at {least}"
    return f"with it a chosen parameter would be known to a contraction of {least} only"


# --- requirements ----------------------------------------------------------------------------------------------------


def tabulate_requirements(results: AuditResults) -> Table | None:
    """Return how each requirement stands before and after the calibration; None without any."""
    if not results.requirements:
        return None
    columns = [
        Column("Requirement", kind="text"),
        Column("Limit"),
        Column("Unit", kind="text"),
        Column("before", "", "Predicted sd"),
        Column("after", "", "Predicted sd"),
        Column("by geometry", "", "Predicted sd"),
        Column("of limit", "", "Predicted sd"),
        Column("rest fixed", "", "Predicted sd"),
        Column("before", "", "Probability to keep it"),
        Column("after", "", "Probability to keep it"),
        Column("rest fixed", "", "Probability to keep it"),
        Column("Kept", kind="text"),
    ]
    drawn = read_drawn_probabilities(results)
    if drawn:
        columns.insert(-1, Column("after, by draws", "", "Probability to keep it"))
    rows: list[list[str | Cell]] = []
    for r in results.requirements:
        kept = min(r.probability, drawn.get(r.name, 1.0)) >= KEPT
        rows.append(
            [
                name_requirement(r.name),
                format_plain(r.limit),
                name_unit(r.unit),
                format_sd(r.prior_sd),
                format_sd(r.predicted_sd),
                format_sd(r.geometry_sd),
                format_share(r.predicted_sd / r.limit),
                format_sd(r.reduced_sd),
                format_probability(r.prior_probability),
                format_probability(r.probability),
                format_probability(r.reduced_probability),
                *([format_probability(drawn.get(r.name, math.nan))] if drawn else []),
                Cell("yes" if kept else "not reliably", "good" if kept else "bad", badge=True),
            ]
        )
    note = (
        "Standard deviation: the largest anywhere in the workspace; probability: that no pose of the workspace exceeds "
        f"the limit; kept: with a probability of {format_plain(KEPT)} or more. Rest fixed: only what is to be freed is "
        "calibrated, the others are taken for nominal although they are off by their tolerances."
    )
    return make_table("Requirements on the pose before and after the calibration.", columns, rows, [Statement(note)])


# --- what would help -------------------------------------------------------------------------------------------------


def name_change(change: Change) -> str:
    """Return a change with a mark where the actuators do not reach that far or it cannot be."""
    return f"{change.name}{' †' if change.beyond_range else ''}{' ‡' if not change.possible else ''}"


def tabulate_changes(results: AuditResults) -> Table | None:
    """Return what each change of the plan would tell; None without any."""
    if not results.changes:
        return None
    columns = [
        Column("Change of the plan", kind="text"),
        Column("Poses"),
        Column("Learnt", "nat"),
        Column("Determined", "parameters"),
        *(Column(name_requirement(r.name), name_unit(r.unit), "Predicted sd") for r in results.requirements),
    ]
    if results.requirements:
        columns.append(Column("Tightest", "of its limit"))
    rows = [_tabulate_plan(results), *(_tabulate_change(results, change) for change in results.changes)]
    notes = []
    if any(change.beyond_range for change in results.changes):
        notes.append(Statement("† needs larger displacements than the actuators have."))
    if any(not change.possible for change in results.changes):
        notes.append(Statement("‡ cannot be: the machine does not reach these poses."))
    return make_table("What other plans would tell; the requirements stay.", columns, rows, notes)


def _tabulate_plan(results: AuditResults) -> list[str | Cell]:
    row: list[str | Cell] = [
        "as it is" if results.is_measured else "as planned",
        str(results.n_poses),
        format_fixed(results.summary["total_nats"], 1),
        str(results.n_identifiable),
        *(format_sd(r.predicted_sd) for r in results.requirements),
    ]
    if results.requirements:
        row.append(format_share(max(r.predicted_sd / r.limit for r in results.requirements)))
    return row


def _tabulate_change(results: AuditResults, change: Change) -> list[str | Cell]:
    values = [change.requirements.get(r.name, math.nan) for r in results.requirements]
    row: list[str | Cell] = [
        name_change(change),
        str(change.n_poses),
        format_fixed(change.nats, 1),
        str(change.n_identifiable) if change.possible else NOTHING,
        *(NOTHING if math.isnan(value) else format_sd(value) for value in values),
    ]
    if results.requirements:
        row.append(format_share(measure_worst(results, change)))
    return row


def tabulate_ridge_help(results: AuditResults) -> Table | None:
    """Return for each practical ridge the change that tells most of it; None without ridges or changes."""
    rows: list[list[str | Cell]] = []
    for ridge in (r for r in results.ridges if r.kind == "practical"):
        best = choose_for_ridge(results, ridge.pivot)
        if best is not None:
            done = best[1] >= INFORMED
            symbol, leg = split_name(ridge.pivot)
            rows.append(
                [
                    symbol,
                    str(leg) if leg else NOTHING,
                    format_contraction(ridge.contraction),
                    best[0].name,
                    Cell(format_contraction(best[1])),
                    Cell("determined" if done else "still not", "good" if done else "plain", badge=True),
                ]
            )
    if not rows:
        return None
    columns = [
        Column("Ridge of", kind="symbol"),
        Column("Leg"),
        Column("Contraction", "as planned"),
        Column("Best change within the actuators' range", kind="text"),
        Column("Contraction", "then"),
        Column("", kind="text"),
    ]
    return make_table("For each weak combination the change that tells most of it.", columns, rows)


# --- checks ----------------------------------------------------------------------------------------------------------


def tabulate_simulated(results: AuditResults) -> list[Table]:
    """Return predicted beside simulated standard deviations, a table for each set of free parameters."""
    there = {what: results.summary.get(key) for key, what in SIMULATED.items()}
    return [_tabulate_simulated(what, found) for what, found in there.items() if found is not None and found["symbols"]]


def _tabulate_simulated(what: str, simulated: dict[str, Any]) -> Table:
    columns = [
        Column("Symbol", kind="symbol"),
        Column("Unit", kind="text"),
        Column("Predicted", "sd"),
        Column("Simulated", "sd"),
        Column("Ratio", "± standard error"),
    ]
    rows: list[list[str | Cell]] = []
    for symbol, values in simulated["symbols"].items():
        off = is_off(values["ratio"], values["ratio_se"])
        ratio = f"{format_fixed(values['ratio'], 3)} ± {format_fixed(values['ratio_se'], 3)}"
        sds = [format_sd(values["predicted_sd"]), format_sd(values["simulated_sd"])]
        rows.append([symbol, name_unit(values["unit"]), *sds, Cell(ratio, "warning" if off else "plain")])
    made = f"{simulated['n_converged']} of {count(simulated['n'], 'calibration')} converged"
    caption = f"Scatter of simulated calibrations beside the prediction, rms over legs; {what}; {made}."
    return make_table(caption, columns, rows)


def tabulate_posterior(results: AuditResults) -> Table | None:
    """Return standard deviations from draws beside those from the information, by symbol; None without draws."""
    posterior = results.summary.get("posterior")
    if posterior is None or not posterior["parameters"]:
        return None
    drawn = pd.DataFrame.from_dict(posterior["parameters"], orient="index")
    frame = results.parameters.join(drawn[["sd"]].rename(columns={"sd": "drawn_sd"}), how="inner")
    columns = [
        Column("Symbol", kind="symbol"),
        Column("Unit", kind="text"),
        Column("Tolerance", "sd"),
        Column("from information", "sd", "What remains"),
        Column("from draws", "sd", "What remains"),
        Column("Ratio", "draws to information"),
    ]
    rows = []
    for symbol, group in frame.groupby("symbol", sort=False):
        ratio = list(group["drawn_sd"] / group["posterior_sd"])
        sds = [format_range(list(group[key]), format_sd) for key in ("prior_sd", "posterior_sd", "drawn_sd")]
        rows.append([str(symbol), name_unit(str(group["unit"].iloc[0])), *sds, format_range(ratio, _two)])
    return make_table("What remains unknown, from draws and from the information; ranges over legs.", columns, rows)


def _two(value: float) -> str:
    return format_fixed(value, 2)
