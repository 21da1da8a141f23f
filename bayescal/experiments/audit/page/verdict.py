"""The verdict of an audit in sentences computed from its numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pandas as pd

from bayescal.experiments.audit.page.model_error import state_model_error
from bayescal.experiments.audit.page.results import KNOWN_LIMITS, AuditResults, PlanChange
from bayescal.experiments.audit.page.wording import (
    count,
    format_probability,
    format_range,
    format_share,
    name_requirement,
    say,
)
from bayescal.experiments.audit.rows import PARAMETER_ERROR, AuditRequirementRow, SensorSetRow
from bayescal.experiments.runner.results import Summary
from bayescal.experiments.shared.headline import (
    LIKELY,
    UNDETERMINED,
    rate_probability,
    say_accuracy,
    say_count,
    say_probability,
    say_requirements,
    write_headline,
)
from bayescal.experiments.shared.knowledge_page import name_titles, show_predicted_error, state_next
from bayescal.limits import COVERAGE
from bayescal.report.blocks import KeyFigure, Level, Statement
from bayescal.report.numbers import (
    capitalise,
    format_count,
    format_fixed,
    format_percent,
    format_plain,
    format_significant,
    name_some,
)
from bayescal.report.symbols import format_amount, format_place, name_unit

NOTABLE_NATS = 2.0  # a change by which less more is learnt is not named
NOTABLE_SHARE = 0.9  # of the worst predicted sd; a change that leaves more is not named
OFF = 3.0  # standard errors of a ratio of simulated to predicted sd
OFF_SHARE = 0.05
AGREED_DEG = 10.0  # principal angle between the ridges from draws and from information
MAX_SENSOR_ERROR_RATIO = 1.1  # times the error of the best set of sensors, which a smaller one may have
MIN_ERROR_REDUCTION = 0.02  # of the error, by which one more pose should lower it


def state_headline(results: AuditResults) -> str:
    """Return which sensors to use, how accurate the tool will be against what is required, and what to do next."""
    parts, titles = [], name_titles(results.tables)
    if len(titles) > 1:
        parts.append(f"Best of {say_count(len(titles))} sensor sets: “{titles[results.best]}”")
    else:
        parts.append(describe_determined(results))
    if results.requirements:
        each = {name_requirement(r.requirement): find_probability(results, r) for r in results.requirements}
        together = min([results.together, *each.values()])
        parts.append(say_requirements({**each, "": together} if math.isfinite(results.together) else each))
    else:
        parts.append("; ".join([*_state_accuracy(results), say_requirements({})]))
    return write_headline([*parts, _say_next(results)])


def _say_next(results: AuditResults) -> str:
    """Return what to change of the plan where requirements are at risk, else to measure."""
    if not results.requirements:
        return "Next: state [requirements]"
    if not _is_at_risk(results):
        return "" if results.is_measured else "Next: measure the planned poses"
    ranked = rank_help(results)
    helps = ranked and ranked[0][1]
    return f"Next: change the plan to “{ranked[0][0].name}”" if helps else "Next: change sensors or requirements"


def _state_accuracy(results: AuditResults) -> list[str]:
    """Return how accurate the tool will be, where readings say it."""
    rows = results.accuracy
    known = [row for row in rows if math.isfinite(row.posterior_sd)]
    if not known:
        return [UNDETERMINED] if rows else []
    asked = results.summary["units"]
    amounts = {row.coordinate: format_amount(row.posterior_sd, row.unit, 2, asked) for row in known}
    return [f"tool {say_accuracy(amounts)}, rms over the workspace"]


def describe_determined(results: AuditResults) -> str:
    """Return how many parameters are determined and how many combinations are not."""
    poses = "calibration" if results.is_measured else "planned"
    n, known = int(results.summary["n_parameters"]), results.n_identifiable
    structural = sum(ridge.kind == "structural" for ridge in results.ridges)
    planned, (low, high) = results.tables["spectrum"]["planned"], KNOWN_LIMITS
    weak, dead = int(((planned >= low) & (planned < high)).sum()), int((planned < low).sum()) - structural
    counts = ((structural, "structurally unidentifiable"), (dead, "not determined"), (weak, "weak"))
    parts = [f"{number} {said}" for number, said in counts if number > 0]
    combinations = f"; combinations: {', '.join(parts)}" if parts else ""
    return f"The {results.n_poses} {poses} poses determine {known} of {count(n, 'parameter')}{combinations}"


def list_key_figures(results: AuditResults) -> list[KeyFigure]:
    """Return what is determined, the tool's uncertainty before and after, requirements, and checks by simulation."""
    n, known = int(results.summary["n_parameters"]), results.n_identifiable
    found = [
        KeyFigure("Parameters determined", f"{known} of {n}", "", "good" if known == n else "warning"),
        KeyFigure("Poses", str(results.n_poses), "calibration" if results.is_measured else "planned"),
    ]
    tool = [row for row in results.accuracy if math.isfinite(row.posterior_sd)]
    found += [show_predicted_error(tool, results.summary["units"])] if tool else []
    if results.requirements:
        least = min(find_probability(results, r) for r in results.requirements)
        together = min(results.together, least) if math.isfinite(results.together) else least
        found.append(
            KeyFigure("Probability of all requirements", format_probability(together), "", rate_probability(together))
        )
    found.append(KeyFigure("Information", format_fixed(results.summary["total_nats"], 0), "nat"))
    if (simulated := results.summary.get("simulated_calibrations")) is not None:
        share, enough = simulated["coverage_90"], simulated["n_converged"] == simulated["n"]
        rated: Level = "good" if enough else "warning"
        found.append(KeyFigure("Simulated 90 % coverage", format_share(share), "", rated))
    return found if len(found) > 3 else [*found, KeyFigure("Unidentifiable combinations", str(len(results.ridges)))]


