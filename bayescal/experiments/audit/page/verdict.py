"""The verdict of an audit in sentences computed from its numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bayescal.experiments.audit.page.borne_out import find_probability, is_kept, state_posterior, state_simulated
from bayescal.experiments.audit.page.far_readings import state_far_readings
from bayescal.experiments.audit.page.poses import state_poses
from bayescal.experiments.audit.page.results import AuditResults, Change, Requirement, Ridge
from bayescal.experiments.audit.page.sensor_sets import state_counts, state_sets
from bayescal.experiments.audit.page.variants import state_equations, state_selected
from bayescal.experiments.audit.page.wording import (
    count,
    format_probability,
    format_range,
    format_share,
    list_names,
    name_requirement,
    say,
    say_most,
)
from bayescal.experiments.shared.headline import say_accuracy, say_count, say_requirements, write_headline
from bayescal.experiments.shared.knowledge_page import name_titles, state_next
from bayescal.report.blocks import Level, Statement
from bayescal.report.numbers import format_fixed, format_significant, join_words
from bayescal.report.reading import list_rows
from bayescal.report.symbols import format_amount

UNLIKELY = 0.5
WORTH_NATS = 2.0  # a change that tells less more is not worth a name
WORTH_SHARE = 0.9  # of the worst predicted sd; a change that leaves more is not worth a name
MANY = 12  # parameters that are named
FIXING_COSTS = 1.25  # growth of a predicted sd from which on fixing the rest is not cheap


def state_headline(results: AuditResults) -> str:
    """Return which sensors to use, how likely what is required is kept, and how much of the machine is determined."""
    parts, titles = [], name_titles(results.tables) if "variants" in results.tables else {}
    if len(titles) > 1:
        parts.append(f"Best of {say_count(len(titles))} sets of sensors: “{titles[results.best]}”")
    if results.requirements:
        each = {name_requirement(r.name): find_probability(results, r) for r in results.requirements}
        together = min([results.together, *each.values()])
        subject = "the calibration" if results.is_measured else "the plan"
        parts.append(say_requirements({**each, "": together} if math.isfinite(results.together) else each, subject))
        parts.append(describe_determined(results))
    else:
        parts += [describe_determined(results), *_state_accuracy(results), "Requirements: not stated"]
    return write_headline(parts)


def _state_accuracy(results: AuditResults) -> list[str]:
    """Return how accurate the tool will be, where readings say it."""
    if "accuracy" not in results.tables:
        return []
    asked, table = results.summary["units"], results.tables["accuracy"]
    rows = [row for row in list_rows(table[table["variant"] == results.best]) if math.isfinite(row["after"])]
    if not rows:
        return ["the machine's own sensors do not determine where it is"]
    amounts = {str(row["coordinate"]): format_amount(row["after"], row["unit"], 2, asked) for row in rows}
    return [f"uncertainty of the tool over the workspace: {say_accuracy(amounts)}"]


def describe_determined(results: AuditResults) -> str:
    """Return how many parameters are determined and how many combinations are not."""
    summary, poses = results.summary, f"the {results.n_poses} {_planned(results)} poses"
    n, known = int(summary["n_parameters"]), results.n_identifiable
    text = f"Of {count(n, 'parameter')} {poses} determine {known or 'none on its own'}"
    if known == n:
        text = f"{poses[0].upper()}{poses[1:]} determine all {count(n, 'parameter')}"
    structural = [r for r in results.ridges if r.kind == "structural"]
    in_part, dead = results.count_hidden()
    dead = max(0, dead - len(structural))
    these = "these" if results.is_measured else "the planned ones"
    parts = []
    if structural:
        parts.append(f"{count(len(structural), 'combination')} cannot be determined by any measurement of this kind")
    if dead:
        parts.append(f"{_more(dead, bool(parts))} hardly touched by {these}")
    if in_part:
        parts.append(f"{_more(in_part, bool(parts))} learnt only in part")
    return f"{text}{'; ' if parts else ''}{join_words(parts)}."


def _planned(results: AuditResults) -> str:
    return "calibration" if results.is_measured else "planned"


def _more(number: int, after: bool) -> str:
    what = f"{number} more" if after else count(number, "combination")
    return f"{what} {'is' if number == 1 else 'are'}"


def list_failures(results: AuditResults) -> list[Statement]:
    """Return what speaks against relying on the numbers."""
    failures = []
    if not results.summary["structural_rank_is_clear"]:
        gap = results.summary.get("structural_gap")
        found = f"a gap of {format_fixed(gap, 1)}" if gap is not None else "no gap"
        failures.append(
            f"The structural rank, {results.summary['structural_rank']}, is not clear: the spectrum has {found} there, "
            "and rounding may hide a combination or feign one (see the spectrum)."
        )
    posterior = results.summary.get("posterior")
    if posterior is not None and not posterior["converged"]:
        failures.append("The posterior did not converge; what rests on its draws is not to be relied on.")
    return [Statement(text, "bad") for text in failures]


def state_verdict(results: AuditResults) -> list[Statement]:
    """Return the sentences below the headline."""
    return [
        *state_poses(results),
        *(state_equations(results.tables) if "variants" in results.tables and not results.is_of_legs else []),
        *_state_freedom(results),
        *_state_requirements(results),
        *_state_harm(results),
        *_state_help(results),
        *_state_readings(results),
        *_state_special_case(results),
        *state_far_readings(results),
        *state_simulated(results),
        *state_posterior(results),
        *_state_reduced(results),
    ]


def _state_readings(results: AuditResults) -> list[Statement]:
    """Return what only readings of channels have: frames, sensors, poses."""
    tables, summary, asked = results.tables, results.summary, results.summary["units"]
    found = [*state_sets(tables, summary), *state_next(tables, results.best, asked)]
    found += [*state_selected(tables, summary, results.best), *state_counts(tables, results.best)]
    if summary.get("aligned"):
        text = "Accuracies are after alignment: one motion each of base and tool, the same at all poses, is no error."
        found.append(Statement(text, "plain", "Frames"))
    return found


# --- what to free, and what stays hidden -----------------------------------------------------------------------------


def split_reduced(results: AuditResults) -> tuple[list[str], list[str]]:
    """Return symbols of the reduced set and all others, in the order of the layout."""
    by_symbol = results.parameters.groupby("symbol", sort=False)["in_reduced_set"].all()
    return [s for s in results.symbols if by_symbol[s]], [s for s in results.symbols if not by_symbol[s]]


def _state_freedom(results: AuditResults) -> list[Statement]:
    """Say what to free: everything, always."""
    n, known, lead = len(results.parameters), results.n_identifiable, "What to free"
    if known == n:
        return [Statement(f"Everything: all {count(n, 'parameter')} are determined together.", "good", lead)]
    text = (
        f"Everything: all {count(n, 'parameter')}, each with its tolerance as prior, which holds what the poses do not"
    )
    found = [Statement(f"{text} determine.", "good", lead)]
    words = []
    for verdict, said in (("not", "not determined"), ("weak", "uncertainty not halved")):
        names = list(results.parameters.index[results.parameters["verdict"] == verdict])
        words += [f"{list_names(names, results.member)} ({said})"] if 0 < len(names) <= MANY else []
    if words:
        found.append(Statement(f"{join_words(words)}.", "warning", "Poorly determined"))
    return found


def _state_reduced(results: AuditResults) -> list[Statement]:
    """Say what a reduced set claims, and how far it is off; nothing where nothing would be left out."""
    free, others = split_reduced(results)
    reduced = results.summary["reduced_set"]
    if reduced is None or not others:
        return []
    n = int(results.parameters["in_reduced_set"].sum())
    text = (
        f"For reproductions only: {join_words(free)}, {count(n, 'parameter')}, are determined together where "
        f"{join_words(others)} are truly nominal. Off by their tolerances these bend the estimates: the true error is "
        f"{format_significant(reduced['rms_z'], 2)} times the claimed standard deviation (rms), and 90 % intervals "
        f"hold {format_share(reduced['coverage_90'])} of the true values."
    )
    cost = _describe_cost(results)
    return [Statement(f"{text} {cost}".strip(), "warning", "Reduced set")]


def _describe_cost(results: AuditResults) -> str:
    """Say what it does to the pose that the rest is taken for nominal; nothing where nothing is required."""
    if not results.requirements:
        return ""
    worst = max(results.requirements, key=lambda r: r.reduced_sd / r.limit)
    factor = max(r.reduced_sd / r.predicted_sd for r in results.requirements)
    shares = (
        f"({name_requirement(worst.name)}: {format_share(worst.reduced_sd / worst.limit)} of the limit in place of "
        f"{format_share(worst.predicted_sd / worst.limit)}, probability to meet it "
        f"{format_probability(worst.reduced_probability)})"
    )
    if factor < FIXING_COSTS:
        return f"The pose hardly suffers {shares}."
    return f"The pose becomes up to {format_fixed(factor, 1)} times as uncertain {shares}."


def find_worst(results: AuditResults) -> Ridge | None:
    """Return the ridge whose unknown part moves the pose most against a limit; None without requirements."""
    known = [ridge for ridge in results.ridges if not math.isnan(ridge.share)]
    return max(known, key=lambda ridge: ridge.share) if known else None


def _state_harm(results: AuditResults) -> list[Statement]:
    if not results.ridges:
        return []
    lead, worst = "What stays hidden", find_worst(results)
    which = (
        "along the one combination that is not determined"
        if len(results.ridges) == 1
        else f"along each of the {len(results.ridges)} combinations that are not determined"
    )
    if worst is None:
        text = f"Whether it matters {which} is unknown: the design states no requirement."
        return [Statement(text, "plain", lead)]
    which_limit = f"of a requirement ({name_requirement(worst.limit)})"
    matter = [ridge for ridge in results.ridges if ridge.effect in ("noticeable", "harmful")]
    if not matter:
        text = (
            f"What remains unknown {which} moves the predicted pose by {say_most(format_share(worst.share))} "
            f"{which_limit}, taken as 1.96 standard deviations anywhere in the workspace: none of them matters."
        )
        return [Statement(text, "good", lead)]
    level: Level = "bad" if any(ridge.effect == "harmful" for ridge in matter) else "warning"
    text = (
        f"{len(matter)} of {count(len(results.ridges), 'combination')} that are not determined "
        f"{'matters' if len(matter) == 1 else 'matter'} to the pose: what remains unknown along that of {worst.pivot} "
        f"moves the predicted pose by {format_share(worst.share)} {which_limit}; the others are harmless."
    )
    if len(matter) == len(results.ridges):
        text = text.replace("; the others are harmless", "")
    return [Statement(text, level, lead)]


# --- requirements ----------------------------------------------------------------------------------------------------


def _state_requirements(results: AuditResults) -> list[Statement]:
    requirements = results.requirements
    if not requirements:
        return [Statement("The design states none; whether the accuracy suffices is unknown.", "plain", "Requirements")]
    failing = [r for r in requirements if not is_kept(results, r)]
    lost = [r for r in requirements if math.isnan(r.predicted_sd)]
    if lost:
        text = f"{join_words([name_requirement(r.name) for r in lost])} is not determined by the machine's own sensors."
        return [Statement(text, "bad", "Requirements")]
    worst = max(requirements, key=_share)
    uncalibrated = f"before the calibration {_describe_before(requirements)}"
    if not failing:
        least = say(format_probability(min(find_probability(results, r) for r in requirements)))
        text = (
            f"The calibrated machine meets {_all(requirements)} with a probability of {least}, {uncalibrated}. "
            f"Tightest: {name_requirement(worst.name)}, predicted standard deviation {format_share(_share(worst))} of "
            "the limit."
        )
        return [Statement(text, "good", "Requirements")]
    words = [
        f"{name_requirement(r.name)} (probability {format_probability(find_probability(results, r))})" for r in failing
    ]
    text = (
        f"The calibrated machine does not reliably meet {join_words(words)}; {uncalibrated}. {_blame(worst)}"
        f"{' The others are met with more than 90 % probability.' if len(failing) < len(requirements) else ''}"
    )
    return [Statement(text, "bad", "Requirements")]


def _describe_before(requirements: list[Requirement]) -> str:
    prior = [r.prior_probability for r in requirements]
    if max(prior) < UNLIKELY:
        which = "none of them" if len(prior) > 1 else "it"
        most = format_probability(max(prior))
        return f"{which} with more than {most}" if len(prior) > 1 and most[0] != "<" else f"with {say(most)}"
    return f"with {say(format_range(prior, format_probability))}"


def _all(requirements: list[Requirement]) -> str:
    return f"each of its {len(requirements)} requirements" if len(requirements) > 1 else "its requirement"


def _share(requirement: Requirement) -> float:
    return requirement.predicted_sd / requirement.limit


def _blame(worst: Requirement) -> str:
    """Say how tight the worst one is, and whether the geometry or the actuators cause it."""
    share = (worst.geometry_sd / worst.predicted_sd) ** 2 if worst.predicted_sd else 0.0
    if worst.predicted_sd * math.sqrt(max(0.0, 1.0 - share)) > worst.limit:
        return f"{name_requirement(worst.name)}: the noise in use alone exceeds the limit, no calibration helps."
    text = (
        f"Tightest: {name_requirement(worst.name)}, predicted standard deviation {format_share(_share(worst))} of the "
        f"limit; {format_share(share)} of that variance is geometry"
    )
    return (
        f"{text}, which a better calibration would remove."
        if share >= 0.5
        else f"{text}, the rest actuators and model error, which no calibration removes."
    )


# --- what would help -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Help:
    """One of the changes looked at, and whether it is worth its effort."""

    change: Change
    is_worth: bool


def measure_worst(results: AuditResults, change: Change) -> float:
    """Return the largest predicted sd under a change as a share of its limit; NaN without requirements."""
    shares = [change.requirements[r.name] / r.limit for r in results.requirements if r.name in change.requirements]
    return max(shares) if shares else math.nan


def rank_help(results: AuditResults, beyond_range: bool = False) -> list[Help]:
    """Return the changes in the order in which they help.

    Judged by the tightest requirement where one is at risk, else by what they tell in nats. Changes that need more than
    the actuators' range are left out unless asked for.
    """
    feasible = [c for c in results.changes if c.possible and (beyond_range or not c.beyond_range)]
    if _is_at_risk(results):
        now = max(map(_share, results.requirements))
        judged = [(c, measure_worst(results, c)) for c in feasible]
        return [Help(c, worst <= WORTH_SHARE * now) for c, worst in sorted(judged, key=lambda pair: pair[1])]
    now = results.summary["total_nats"]
    ordered = sorted(feasible, key=lambda c: -c.nats)
    return [Help(c, c.nats - now >= WORTH_NATS) for c in ordered]


def _is_at_risk(results: AuditResults) -> bool:
    return not all(is_kept(results, r) for r in results.requirements)


def _state_help(results: AuditResults) -> list[Statement]:
    lead, ranked = "What would help most", rank_help(results)
    if not ranked:
        return []
    if not ranked[0].is_worth:
        return [Statement("None of the changes looked at would help noticeably.", "plain", lead)]
    change = ranked[0].change
    text = f"{_quote(change)}: {_describe_gain(results, change)}."
    if _is_at_risk(results):
        becomes = format_share(measure_worst(results, change))
        text += f" The tightest requirement's standard deviation becomes {becomes} of its limit."
    if len(ranked) > 1 and ranked[1].is_worth:
        second = ranked[1].change
        numbers = f"{format_fixed(second.nats, 0)} nat, {second.n_identifiable} determined"
        text += f" Next comes {_quote(second)} ({numbers})."
    further = rank_help(results, beyond_range=True)[0].change
    if further is not change:
        text += f" {_quote(further)} would help more, but needs more than the actuators' range."
    if results.requirements and not _is_at_risk(results):
        text += " The requirements ask for none of it."
    return [Statement(text, "plain", lead)]


def _quote(change: Change) -> str:
    return f"“{change.name}”"


def _describe_gain(results: AuditResults, change: Change) -> str:
    now, then = results.n_identifiable, change.n_identifiable
    known = (
        f"{then} parameters are determined in place of {now}" if then != now else "no further parameter is determined"
    )
    nats = f"{format_fixed(results.summary['total_nats'], 0)} nat become {format_fixed(change.nats, 0)}"
    return f"{nats}, {'and ' if then != now else ''}{known}"


def choose_for_ridge(results: AuditResults, pivot: str) -> tuple[Change, float] | None:
    """Return the change that tells most of a ridge, within the actuators' range, and its contraction then."""
    known = [
        (c, c.ridges[pivot])
        for c in results.changes
        if c.possible and not c.beyond_range and not math.isnan(c.ridges.get(pivot, math.nan))
    ]
    return max(known, key=lambda pair: pair[1]) if known else None


def _state_special_case(results: AuditResults) -> list[Statement]:
    """Warn where a machine a little off the expected one has a larger rank."""
    elsewhere, rank = results.summary.get("structural_rank_elsewhere"), results.summary["structural_rank"]
    if not isinstance(elsewhere, int) or elsewhere <= rank:
        return []
    text = (
        f"The expected machine is a special case: one that is a tenth of the tolerances off has the rank {elsewhere} "
        f"in place of {rank}, so what is said never to be seen here may be seen faintly on the machine as built."
    )
    return [Statement(text, "warning", "Symmetry")]
