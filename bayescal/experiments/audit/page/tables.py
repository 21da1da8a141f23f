"""Tables and cards of an audit: parameters, ridges, what to free, requirements, what would help, and what checks it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.audit.page.figures import span_profile
from bayescal.experiments.audit.page.results import SIMULATED, AuditResults, PlanChange
from bayescal.experiments.audit.page.verdict import (
    choose_for_ridge,
    is_met,
    is_off,
    measure_worst,
    read_drawn_probabilities,
    write_two,
)
from bayescal.experiments.audit.page.wording import (
    count,
    format_change,
    format_contraction,
    format_fixed_span,
    format_nominal,
    format_probability,
    format_range,
    format_sd,
    format_share,
    list_names,
    name_change,
    name_requirement,
    name_unit,
    say_most,
)
from bayescal.experiments.audit.rows import AuditCombinationRow, AuditParameterRow, AuditRequirementRow, FreeingStepRow
from bayescal.experiments.runner.results import Summary
from bayescal.experiments.shared.headline import LIKELY
from bayescal.experiments.shared.knowledge_page import VERDICT_LEVELS
from bayescal.limits import COVERAGE, IDENTIFIABLE_CONTRACTION, UNIDENTIFIABLE_CONTRACTION
from bayescal.report.blocks import Card, Cell, Column, Level, Statement, Table, make_pairs, make_table
from bayescal.report.numbers import NO_VALUE, format_fixed, format_plain, format_significant, join_words
from bayescal.report.symbols import split_name

ONLY_TOGETHER, NEVER = "only with others", "not identifiable"
VERDICTS = ("identifiable", "weak", ONLY_TOGETHER, NEVER)
EFFECTS: dict[str, tuple[Level, str]] = {
    "harmful": ("bad", "harmful to the pose"),
    "noticeable": ("warning", "noticeable in the pose"),
    "unknown": ("plain", "effect not judged"),
    "harmless": ("good", "harmless to the pose"),
}
"""Effects of ridges, the worst first: how good the news is, and in words."""
COVERED = 0.85  # from which on 90 % intervals are as good as their name
FOLLOWERS = 3  # named along a profile

type Field = tuple[Column, Callable[[Any], str | Cell]]
"""A column, and how to write its cell of an item."""


def _tabulate(
    caption: str, fields: Sequence[Field], items: Iterable[object], notes: Sequence[str] = (), style: str = ""
) -> Table:
    """Return a table with a row per item; captions and notes are sentences."""
    rows = [[write(one) for _, write in fields] for one in items]
    return make_table(caption, [column for column, _ in fields], rows, [Statement(text) for text in notes], style)


def _mark(text: str, good: bool, otherwise: Level = "plain") -> Cell:
    return Cell(text, "good" if good else otherwise, badge=True)


type Group = list[AuditParameterRow]
"""Parameters of a symbol."""


def _span(key: str, write: Callable[[float], str] = format_sd) -> Callable[[Group], str]:
    """Return how the values of a column are written as a range."""
    return lambda group: format_range([getattr(row, key) for row in group], write)


SYMBOL: tuple[Field, Field] = (
    (Column("Symbol", kind="symbol"), lambda group: group[0].symbol),
    (Column("Unit", kind="text"), lambda group: name_unit(group[0].unit)),
)
write_tolerance = _span("prior_sd")
TOLERANCE: Field = (Column("Tolerance", "sd"), write_tolerance)


def _by_symbol(results: AuditResults) -> list[Group]:
    return [[row for row in results.parameters if row.symbol == symbol] for symbol in results.symbols]


# --- parameters ------------------------------------------------------------------------------------------------------


def tabulate_symbols(results: AuditResults) -> Table:
    """Return one row per symbol, the legs as ranges."""

    def explain(group: Group) -> str:
        least = min(group, key=lambda row: row.contraction)
        return f"{results.member.capitalize()} {least.leg}: {least.reason}" if least.leg else least.reason

    fields: list[Field] = [
        *(*SYMBOL, TOLERANCE),
        (Column("Residual uncertainty", "sd"), _span("posterior_sd")),
        (
            Column("Posterior sd / prior sd"),
            lambda group: _span("sd_ratio", format_share)(group).replace(" % to", " to"),
        ),
        (Column("Contraction"), _span("contraction", format_contraction)),
        (Column("Verdict", kind="text"), _summarise_verdicts),
        (Column(f"Reason, least-known {results.member}", kind="text"), explain),
    ]
    notes = ("Identifiable: contraction ≥ 0.75.",)
    caption = f"Parameters by symbol, ranges over {results.member}s."
    return _tabulate(caption, fields, _by_symbol(results), notes, "wide parameters")


def _summarise_verdicts(group: Group) -> Cell:
    marks = [_mark_verdict(row) for row in group]
    counts = Counter(mark.text for mark in marks)
    if len(counts) == 1:
        return marks[0]
    return _mark(", ".join(f"{counts[name]} {name}" for name in VERDICTS if name in counts), False, "warning")


def _mark_verdict(row: AuditParameterRow) -> Cell:
    """Return a parameter's verdict; one that loses something of its tolerance is known beside others."""
    text: str = row.verdict
    if row.verdict == "not":
        text = ONLY_TOGETHER if row.contraction >= UNIDENTIFIABLE_CONTRACTION else NEVER
    return Cell(text, VERDICT_LEVELS[row.verdict], badge=True)