def list_failures(results: AuditResults) -> list[Statement]:
    """Return what speaks against relying on the numbers."""
    failures = []
    if not results.summary["structural_rank_is_clear"]:
        gap = results.summary.get("structural_gap")
        found = f"gap {format_fixed(gap, 1)}" if gap is not None else "no gap"
        failures.append(f"Structural rank {results.summary['structural_rank']} is unclear: {found}.")
    posterior = results.summary.get("posterior")
    if posterior is not None and not posterior["converged"]:
        failures.append("Posterior not converged.")
    return [Statement(text, "bad") for text in failures]


def state_verdict(results: AuditResults) -> list[Statement]:
    """Return the findings, the most important first."""
    parts = (
        _state_equations,
        _state_freedom,
        _state_requirements,
        state_model_error,
        _state_harm,
        _state_help,
        _state_sets,
        _state_next,
        _state_selected,
        _state_counts,
        _state_special_case,
        _state_far_readings,
        _state_simulated,
        _state_posterior,
        _state_reduced,
    )
    return [statement for part in parts for statement in part(results)]


# --- poses and equations ---------------------------------------------------------------------------------------------


def count_poses(results: AuditResults) -> str:
    """Return how many poses there are, and how many measured ones are left out."""
    if not results.is_measured:
        return count(results.n_poses, "planned pose")
    held = results.summary["plan"].get("n_verification_poses", 0)
    left_out = f"; {held} for verification {'is' if held == 1 else 'are'} left out" if held else ""
    return f"{count(results.n_poses, 'calibration pose')}{left_out}"


def _state_equations(results: AuditResults) -> Iterator[Statement]:
    """Warn of variants whose readings are fewer than what they are to determine."""
    for row in results.variants:
        if row.n_equations < row.n_parameters:
            text = f"“{row.title}”: {row.n_equations} equations for {row.n_parameters} unknowns."
            yield Statement(text, "warning", "Data", value=row.n_equations, limit=row.n_parameters)


# --- what to free, and what stays hidden -----------------------------------------------------------------------------


