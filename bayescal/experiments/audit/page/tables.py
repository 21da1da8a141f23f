"""Tables of an audit: parameters, requirements, what would help, and draws of the posterior."""

from __future__ import annotations

import math
from collections import Counter

import pandas as pd

from bayescal.experiments.audit.page.borne_out import KEPT, is_kept, read_drawn_probabilities
from bayescal.experiments.audit.page.results import AuditResults, Change
from bayescal.experiments.audit.page.verdict import (
    choose_for_ridge,
    measure_worst,
)
from bayescal.experiments.audit.page.wording import (
    format_contraction,
    format_nominal,
    format_probability,
    format_range,
    format_sd,
    format_share,
    name_requirement,
    name_unit,
)
from bayescal.limits import DEAD, INFORMED
from bayescal.report.blocks import Cell, Column, Level, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_fixed, format_plain
from bayescal.report.symbols import split_name

TOGETHER, NEVER = "only with others", "not identifiable"
VERDICTS = ("identifiable", "weak", TOGETHER, NEVER)
LEVELS: dict[str, Level] = {"identifiable": "good", "weak": "warning", "not": "bad"}
EFFECT_LEVELS: dict[str, Level] = {"harmless": "good", "noticeable": "warning", "harmful": "bad", "unknown": "plain"}


# --- parameters ------------------------------------------------------------------------------------------------------


def tabulate_symbols(results: AuditResults) -> Table:
    """Return one row per symbol, the legs as ranges."""
    columns = [
        Column("Symbol", kind="symbol"),
        Column("Unit", kind="text"),
        Column("Tolerance", "sd"),
        Column("Remains", "sd"),
        Column("Of tolerance"),
        Column("Contraction"),
        Column("Verdict", kind="text"),
        Column(f"Why, on the {results.member} that is known least", kind="text"),
    ]
    rows: list[list[str | Cell]] = []
    for symbol, group in results.parameters.groupby("symbol", sort=False):
        worst = group.sort_values("contraction").iloc[0]
        leg = f"{results.member.capitalize()} {worst['leg']}: " if worst["leg"] else ""
        rows.append(
            [
                str(symbol),
                name_unit(str(group["unit"].iloc[0])),
                format_range(list(group["prior_sd"]), format_sd),
                format_range(list(group["posterior_sd"]), format_sd),
                format_range(_remaining(group), format_share).replace(" % to", " to"),
                format_range(list(group["contraction"]), format_contraction),
                _summarise_verdicts(group),
                f"{leg}{worst['why']}",
            ]
        )
    notes = [
        Statement(
            "Verdict: identifiable where the tolerance is at least halved (contraction 0.75 or more); not where most "
            "of what is left unknown lies along combinations of which nothing is learnt; weak else."
        ),
        Statement("All parameters are free, also those that the poses do not determine: their priors bound them."),
    ]
    return make_table(f"Parameters by symbol; ranges are over the {results.member}s.", columns, rows, notes)


def _remaining(group: pd.DataFrame) -> list[float]:
    return list(group["posterior_sd"] / group["prior_sd"])


def _summarise_verdicts(group: pd.DataFrame) -> Cell:
    badges = [_mark(row) for _, row in group.iterrows()]
    counts = Counter(badge.text for badge in badges)
    if len(counts) == 1:
        return badges[0]
    return Cell(", ".join(f"{counts[name]} {name}" for name in VERDICTS if name in counts), "warning", badge=True)


def _mark(parameter: pd.Series) -> Cell:
    return Cell(name_verdict(parameter), LEVELS[parameter["verdict"]], badge=True)


def name_verdict(parameter: pd.Series) -> str:
    """Return a parameter's verdict in words; one that loses something of its tolerance is known beside others."""
    if parameter["verdict"] != "not":
        return str(parameter["verdict"])
    return TOGETHER if parameter["contraction"] >= DEAD else NEVER


def list_legs(names: pd.Index) -> str:
    """Return the legs of some parameters of one symbol: ``1, 2``."""
    return ", ".join(str(split_name(str(name))[1]) for name in names)


def tabulate_parameters(results: AuditResults) -> Table:
    """Return one row per parameter."""
    columns = [
        Column("Symbol", kind="symbol"),
        Column(results.member.capitalize()),
        Column("Nominal"),
        Column("Tolerance", "sd"),
        Column("Remains", "sd"),
        Column("Of tolerance"),
        Column("Contraction"),
        Column("Learnt", "nat"),
        Column("Verdict", kind="text"),
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
                _mark(row),
                row["why"],
            ]
        )
    return make_table("All parameters.", columns, rows)


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
        Column("reduced set", "", "Predicted sd"),
        Column("before", "", "Probability to meet it"),
        Column("after", "", "Probability to meet it"),
        Column("reduced set", "", "Probability to meet it"),
        Column("Met", kind="text"),
    ]
    drawn = read_drawn_probabilities(results)
    if drawn:
        columns.insert(-1, Column("after, by draws", "", "Probability to meet it"))
    rows: list[list[str | Cell]] = []
    for r in results.requirements:
        kept = is_kept(results, r)
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
        f"the limit; met: with a probability of {format_plain(KEPT)} or more. Reduced set: it alone is "
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
    return make_table("Other plans, with the same requirements.", columns, rows, notes)


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
        Column(results.member.capitalize()),
        Column("Contraction", "as planned"),
        Column("Best change within the actuators' range", kind="text"),
        Column("Contraction", "then"),
        Column("", kind="text"),
    ]
    return make_table("For each weak combination the change that determines it best.", columns, rows)


# --- checks ----------------------------------------------------------------------------------------------------------


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