def tabulate_parameters(results: AuditResults) -> Table:
    """Return one row per parameter."""
    fields: list[Field] = [
        (Column("Symbol", kind="symbol"), lambda row: row.symbol),
        (Column(results.member.capitalize()), lambda row: str(row.leg or NO_VALUE)),
        (
            Column("Nominal"),
            lambda row: f"{format_nominal(row.nominal, row.prior_sd)} {name_unit(row.unit)}".strip(),
        ),
        (Column("Tolerance", "sd"), lambda row: format_sd(row.prior_sd)),
        (Column("Residual uncertainty", "sd"), lambda row: format_sd(row.posterior_sd)),
        (Column("Posterior sd / prior sd"), lambda row: format_share(row.sd_ratio)),
        (Column("Contraction"), lambda row: format_contraction(row.contraction)),
        (Column("Information gain", "nat"), lambda row: write_two(row.nats)),
        (Column("Verdict", kind="text"), _mark_verdict),
        (Column("Reason", kind="text"), lambda row: row.reason),
    ]
    return _tabulate("All parameters.", fields, results.parameters, style="wide parameters")


# --- ridges ----------------------------------------------------------------------------------------------------------


def build_ridges(results: AuditResults) -> tuple[Card, ...]:
    """Return all groups of ridges, never seen ones first: one sentence for each kind, the other legs behind it."""
    cards = []
    for ridges in results.groups:
        first, structural = ridges[0], ridges[0].kind == "structural"
        legs = sorted(leg for leg in (split_name(r.pivot)[1] for r in ridges) if leg)
        where = f"{results.member}{'s' if len(legs) > 1 else ''} {', '.join(map(str, legs))}" if legs else "machine"
        level, words = EFFECTS[min((ridge.effect for ridge in ridges), key=list(EFFECTS).index)]
        kind = Cell("never seen", "bad") if structural else Cell("weak", "warning")
        facts = _describe_ridges(results, ridges)
        if not structural and (best := choose_for_ridge(results, first.pivot)) is not None:
            facts.append(f"Best alternative: “{best[0].name}”, contraction {format_contraction(best[1])}.")
        others = tuple(ridge.sentence for ridge in ridges[1:])
        more, symbol = f"{len(others)} more", split_name(first.pivot)[0]
        cards.append(Card(symbol, where, (kind, Cell(words, level)), first.sentence, tuple(facts), more, others))
    return tuple(cards)