def _state_freedom(results: AuditResults) -> Iterator[Statement]:
    """Return which parameters are not determined, or only weakly; all are free in a study."""
    n = len(results.parameters)
    if results.n_identifiable == n:
        yield Statement(f"All {n} parameters are determined together.", "good", "Parameters", value=n, limit=n)
        return
    for verdict, one, several in (
        ("not", "is not determined", "are not determined"),
        ("weak", "keeps more than half of its uncertainty", "keep more than half of their uncertainty"),
    ):
        names = [row.parameter for row in results.parameters if row.verdict == verdict]
        if names:
            said = one if len(names) == 1 else several
            text = f"{len(names)} of {n} parameters {said}: {name_some(names)}."
            yield Statement(text, "warning", "Parameters", value=len(names), limit=0.0)


def _state_reduced(results: AuditResults) -> Iterator[Statement]:
    """Return by how much the errors of a reduced set exceed its stated sd; nothing where nothing would be left out."""
    others = [s for s in results.symbols if any(row.symbol == s and not row.reduced_set for row in results.parameters)]
    free = [s for s in results.symbols if s not in others]
    reduced = results.summary["reduced_set"]
    if reduced is None or not others:
        return
    ratio, coverage = reduced["rms_z"], reduced["coverage_90"]
    text = (
        f"Reduced set {name_some(free)}: RMSE / stated sd {format_significant(ratio, 2)}, coverage "
        f"{format_share(coverage)}."
    )
    action = f"Valid only if {name_some(others)} are nominal."
    yield Statement(text, "warning", "Reduced set", value=ratio, limit=1.0, action=action)


def _state_harm(results: AuditResults) -> Iterator[Statement]:
    """Say whether what remains unknown moves the pose against a limit."""
    if not results.ridges:
        return
    lead, n = "Unidentifiable combinations", len(results.ridges)
    known = [ridge for ridge in results.ridges if not math.isnan(ridge.sd_over_limit)]
    if not known:
        text = f"Effect of {n} unidentifiable combinations not assessed: no requirement."
        yield Statement(text, "plain", lead, value=n)
        return
    worst = max(known, key=lambda ridge: ridge.sd_over_limit)
    share, limit = say(format_share(worst.sd_over_limit)), name_requirement(worst.limit)
    matter = [ridge for ridge in results.ridges if ridge.effect in ("noticeable", "harmful")]
    level: Level = "good" if not matter else "warning"
    if any(ridge.effect == "harmful" for ridge in matter):
        level = "bad"
    which = f"{len(matter)} of {n} matter" if matter else f"none of {n} matters"
    text = f"Largest effect on the tool: {share} of the {limit} limit ({worst.pivot}); {which}."
    yield Statement(text, level, lead, value=worst.sd_over_limit, limit=1.0)


def _state_special_case(results: AuditResults) -> Iterator[Statement]:
    """Warn where a machine a little off the expected one has a larger rank."""
    elsewhere, rank = results.summary.get("structural_rank_elsewhere"), results.summary["structural_rank"]
    if isinstance(elsewhere, int) and elsewhere > rank:
        text = f"Nominal geometry is special: rank {rank}, {elsewhere} slightly off."
        action = "These may be weakly identifiable."
        yield Statement(text, "warning", "Symmetry", value=rank, limit=elsewhere, action=action)


def _state_far_readings(results: AuditResults) -> Iterator[Statement]:
    """Return how far from zero channels read, so that position and direction are strongly correlated."""
    found, asked = results.summary.get("far_readings"), results.summary["units"]
    if found is None:
        return
    names = name_some([str(one) for one in found["channels"]])
    reading = format_place("x_mm", float(found["reading_mm"]), asked)
    unit = name_unit("x_mm", asked)
    text = f"Position and direction of {names} correlate: readings {reading} {unit} from zero."
    action = "Move the zero to mid-range."
    yield Statement(text, "plain", "Actuators' zero", value=float(found["reading_mm"]), unit="mm", action=action)


# --- requirements ----------------------------------------------------------------------------------------------------


def read_drawn_probabilities(results: AuditResults) -> dict[str, float]:
    """Return the probability to meet each requirement by draws of the posterior; empty without them."""
    posterior = results.summary.get("posterior") or {}
    found = {name: values.get("probability") for name, values in (posterior.get("requirements") or {}).items()}
    return {name: float(value) for name, value in found.items() if value is not None}


