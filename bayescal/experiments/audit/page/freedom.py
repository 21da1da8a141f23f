"""Tables of an audit on what to free: what everything free and the reduced set claim, and what is true of both."""

from __future__ import annotations

from typing import Any

import pandas as pd

from bayescal.experiments.audit.page.borne_out import is_off
from bayescal.experiments.audit.page.checks import SIMULATED
from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.wording import (
    count,
    format_contraction,
    format_range,
    format_sd,
    format_share,
    list_names,
    name_requirement,
    name_unit,
)
from bayescal.limits import COVERAGE, INFORMED
from bayescal.report.blocks import Cell, Column, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_fixed, format_plain, format_significant, join_words

COVERED = 0.85  # from which on 90 % intervals are as good as their name


def tabulate_sets(results: AuditResults) -> Table | None:
    """Return what everything free and the reduced set claim and truly err by; None without a reduced set."""
    if results.parameters["reduced_claimed_sd"].isna().all():
        return None
    both = ("Everything free", "Reduced set")
    columns = [
        Column("Symbol", kind="symbol"),
        Column("Unit", kind="text"),
        Column("Tolerance", "sd"),
        *(
            Column(*one, group)
            for group in both
            for one in (("claims", "sd"), ("errs by", "rms"), ("covers", "of 90 %"))
        ),
    ]
    rows: list[list[str | Cell]] = []
    for symbol, group in results.parameters.groupby("symbol", sort=False):
        claimed = format_range(list(group["posterior_sd"]), format_sd)
        row: list[str | Cell] = [str(symbol), name_unit(str(group["unit"].iloc[0]))]
        row += [format_range(list(group["prior_sd"]), format_sd), claimed, claimed, format_share(COVERAGE)]
        rows.append(row + _describe_reduced(group))
    note = (
        "True errors where every parameter is off by its tolerance, to first order; of what the reduced set takes for "
        "nominal the error is the tolerance. Simulated calibrations, where asked for, show the same beyond first order."
    )
    return make_table("What both sets claim, and what is true.", columns, rows, [Statement(note)])


def _describe_reduced(group: pd.DataFrame) -> list[str | Cell]:
    """Return claimed sd, true error and coverage of a symbol in the reduced set."""
    known = group.dropna(subset=["reduced_claimed_sd"])
    if known.empty:
        return ["nominal", format_range(list(group["prior_sd"]), format_sd), NOTHING]
    coverage = float(known["reduced_coverage_90"].mean())
    return [
        format_range(list(known["reduced_claimed_sd"]), format_sd),
        format_range(list(known["reduced_true_error"]), format_sd),
        Cell(format_share(coverage), "plain" if coverage >= COVERED else "warning"),
    ]


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
            Cell("taken" if step["taken"] else "left out", "good" if step["taken"] else "plain", badge=True),
            _give_reason(step),
        ]
        for step in steps
    ]
    extra = results.summary["could_also_be_freed"]
    notes = [
        Statement(
            "The symbol that the measurements determine best, given what is already chosen, is taken next; it is "
            f"taken where all chosen parameters stay at or above a contraction of {format_plain(INFORMED)}."
        )
    ]
    if extra:
        notes.append(Statement(f"On single ones it could hold more: {list_names(extra, results.member)}."))
    return make_table(
        "How the reduced set is found: symbols in the order in which they are looked at.", columns, rows, notes
    )


def _give_reason(step: dict[str, Any]) -> str:
    least = format_contraction(step["contraction"])
    if step["taken"]:
        return f"all chosen parameters stay determined, the least at {least}"
    return f"with it a chosen parameter would be known to a contraction of {least} only"


# --- simulated calibrations ------------------------------------------------------------------------------------------


def tabulate_simulated(results: AuditResults) -> list[Table]:
    """Return predicted beside simulated standard deviations, a table for each set of free parameters."""
    there = {what: results.summary.get(key) for key, what in SIMULATED.items()}
    return [_tabulate_simulated(what, found) for what, found in there.items() if found is not None and found["symbols"]]


def _tabulate_simulated(what: str, simulated: dict[str, Any]) -> Table:
    columns = [
        Column("Symbol", kind="symbol"),
        Column("Unit", kind="text"),
        Column("Claimed", "sd"),
        Column("Predicted", "rms error"),
        Column("Simulated", "rms error"),
        Column("Simulated by predicted", "± standard error"),
        Column("Covers", "of 90 %"),
    ]
    rows: list[list[str | Cell]] = []
    for symbol, values in simulated["symbols"].items():
        off = is_off(values["ratio"], values["ratio_se"])
        ratio = f"{format_fixed(values['ratio'], 3)} ± {format_fixed(values['ratio_se'], 3)}"
        sds = [format_sd(values[key]) for key in ("claimed_sd", "predicted_sd", "simulated_sd")]
        coverage = Cell(format_share(values["coverage_90"]), "plain" if values["coverage_90"] >= COVERED else "warning")
        rows.append([symbol, name_unit(values["unit"]), *sds, Cell(ratio, "warning" if off else "plain"), coverage])
    made = f"{simulated['n_converged']} of {count(simulated['n'], 'calibration')} converged"
    caption = f"Errors of simulated calibrations and their prediction, rms over legs; {what}; {made}."
    return make_table(caption, columns, rows, [*_describe_simulated(simulated)])


def _describe_simulated(simulated: dict[str, Any]) -> list[Statement]:
    """Return how the calibrations stand as a whole, and how many machines kept what is required."""
    whole = (
        f"All together: 90 % intervals hold {format_share(simulated['coverage_90'])} of the true values, the errors "
        f"are {format_significant(simulated['rms_z'], 3)} times what is claimed (rms)."
    )
    kept = [
        f"{name_requirement(name)} {one['kept']} of {one['n']} "
        f"(expected {one['expected_low']} to {one['expected_high']})"
        for name, one in simulated["requirements"].items()
    ]
    return [Statement(whole)] + ([Statement(f"Requirements met: {join_words(kept)}.")] if kept else [])