def _describe_ridges(results: AuditResults, ridges: list[AuditCombinationRow]) -> list[str]:
    """Return contractions of ridges and what they do to a pose, in sentences."""
    facts, parts = [], []
    if ridges[0].kind == "practical":
        parts.append(f"Contraction {format_range([r.contraction for r in ridges], format_contraction)}")
    drawn = [r.posterior_contraction for r in ridges if not math.isnan(r.posterior_contraction)]
    if drawn:
        parts.append(f"contraction of the draws {format_range(drawn, format_contraction)}")
    if parts:
        facts.append(f"{', '.join(parts)}.")
    position, rotation = (max(getattr(r, key) for r in ridges) for key in ("position", "rotation"))
    if position > 0.0 or rotation > 0.0:
        moved = format_change(position, rotation, results.summary["units"])
        of_all = f" (the largest of all {results.member}s)" if len(ridges) > 1 else ""
        facts.append(f"Largest effect of this step: {moved}{of_all}.")
    judged = [ridge for ridge in ridges if not math.isnan(ridge.sd_over_limit)]
    if judged:
        worst = max(judged, key=lambda ridge: ridge.sd_over_limit)
        most, limit = say_most(format_share(worst.sd_over_limit)), name_requirement(worst.limit)
        facts.append(f"Effect on the tool: {most} of {limit}.")
    return facts


# --- what to free ----------------------------------------------------------------------------------------------------


def tabulate_sets(results: AuditResults) -> Table | None:
    """Return what everything free and the reduced set claim and truly err by; None without a reduced set."""
    if all(math.isnan(row.reduced_claimed_sd) for row in results.parameters):
        return None

    def write_reduced(key: str, absent: str) -> Callable[[Group], str]:
        def write(group: Group) -> str:
            known = [x for row in group if not math.isnan(x := getattr(row, key))]
            return format_range(known, format_sd) if known else absent or write_tolerance(group)

        return write

    def cover_reduced(group: Group) -> str | Cell:
        known = [row.reduced_coverage_90 for row in group if not math.isnan(row.reduced_coverage_90)]
        return _judge_coverage(sum(known) / len(known)) if known else NO_VALUE

    every, reduced = "Everything free", "Reduced set"
    fields: list[Field] = [
        *(*SYMBOL, TOLERANCE),
        (Column("predicted sd", "", every), _span("posterior_sd")),
        (Column("RMSE", "", every), _span("posterior_sd")),
        (Column("90 % coverage", "", every), lambda _: format_share(COVERAGE)),
        (Column("predicted sd", "", reduced), write_reduced("reduced_claimed_sd", "nominal")),
        (Column("RMSE", "", reduced), write_reduced("reduced_true_error", "")),
        (Column("90 % coverage", "", reduced), cover_reduced),
    ]
    note = "RMSE at one prior sd (first order)."
    return _tabulate("Predicted sd and RMSE, full and reduced set.", fields, _by_symbol(results), [note])


def _judge_coverage(coverage: float) -> Cell:
    return Cell(format_share(coverage), "plain" if coverage >= COVERED else "warning")


def tabulate_selection(results: AuditResults) -> Table | None:
    """Return the steps of the selection with the reason of each; None without any."""
    if not results.steps:
        return None

    def give_reason(step: FreeingStepRow) -> str:
        least = format_contraction(step.contraction)
        if step.is_included:
            return f"minimum contraction {least}"
        return f"minimum contraction falls to {least}"

    fields: list[Field] = [
        (Column("Symbol", kind="symbol"), lambda step: step.symbol),
        (Column("Information gain", "nat per parameter"), lambda step: write_two(step.nats)),
        (
            Column("Least contraction", "of all chosen"),
            lambda step: format_contraction(step.contraction),
        ),
        (
            Column("Decision", kind="text"),
            lambda step: _mark("included" if step.is_included else "left out", step.is_included),
        ),
        (Column("Reason", kind="text"), give_reason),
    ]
    notes = [f"Included while contractions ≥ {format_plain(IDENTIFIABLE_CONTRACTION)}."]
    if extra := results.summary["also_identifiable"]:
        notes.append(f"Also possible: {list_names(extra, results.member)}.")
    caption = "Reduced set by symbol, in order."
    return _tabulate(caption, fields, results.steps, notes)