def find_probability(results: AuditResults, requirement: AuditRequirementRow) -> float:
    """Return with which probability a requirement is met: the smaller one where draws of the posterior say another."""
    return min(requirement.probability, read_drawn_probabilities(results).get(requirement.requirement, 1.0))


def is_met(results: AuditResults, requirement: AuditRequirementRow) -> bool:
    """Whether a requirement counts as met, in verdict, table and picture alike."""
    return find_probability(results, requirement) >= LIKELY


def _share(requirement: AuditRequirementRow) -> float:
    return requirement.predicted_sd / requirement.limit


def _state_requirements(results: AuditResults) -> Iterator[Statement]:
    requirements, lead = results.requirements, "Requirements"
    if not requirements:
        yield Statement("No requirement given.", "plain", lead, action="State [requirements].")
        return
    lost = [name_requirement(r.requirement) for r in requirements if math.isnan(r.predicted_sd)]
    if lost:
        yield Statement(f"{name_some(lost)}: not determined by own sensors.", "bad", lead)
        return
    n, failing = len(requirements), [r for r in requirements if not is_met(results, r)]
    worst = max(requirements, key=_share)
    least = min(requirements, key=lambda r: find_probability(results, r))
    chance, before = find_probability(results, least), min(r.prior_probability for r in requirements)
    verdict = f"{len(failing)} of {n} fail" if failing else f"all {n} pass"
    text = f"{capitalise(verdict)}; least {name_requirement(least.requirement)}: P = {format_probability(chance)} "
    text += f"(before calibration {format_probability(before)})."
    yield Statement(text, "bad" if failing else "good", lead, value=chance, limit=LIKELY)
    text = f"Tightest: {name_requirement(worst.requirement)}, predicted sd {format_share(_share(worst))} of the limit."
    part = (worst.parameter_sd / worst.predicted_sd) ** 2 if worst.predicted_sd else 0.0
    action = ""
    if failing:
        action = f"Geometry: {format_share(part)} of its variance."
    if worst.predicted_sd * math.sqrt(max(0.0, 1.0 - part)) > worst.limit:
        action = "Sensor noise in use exceeds the limit."
    yield Statement(text, "bad" if failing else "plain", lead, value=_share(worst), limit=1.0, action=action)


# --- what would help -------------------------------------------------------------------------------------------------


def measure_worst(results: AuditResults, change: PlanChange) -> float:
    """Return the largest predicted sd under a change as a share of its limit; NaN without requirements."""
    shares = [
        change.requirements[r.requirement] / r.limit
        for r in results.requirements
        if r.requirement in change.requirements
    ]
    return max(shares) if shares else math.nan


def rank_help(results: AuditResults, beyond_range: bool = False) -> list[tuple[PlanChange, bool]]:
    """Return the changes in the order in which they help, and whether each helps noticeably.

    Judged by the tightest requirement where one is at risk, else by what they tell in nats. Changes that need more than
    the actuators' range are left out unless asked for.
    """
    feasible = [c for c in results.changes if c.is_feasible and (beyond_range or not c.is_beyond_range)]
    if _is_at_risk(results):
        now = max(map(_share, results.requirements))
        judged = [(c, measure_worst(results, c)) for c in feasible]
        return [(c, worst <= NOTABLE_SHARE * now) for c, worst in sorted(judged, key=lambda pair: pair[1])]
    ordered = sorted(feasible, key=lambda c: -c.nats)
    return [(c, c.nats - results.summary["total_nats"] >= NOTABLE_NATS) for c in ordered]


def _is_at_risk(results: AuditResults) -> bool:
    return not all(is_met(results, r) for r in results.requirements)