# --- requirements ----------------------------------------------------------------------------------------------------


def tabulate_requirements(results: AuditResults) -> Table | None:
    """Return how each requirement is met before and after the calibration; None without any."""
    if not results.requirements:
        return None
    sd, chance, drawn = "Predicted sd", "Probability to meet it", read_drawn_probabilities(results)

    def mark(r: AuditRequirementRow) -> Cell:
        return _mark("yes", True) if is_met(results, r) else _mark("not reliably", False, "bad")

    fields: list[Field] = [
        (Column("Requirement", kind="text"), lambda r: name_requirement(r.requirement)),
        (Column("Limit"), lambda r: format_plain(r.limit)),
        (Column("Unit", kind="text"), lambda r: name_unit(r.unit)),
        (Column("before", "", sd), lambda r: format_sd(r.prior_sd)),
        (Column("after", "", sd), lambda r: format_sd(r.predicted_sd)),
        (Column("by parameters", "", sd), lambda r: format_sd(r.parameter_sd)),
        (Column("of limit", "", sd), lambda r: format_share(r.predicted_sd / r.limit)),
        (Column("reduced set", "", sd), lambda r: format_sd(r.reduced_sd)),
        (Column("before", "", chance), lambda r: format_probability(r.prior_probability)),
        (Column("after", "", chance), lambda r: format_probability(r.probability)),
        (Column("reduced set", "", chance), lambda r: format_probability(r.reduced_probability)),
        (Column("after, by draws", "", chance), lambda r: format_probability(drawn.get(r.requirement, math.nan))),
        (Column("Met", kind="text"), mark),
    ]
    if not drawn:
        del fields[-2]
    note = f"Sd: largest. Met: P ≥ {format_plain(LIKELY)} at all poses."
    caption = "Requirements before and after."
    return _tabulate(caption, fields, results.requirements, [note])


# --- what would help -------------------------------------------------------------------------------------------------


def tabulate_changes(results: AuditResults) -> Table | None:
    """Return what each change of the plan would determine, the plan itself first; None without any."""
    if not results.changes:
        return None
    planned = PlanChange(
        "as it is" if results.is_measured else "as planned",
        results.n_poses,
        True,
        False,
        results.summary["total_nats"],
        results.n_identifiable,
        {},
        {r.requirement: r.predicted_sd for r in results.requirements},
    )

    def write_sd(name: str) -> Callable[[PlanChange], str]:
        def write(change: PlanChange) -> str:
            value = change.requirements.get(name, math.nan)
            return NO_VALUE if math.isnan(value) and change is not planned else format_sd(value)

        return write

    fields: list[Field] = [
        (Column("Plan change", kind="text"), name_change),
        (Column("Poses"), lambda change: str(change.n_poses)),
        (Column("Information gain", "nat"), lambda change: format_fixed(change.nats, 1)),
        (
            Column("Determined", "parameters"),
            lambda change: str(change.n_identifiable) if change.is_feasible else NO_VALUE,
        ),
        *(
            (Column(name_requirement(r.requirement), name_unit(r.unit), "Predicted sd"), write_sd(r.requirement))
            for r in results.requirements
        ),
        (Column("Tightest", "of its limit"), lambda change: format_share(measure_worst(results, change))),
    ]
    notes = []
    if any(change.is_beyond_range for change in results.changes):
        notes.append("†: beyond actuator range.")
    if any(not change.is_feasible for change in results.changes):
        notes.append("‡: unreachable.")
    shown = fields if results.requirements else fields[:-1]
    return _tabulate("Alternative plans.", shown, [planned, *results.changes], notes, "wide")


def tabulate_ridge_help(results: AuditResults) -> Table | None:
    """Return for each practical ridge the change that tells most of it; None without ridges or changes."""
    practical = [ridge for ridge in results.ridges if ridge.kind == "practical"]
    found = [(ridge, best) for ridge in practical if (best := choose_for_ridge(results, ridge.pivot)) is not None]
    if not found:
        return None
    fields: list[Field] = [
        (Column("Ridge of", kind="symbol"), lambda one: split_name(one[0].pivot)[0]),
        (Column(results.member.capitalize()), lambda one: str(split_name(one[0].pivot)[1] or NO_VALUE)),
        (Column("Contraction", "as planned"), lambda one: format_contraction(one[0].contraction)),
        (Column("Best plan change", kind="text"), lambda one: one[1][0].name),
        (Column("Contraction", "then"), lambda one: format_contraction(one[1][1])),
        (
            Column("", kind="text"),
            lambda one: (
                _mark("determined", True) if one[1][1] >= IDENTIFIABLE_CONTRACTION else _mark("still not", False)
            ),
        ),
    ]
    return _tabulate("Best alternative by weak combination.", fields, found)


# --- checks ----------------------------------------------------------------------------------------------------------


def tabulate_profiles(results: AuditResults) -> Table | None:
    """Return the 95 % intervals of the profiles and what moves along them; None without any."""
    profiles = results.tables.get("profiles")
    if profiles is None:
        return None

    def write_interval(key: str) -> Callable[[pd.DataFrame], str]:
        def write(one: pd.DataFrame) -> str:
            centre = float(one.sort_values("deviance_total")["value"].iloc[0])
            low, high = span_profile(one, key)
            return format_fixed_span(low - centre, high - centre)

        return write

    def split(one: pd.DataFrame) -> tuple[str, int]:
        return split_name(str(one["parameter"].iloc[0]))

    group = "95 % interval, from expected"
    fields: list[Field] = [
        (Column("Symbol", kind="symbol"), lambda one: split(one)[0]),
        (Column(results.member.capitalize()), lambda one: str(split(one)[1] or NO_VALUE)),
        (Column("Unit", kind="text"), lambda one: name_unit(str(one["unit"].iloc[0]))),
        (Column("measurements alone", "", group), write_interval("deviance_data")),
        (Column("with the tolerances", "", group), write_interval("deviance_total")),
        (Column("Moves along", kind="text"), lambda one: _name_followers(results, one["parameter"].iloc[0])),
    ]
    note = "Open: no finite 95 % interval."
    items = [one for _, one in profiles.groupby("parameter", sort=False)]
    return _tabulate("Profile likelihoods.", fields, items, [note])


def _name_followers(results: AuditResults, name: str) -> str:
    """Return the parameters that move most along a profile, in units of their tolerances."""
    known = {row.parameter: row for row in results.parameters}
    paths = results.tables.get("profile_paths", pd.DataFrame(columns=["parameter", "other", "other_value"]))
    rows = paths[(paths["parameter"] == name) & paths["other"].isin(list(known))]
    reach = {str(other): float(np.ptp(values.to_numpy())) for other, values in rows.groupby("other")["other_value"]}
    if not reach:
        return NO_VALUE
    share = {other: size / known[other].prior_sd for other, size in reach.items()}
    words = [
        f"{other} by {format_sd(reach[other])} {name_unit(known[other].unit)}".strip()
        for other in sorted(share, key=lambda one: -share[one])[:FOLLOWERS]
        if share[other] > 0.1
    ]
    return join_words(words) if words else "none by 0.1 prior sd"


def tabulate_posterior(results: AuditResults) -> Table | None:
    """Return standard deviations from draws beside those from the information, by symbol; None without draws."""
    posterior = results.summary.get("posterior")
    if posterior is None or not posterior["parameters"]:
        return None
    drawn = {name: float(one["sd"]) for name, one in posterior["parameters"].items()}
    groups = [[row for row in group if row.parameter in drawn] for group in _by_symbol(results)]
    fields: list[Field] = [
        *(*SYMBOL, TOLERANCE),
        (Column("from information", "sd", "Residual uncertainty"), _span("posterior_sd")),
        (
            Column("from draws", "sd", "Residual uncertainty"),
            lambda group: format_range([drawn[row.parameter] for row in group], format_sd),
        ),
        (
            Column("Ratio", "draws / linearised"),
            lambda group: format_range([drawn[row.parameter] / row.posterior_sd for row in group], write_two),
        ),
    ]
    caption = "Posterior sd: draws against linearised."
    return _tabulate(caption, fields, [group for group in groups if group])