def _state_help(results: AuditResults) -> Iterator[Statement]:
    lead, ranked = "Design alternatives", rank_help(results)
    if not ranked:
        return
    (change, helps), now = ranked[0], results.summary["total_nats"]
    if not helps:
        text = "No alternative helps noticeably."
        yield Statement(text, "plain", lead, value=change.nats, limit=now, unit="nat")
        return
    text = (
        f"Best: “{change.name}”, information {format_fixed(now, 0)} → {format_fixed(change.nats, 0)} nat, determined "
        f"parameters {results.n_identifiable} → {change.n_identifiable}."
    )
    required = results.requirements and not _is_at_risk(results)
    action = "All requirements are met." if required else ""
    yield Statement(text, "plain", lead, value=change.nats, limit=now, unit="nat", action=action)


def choose_for_ridge(results: AuditResults, pivot: str) -> tuple[PlanChange, float] | None:
    """Return the change that tells most of a ridge, within the actuators' range, and its contraction then."""
    known = [
        (c, c.ridges[pivot])
        for c in results.changes
        if c.is_feasible and not c.is_beyond_range and not math.isnan(c.ridges.get(pivot, math.nan))
    ]
    return max(known, key=lambda pair: pair[1]) if known else None


# --- sensors and poses to choose -------------------------------------------------------------------------------------


def find_enough(tables: dict[str, pd.DataFrame]) -> SensorSetRow:
    """Return the smallest of the best sets, the cheapest where there are costs, that is good enough.

    It meets the requirements with a high probability; where none does, it is the one that most probably does; where
    nothing is required it errs hardly more than the best.
    """
    table = tables["front" if "front" in tables else "best_sets"]
    rows = SensorSetRow.read(table)
    if "requirements" in tables:
        likely = [row for row in rows if (row.probability or 0.0) >= LIKELY]
        return likely[0] if likely else max(rows, key=lambda row: (row.probability, -row.goal))
    limit = MAX_SENSOR_ERROR_RATIO * min(row.goal for row in rows)
    return next(row for row in rows if row.goal <= limit)


def _state_sets(results: AuditResults) -> Iterator[Statement]:
    """Say which sensors are enough, or that none of the sets is any good."""
    tables, lead = results.tables, "Sensors"
    if "sensor_sets" not in tables:
        return
    n_sets, asked = format_count(len(tables["sensor_sets"])), results.summary["sensor_selection"]
    if "best_sets" not in tables:
        yield Statement(f"None of {n_sets} sensor sets determines the pose.", "bad", lead, value=0.0)
        return
    row, required = find_enough(tables), [str(one) for one in asked["required_sensors"]]
    words = f"{row.n_sensors} of {len(asked['candidates'])} ({name_some(row.sensors.split(', ') or ['none'])})"
    words += f" besides {name_some(required)}" if required else ""
    words += "" if row.cost is None else f", cost {format_plain(row.cost)}"
    if row.probability is None:
        more = row.goal / float(tables["best_sets"]["goal"].min()) - 1.0
        text = f"Enough of {n_sets} sets: {words}; error {format_percent(more)} above the best."
        yield Statement(text, "plain", lead, value=more, limit=MAX_SENSOR_ERROR_RATIO - 1.0)
        return
    chance, first = row.probability, "Fewest" if row.cost is None else "Cheapest"
    which = f"{first} sensors that pass" if chance >= LIKELY else "No set passes; best"
    text = f"{which}: {words}, P = {say_probability(chance)}."
    yield Statement(text, rate_probability(chance), lead, value=chance, limit=LIKELY)


def _state_next(results: AuditResults) -> Iterator[Statement]:
    yield from state_next(results.tables, results.best, results.summary["units"])


def _state_selected(results: AuditResults) -> Iterator[Statement]:
    """Say what the chosen poses determine, beside the planned ones."""
    mine, summary = results.of_best("selected"), results.summary
    if mine.empty:
        return
    row, last = max(results.accuracy, key=lambda row: row.posterior_sd / row.prior_sd), mine.iloc[-1]
    left = float(last[f"{PARAMETER_ERROR}{row.coordinate}_{row.unit}"])
    chosen, planned = (format_amount(one, row.unit, 2, summary["units"]) for one in (left, row.posterior_sd))
    n = summary["plan"]["n_poses"]
    text = f"{len(mine)} selected poses: {row.coordinate} {chosen}; all {n}: {planned}."
    yield Statement(text, "plain", "Poses", value=left, limit=row.posterior_sd, unit=row.unit)