def tabulate_simulated(results: AuditResults) -> list[Table]:
    """Return predicted beside simulated standard deviations, a table for each set of free parameters."""
    there = {what: results.summary.get(key) for key, what in SIMULATED.items()}
    return [_tabulate_simulated(what, found) for what, found in there.items() if found is not None and found["symbols"]]


def _tabulate_simulated(what: str, simulated: Summary) -> Table:
    def write_ratio(one: Summary) -> Cell:
        text = f"{format_fixed(one['ratio'], 3)} ± {format_fixed(one['ratio_se'], 3)}"
        return Cell(text, "warning" if is_off(one["ratio"], one["ratio_se"]) else "plain")

    fields: list[Field] = [
        (Column("Symbol", kind="symbol"), lambda one: one["symbol"]),
        (Column("Unit", kind="text"), lambda one: name_unit(one["unit"])),
        (Column("Predicted sd"), lambda one: format_sd(one["claimed_sd"])),
        (Column("Predicted RMSE"), lambda one: format_sd(one["predicted_sd"])),
        (Column("Simulated RMSE"), lambda one: format_sd(one["simulated_sd"])),
        (Column("Simulated / predicted", "± standard error"), write_ratio),
        (Column("90 % coverage"), lambda one: _judge_coverage(one["coverage_90"])),
    ]
    made = f"{simulated['n_converged']} of {count(simulated['n'], 'calibration')} converged"
    caption = f"Simulated calibrations, rms over legs; {what}; {made}."
    notes = [
        f"All: 90 % coverage {format_share(simulated['coverage_90'])}, RMSE / predicted sd "
        f"{format_significant(simulated['rms_z'], 3)}."
    ]
    kept = [
        f"{name_requirement(name)} {one['kept']} of {one['n']} "
        f"(expected {one['expected_low']} to {one['expected_high']})"
        for name, one in simulated["requirements"].items()
    ]
    if kept:
        notes.append(f"Requirements met: {join_words(kept)}.")
    items = [{**one, "symbol": symbol} for symbol, one in simulated["symbols"].items()]
    return _tabulate(caption, fields, items, notes)


def tabulate_audit(results: AuditResults) -> Table:
    """Return what was audited: units, rank, what is learnt, directions, workspace."""
    summary, units = results.summary, results.summary["units"]
    gap = summary.get("structural_gap")
    rank = f"{summary['structural_rank']} of {summary['n_parameters']}"
    clear = "clear" if summary["structural_rank_is_clear"] else "NOT clear"
    directions = ", ".join(f"{summary[f'n_{kind}']} {kind}" for kind in ("structural", "practical", "informed"))
    rows = [
        ["Audit", summary["name"]],
        ["Units", f"{name_unit(units['length'])}, {name_unit(units['angle'])}"],
        ["Structural rank", f"{rank}, {clear}{f', gap {format_sd(gap)}' if gap is not None else ''}"],
        ["Information gain", f"{format_fixed(summary['total_nats'], 1)} nat"],
        ["Directions", directions],
        ["Workspace", _describe_workspace(summary["plan"].get("workspace", {}))],
    ]
    return make_pairs("The audit.", rows)


def _describe_workspace(stated: Summary) -> str:
    """Say where accuracy counts: half widths about home, or bounds of coordinates in the audit's units."""
    if not stated:
        return "none stated"
    if "position_mm" not in stated:
        return ", ".join(f"{name} {format_plain(low)} to {format_plain(high)}" for name, (low, high) in stated.items())
    position, rotation = (
        " × ".join(f"±{format_plain(one)}" for one in stated[k]) for k in ("position_mm", "rotation_deg")
    )
    return f"{position} mm, {rotation} deg, {stated['shape']}, {count(stated['poses'], 'pose')}"