def find_last_that_pays(counts: pd.DataFrame) -> int:
    """Return after how many poses each further one lowers the error by too little."""
    numbers = counts[counts["error_reduction"] >= MIN_ERROR_REDUCTION]["n_poses"]
    return int(numbers.max()) if len(numbers) else 1


def _state_counts(results: AuditResults) -> Iterator[Statement]:
    """Say where more poses stop paying."""
    counts = results.of_best("pose_counts")
    if counts.empty:
        return
    enough, most = find_last_that_pays(counts), int(counts["n_poses"].max())
    gain = float(counts["error_reduction"].iloc[-1])
    text = f"Beyond {enough} poses each gains less than {format_percent(MIN_ERROR_REDUCTION)}."
    action = ""
    if enough >= most:
        text, action = f"The last of {most} poses gains {format_percent(gain)}.", "Measure more poses."
    yield Statement(text, "plain", "Poses", value=gain, limit=MIN_ERROR_REDUCTION, action=action)


# --- what checks the audit: simulated calibrations and draws of the posterior ----------------------------------------


def is_off(ratio: float, se: float) -> bool:
    """Whether a simulated sd differs from the predicted one by more than chance and by more than a twentieth."""
    return abs(ratio - 1.0) > max(OFF * se, OFF_SHARE)


def write_two(value: float) -> str:
    """Return a number with two decimals."""
    return format_fixed(value, 2)


def _state_simulated(results: AuditResults) -> Iterator[Statement]:
    """Say whether simulated calibrations with everything free agree with what is predicted of them."""
    simulated: Summary | None = results.summary.get("simulated_calibrations")
    if simulated is None or not simulated["symbols"]:
        return
    off = [symbol for symbol, values in simulated["symbols"].items() if is_off(values["ratio"], values["ratio_se"])]
    n, converged, share = simulated["n"], simulated["n_converged"], simulated["coverage_90"]
    lead = "Simulated calibrations"
    text = f"{converged} of {n} converged; 90 % coverage {format_share(share)}."
    yield Statement(text, "good" if converged == n else "warning", lead, value=share, limit=COVERAGE)
    worst = max((values["ratio"] for values in simulated["symbols"].values()), key=lambda ratio: abs(ratio - 1.0))
    span = format_range([values["ratio"] for values in simulated["symbols"].values()], write_two)
    text = f"RMSE / predicted sd = {span} ({f'off: {name_some(off)}' if off else 'as predicted'})."
    yield Statement(text, "warning" if off else "good", lead, value=worst, limit=1.0)
    for name, one in simulated["requirements"].items():
        if not one["agrees"]:
            text = f"Simulated: {name_requirement(name)} met {one['kept']} of {one['n']} times; expected "
            text += f"{one['expected_low']} to {one['expected_high']}."
            yield Statement(text, "warning", lead, value=one["kept"], limit=one["expected_low"])


def _state_posterior(results: AuditResults) -> Iterator[Statement]:
    """Say what draws of the posterior add; nothing without them."""
    posterior = results.summary.get("posterior")
    if posterior is None:
        return
    angle, lead = posterior.get("principal_angle_deg"), "Posterior draws"
    if angle is not None:
        level: Level = "good" if angle <= AGREED_DEG else "warning"
        text = f"Ridges of {format_count(posterior['n_draws'])} draws: {format_fixed(angle, 1)}° from "
        yield Statement(f"{text}ones.", level, lead, value=angle, limit=AGREED_DEG, unit="deg")
    drawn, now = read_drawn_probabilities(results), {r.requirement: r.probability for r in results.requirements}
    for name, value in drawn.items():
        if value < LIKELY <= now.get(name, 0.0):
            text = (
                f"By draws {name_requirement(name)} fails (P = {format_probability(value)}), unlike linearly predicted."
            )
            yield Statement(text, "bad", lead, value=value, limit=LIKELY)
