"""The verdict of an audit in sentences computed from its numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pandas as pd

from bayescal.experiments.audit.page.model_error import state_model_error
from bayescal.experiments.audit.page.results import KNOWN_LIMITS, AuditResults, Change, Requirement
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
from bayescal.experiments.frame.results import Row, list_rows
from bayescal.experiments.shared.headline import (
    LIKELY,
    rate_probability,
    say_accuracy,
    say_count,
    say_probability,
    say_requirements,
    write_headline,
)
from bayescal.experiments.shared.knowledge_page import ALIGNED, name_titles, state_next
from bayescal.report.blocks import Level, Statement
from bayescal.report.numbers import (
    format_count,
    format_fixed,
    format_percent,
    format_plain,
    format_significant,
    join_words,
)
from bayescal.report.symbols import format_amount, format_place, name_unit

UNLIKELY = 0.5
NOTABLE_NATS = 2.0  # a change by which less more is learnt is not named
NOTABLE_SHARE = 0.9  # of the worst predicted sd; a change that leaves more is not named
MANY = 12  # parameters that are named
FIXING_COSTS = 1.25  # growth of a predicted sd from which on fixing the rest is not cheap
OFF = 3.0  # standard errors of a ratio of simulated to predicted sd
OFF_SHARE = 0.05
AGREED_DEG = 10.0  # principal angle between the ridges from draws and from information
ENOUGH = 1.1  # times the error of the best set of sensors, which a smaller one may have
PAYS = 0.02  # of the error, by which one more pose should lower it


def state_headline(results: AuditResults) -> str:
    """Return which sensors to use, how likely what is required is met, and how much of the machine is determined."""
    parts, titles = [], name_titles(results.tables)
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
    rows = list_rows(results.of_best("accuracy"))
    known = [row for row in rows if math.isfinite(row.get("after", math.nan))]
    if not known:
        return ["the machine's own sensors do not determine where it is"] if rows else []
    asked = results.summary["units"]
    amounts = {str(row["coordinate"]): format_amount(row["after"], row["unit"], 2, asked) for row in known}
    return [f"uncertainty of the tool over the workspace: {say_accuracy(amounts)}"]


def describe_determined(results: AuditResults) -> str:
    """Return how many parameters are determined and how many combinations are not."""
    poses = f"the {results.n_poses} {'calibration' if results.is_measured else 'planned'} poses"
    n, known = count(int(results.summary["n_parameters"]), "parameter"), results.n_identifiable
    text = f"Of {n} {poses} determine {known or 'none on its own'}"
    if known == results.summary["n_parameters"]:
        text = f"{poses[0].upper()}{poses[1:]} determine all {n}"
    structural = sum(ridge.kind == "structural" for ridge in results.ridges)
    planned, (low, high) = results.tables["spectrum"]["planned"], KNOWN_LIMITS
    in_part, dead = int(((planned >= low) & (planned < high)).sum()), int((planned < low).sum())
    these = "these" if results.is_measured else "the planned ones"
    parts: list[str] = []
    if structural:
        parts.append(f"{count(structural, 'combination')} cannot be determined by any measurement of this kind")
    for number, said in ((dead - structural, f"hardly touched by {these}"), (in_part, "learnt only in part")):
        if number > 0:
            what = f"{number} more" if parts else count(number, "combination")
            parts.append(f"{what} {'is' if number == 1 else 'are'} {said}")
    return f"{text}{'; ' if parts else ''}{join_words(parts)}."


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
    parts = (
        _state_poses,
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
        _state_frames,
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
    held = results.summary["plan"].get("n_held_back", 0)
    left_out = f"; {held} held back {'is' if held == 1 else 'are'} left out" if held else ""
    return f"{count(results.n_poses, 'calibration pose')}{left_out}"


def _state_poses(results: AuditResults) -> Iterator[Statement]:
    if results.is_measured and results.summary["plan"].get("n_held_back", 0):
        yield Statement(f"{count_poses(results)}.", lead="Poses")


def _state_equations(results: AuditResults) -> Iterator[Statement]:
    """Warn of variants whose readings are fewer than what they are to determine."""
    if "variants" not in results.tables:
        return
    for row in list_rows(results.tables["variants"]):
        if row["n_equations"] < row["n_parameters"]:
            text = (
                f"“{row['title']}”: {row['n_equations']} equations for {row['n_parameters']} unknowns; what the "
                "readings do not determine rests on the tolerances."
            )
            yield Statement(text, "warning", "Data")


# --- what to free, and what stays hidden -----------------------------------------------------------------------------


def _state_freedom(results: AuditResults) -> Iterator[Statement]:
    """Say what to free: everything, always."""
    n, lead = count(len(results.parameters), "parameter"), "What to free"
    if results.n_identifiable == len(results.parameters):
        yield Statement(f"Everything: all {n} are determined together.", "good", lead)
        return
    text = f"Everything: all {n}, each with its tolerance as prior, which holds what the poses do not determine."
    yield Statement(text, "good", lead)
    words = []
    for verdict, said in (("not", "not determined"), ("weak", "uncertainty not halved")):
        names = list(results.parameters.index[results.parameters["verdict"] == verdict])
        words += [f"{list_names(names, results.member)} ({said})"] if 0 < len(names) <= MANY else []
    if words:
        yield Statement(f"{join_words(words)}.", "warning", "Poorly determined")


def _state_reduced(results: AuditResults) -> Iterator[Statement]:
    """Say what a reduced set claims, and how far it is off; nothing where nothing would be left out."""
    is_free = results.parameters.groupby("symbol", sort=False)["in_reduced_set"].all()
    free, others = ([s for s in results.symbols if is_free[s] == wanted] for wanted in (True, False))
    reduced = results.summary["reduced_set"]
    if reduced is None or not others:
        return
    n = count(int(results.parameters["in_reduced_set"].sum()), "parameter")
    text = (
        f"For reproductions only: {join_words(free)}, {n}, are determined together where "
        f"{join_words(others)} are truly nominal. Off by their tolerances these bend the estimates: the true error is "
        f"{format_significant(reduced['rms_z'], 2)} times the claimed standard deviation (rms), and 90 % intervals "
        f"hold {format_share(reduced['coverage_90'])} of the true values."
    )
    if results.requirements:
        worst = max(results.requirements, key=lambda r: r.reduced_sd / r.limit)
        factor = max(r.reduced_sd / r.predicted_sd for r in results.requirements)
        suffers = f"becomes up to {format_fixed(factor, 1)} times as uncertain"
        text += (
            f" The pose {'hardly suffers' if factor < FIXING_COSTS else suffers} "
            f"({name_requirement(worst.name)}: {format_share(worst.reduced_sd / worst.limit)} of the limit in place of "
            f"{format_share(worst.predicted_sd / worst.limit)}, probability to meet it "
            f"{format_probability(worst.reduced_probability)})."
        )
    yield Statement(text, "warning", "Reduced set")


def _state_harm(results: AuditResults) -> Iterator[Statement]:
    """Say whether what remains unknown moves the pose against a limit."""
    if not results.ridges:
        return
    lead, n = "What stays hidden", len(results.ridges)
    which = (
        "along the one combination that is not determined"
        if n == 1
        else f"along each of the {n} combinations that are not determined"
    )
    known = [ridge for ridge in results.ridges if not math.isnan(ridge.share)]
    if not known:
        text = f"Whether it matters {which} is unknown: the design states no requirement."
        yield Statement(text, "plain", lead)
        return
    worst = max(known, key=lambda ridge: ridge.share)
    which_limit = f"of a requirement ({name_requirement(worst.limit)})"
    over = "rms over" if results.summary.get("required_of") == "rms" else "anywhere in"
    taken = f"taken as 1.96 standard deviations {over} the workspace"
    matter = [ridge for ridge in results.ridges if ridge.effect in ("noticeable", "harmful")]
    if not matter:
        text = (
            f"What remains unknown {which} moves the predicted pose by {say_most(format_share(worst.share))} "
            f"{which_limit}, {taken}: none of them matters."
        )
        yield Statement(text, "good", lead)
        return
    text = (
        f"{len(matter)} of {count(n, 'combination')} that are not determined "
        f"{'matters' if len(matter) == 1 else 'matter'} to the pose: what remains unknown along that of {worst.pivot} "
        f"moves the predicted pose by {format_share(worst.share)} {which_limit}, {taken}"
    )
    others = "; the others are harmless" if len(matter) < n else ""
    level: Level = "bad" if any(ridge.effect == "harmful" for ridge in matter) else "warning"
    yield Statement(f"{text}{others}.", level, lead)


def _state_special_case(results: AuditResults) -> Iterator[Statement]:
    """Warn where a machine a little off the expected one has a larger rank."""
    elsewhere, rank = results.summary.get("structural_rank_elsewhere"), results.summary["structural_rank"]
    if isinstance(elsewhere, int) and elsewhere > rank:
        text = (
            f"The expected machine is a special case: one that is a tenth of the tolerances off has the rank "
            f"{elsewhere} in place of {rank}, so what is said never to be seen here may be seen faintly on the machine "
            "as built."
        )
        yield Statement(text, "warning", "Symmetry")


def _state_far_readings(results: AuditResults) -> Iterator[Statement]:
    """Say how far from zero channels read, and what a direction's tolerance comes to there."""
    found, asked = results.summary.get("far_readings"), results.summary["units"]
    if found is None:
        return
    reading, moved = float(found["reading_mm"]), format_amount(float(found["moved_mm"]), "mm", 2, asked)
    text = (
        f"Place and direction of {join_words([str(one) for one in found['channels']])} are hardly distinguishable: "
        f"readings lie around {format_place('x_mm', reading, asked)} {name_unit('x_mm', asked)} from where the "
        f"direction's tolerance turns it (it comes to {moved} there); put the zero there, with places and readings "
        "counted from it."
    )
    yield Statement(text, "plain", "Actuators' zero")


# --- requirements ----------------------------------------------------------------------------------------------------


def read_drawn_probabilities(results: AuditResults) -> dict[str, float]:
    """Return the probability to meet each requirement by draws of the posterior; empty without them."""
    posterior = results.summary.get("posterior") or {}
    found = {name: values.get("probability") for name, values in (posterior.get("requirements") or {}).items()}
    return {name: float(value) for name, value in found.items() if value is not None}


def find_probability(results: AuditResults, requirement: Requirement) -> float:
    """Return with which probability a requirement is met: the smaller one where draws of the posterior say another."""
    return min(requirement.probability, read_drawn_probabilities(results).get(requirement.name, 1.0))


def is_met(results: AuditResults, requirement: Requirement) -> bool:
    """Whether a requirement counts as met, in verdict, table and picture alike."""
    return find_probability(results, requirement) >= LIKELY


def _share(requirement: Requirement) -> float:
    return requirement.predicted_sd / requirement.limit


def _state_requirements(results: AuditResults) -> Iterator[Statement]:
    requirements, lead = results.requirements, "Requirements"
    if not requirements:
        yield Statement("The design states none; whether the accuracy suffices is unknown.", "plain", lead)
        return
    lost = [name_requirement(r.name) for r in requirements if math.isnan(r.predicted_sd)]
    if lost:
        yield Statement(f"{join_words(lost)} is not determined by the machine's own sensors.", "bad", lead)
        return
    failing = [r for r in requirements if not is_met(results, r)]
    worst = max(requirements, key=_share)
    uncalibrated = f"before the calibration {_describe_before(requirements)}"
    name, share = name_requirement(worst.name), format_share(_share(worst))
    tightest = f"Tightest: {name}, predicted standard deviation {share} of the limit"
    if not failing:
        least = say(format_probability(min(find_probability(results, r) for r in requirements)))
        which = f"each of its {len(requirements)} requirements" if len(requirements) > 1 else "its requirement"
        text = f"The calibrated machine meets {which} with a probability of {least}, {uncalibrated}. {tightest}."
        yield Statement(text, "good", lead)
        return
    words = [
        f"{name_requirement(r.name)} (probability {format_probability(find_probability(results, r))})" for r in failing
    ]
    part = (worst.geometry_sd / worst.predicted_sd) ** 2 if worst.predicted_sd else 0.0
    cause = "which a better calibration would remove"
    if part < 0.5:
        cause = "the rest actuators and model error, which no calibration removes"
    blame = f"{tightest}; {format_share(part)} of that variance is geometry, {cause}."
    if worst.predicted_sd * math.sqrt(max(0.0, 1.0 - part)) > worst.limit:
        blame = f"{name}: the noise in use alone exceeds the limit, no calibration helps."
    others = " The others are met with more than 90 % probability." if len(failing) < len(requirements) else ""
    text = f"The calibrated machine does not reliably meet {join_words(words)}; {uncalibrated}. {blame}{others}"
    yield Statement(text, "bad", lead)


def _describe_before(requirements: list[Requirement]) -> str:
    prior = [r.prior_probability for r in requirements]
    if max(prior) >= UNLIKELY:
        return f"with {say(format_range(prior, format_probability))}"
    which = "none of them" if len(prior) > 1 else "it"
    most = format_probability(max(prior))
    return f"{which} with more than {most}" if len(prior) > 1 and most[0] != "<" else f"with {say(most)}"


# --- what would help -------------------------------------------------------------------------------------------------


def measure_worst(results: AuditResults, change: Change) -> float:
    """Return the largest predicted sd under a change as a share of its limit; NaN without requirements."""
    shares = [change.requirements[r.name] / r.limit for r in results.requirements if r.name in change.requirements]
    return max(shares) if shares else math.nan


def rank_help(results: AuditResults, beyond_range: bool = False) -> list[tuple[Change, bool]]:
    """Return the changes in the order in which they help, and whether each helps noticeably.

    Judged by the tightest requirement where one is at risk, else by what they tell in nats. Changes that need more than
    the actuators' range are left out unless asked for.
    """
    feasible = [c for c in results.changes if c.possible and (beyond_range or not c.beyond_range)]
    if _is_at_risk(results):
        now = max(map(_share, results.requirements))
        judged = [(c, measure_worst(results, c)) for c in feasible]
        return [(c, worst <= NOTABLE_SHARE * now) for c, worst in sorted(judged, key=lambda pair: pair[1])]
    ordered = sorted(feasible, key=lambda c: -c.nats)
    return [(c, c.nats - results.summary["total_nats"] >= NOTABLE_NATS) for c in ordered]


def _is_at_risk(results: AuditResults) -> bool:
    return not all(is_met(results, r) for r in results.requirements)


def _state_help(results: AuditResults) -> Iterator[Statement]:
    lead, ranked = "What would help most", rank_help(results)
    if not ranked:
        return
    change, helps = ranked[0]
    if not helps:
        yield Statement("None of the changes looked at would help noticeably.", "plain", lead)
        return
    now, then = results.n_identifiable, change.n_identifiable
    known = (
        f"and {then} parameters are determined in place of {now}"
        if then != now
        else "no further parameter is determined"
    )
    nats = f"{format_fixed(results.summary['total_nats'], 0)} nat become {format_fixed(change.nats, 0)}"
    text = f"“{change.name}”: {nats}, {known}."
    if _is_at_risk(results):
        becomes = format_share(measure_worst(results, change))
        text += f" The tightest requirement's standard deviation becomes {becomes} of its limit."
    if len(ranked) > 1 and ranked[1][1]:
        second = ranked[1][0]
        numbers = f"{format_fixed(second.nats, 0)} nat, {second.n_identifiable} determined"
        text += f" Next comes “{second.name}” ({numbers})."
    further = rank_help(results, beyond_range=True)[0][0]
    if further is not change:
        text += f" “{further.name}” would help more, but needs more than the actuators' range."
    if results.requirements and not _is_at_risk(results):
        text += " The requirements ask for none of it."
    yield Statement(text, "plain", lead)


def choose_for_ridge(results: AuditResults, pivot: str) -> tuple[Change, float] | None:
    """Return the change that tells most of a ridge, within the actuators' range, and its contraction then."""
    known = [
        (c, c.ridges[pivot])
        for c in results.changes
        if c.possible and not c.beyond_range and not math.isnan(c.ridges.get(pivot, math.nan))
    ]
    return max(known, key=lambda pair: pair[1]) if known else None


# --- sensors and poses to choose -------------------------------------------------------------------------------------


def find_enough(tables: dict[str, pd.DataFrame]) -> Row:
    """Return the smallest of the best sets, the cheapest where there are prices, that is good enough.

    It meets the requirements with a high probability; where none does, it is the one that most probably does; where
    nothing is required it errs hardly more than the best.
    """
    rows = list_rows(tables["front" if "front" in tables else "best_sets"])
    if "requirements" in tables:
        likely = [row for row in rows if row["probability"] >= LIKELY]
        return likely[0] if likely else max(rows, key=lambda row: (row["probability"], -row["goal"]))
    limit = ENOUGH * min(row["goal"] for row in rows)
    return next(row for row in rows if row["goal"] <= limit)


def _state_sets(results: AuditResults) -> Iterator[Statement]:
    """Say which sensors are enough, or that none of the sets is any good."""
    tables, lead = results.tables, "Sensors"
    if "sensor_sets" not in tables:
        return
    n_sets, asked = format_count(len(tables["sensor_sets"])), results.summary["sensor_choice"]
    if "best_sets" not in tables:
        yield Statement(f"None of {n_sets} sets of sensors determines where the machine is.", "bad", lead)
        return
    row = find_enough(tables)
    chosen = join_words(str(row["sensors"]).split(", ")) if row["n_sensors"] else "nothing"
    always = f" besides {join_words([str(one) for one in asked['always']])}" if asked["always"] else ""
    words = f"{chosen}{always}, {int(row['n_sensors'])} of {len(asked['candidates'])}"
    words += f" at a price of {format_plain(row['price'])}" if "price" in row else ""
    if "requirements" not in tables:
        best = min(one["goal"] for one in list_rows(tables["best_sets"]))
        more = format_percent(row["goal"] / best - 1.0)
        text = f"Enough of {n_sets} sets of sensors: {words}; {more} more error than the best."
        yield Statement(text, "plain", lead)
        return
    n, chance = tables["requirements"]["requirement"].nunique(), say_probability(row["probability"])
    what, likely = "the requirement" if n == 1 else f"all {n} requirements", say_probability(LIKELY)
    if row["probability"] >= LIKELY:
        first = "cheapest" if "price" in row else "fewest"
        text = f"The {first} sensors that meet {what} with at least {likely} probability: {words}; these do with"
    else:
        text = f"No set of sensors meets {what} with {likely} probability; the most likely is {words}, with"
    yield Statement(f"{text} {chance}.", rate_probability(row["probability"]), lead)


def _state_next(results: AuditResults) -> Iterator[Statement]:
    yield from state_next(results.tables, results.best, results.summary["units"])


def _state_selected(results: AuditResults) -> Iterator[Statement]:
    """Say what the chosen poses determine, beside the planned ones."""
    rows, summary = list_rows(results.of_best("selected")), results.summary
    if not rows:
        return
    words = []
    for row in list_rows(results.of_best("accuracy")):
        name, unit = row["coordinate"], row["unit"]
        chosen, planned = (
            format_amount(value, unit, 2, summary["units"])
            for value in (rows[-1][f"after_{name}_{unit}"], row["after"])
        )
        words.append(f"{name} to {chosen} ({planned})")
    text = (
        f"{len(rows)} poses chosen out of {summary['candidates']} determine {join_words(words)}; in brackets what the "
        f"{summary['plan']['n_poses']} planned ones do."
    )
    yield Statement(text, "plain", "Poses")


def find_last_that_pays(counts: pd.DataFrame) -> int:
    """Return after how many poses each further one lowers the error by too little."""
    numbers = counts[counts["gain"] >= PAYS]["n_poses"]
    return int(numbers.max()) if len(numbers) else 1


def _state_counts(results: AuditResults) -> Iterator[Statement]:
    """Say where more poses stop paying."""
    counts = results.of_best("pose_counts")
    if counts.empty:
        return
    enough, most = find_last_that_pays(counts), int(counts["n_poses"].max())
    text = f"From {enough} poses on, one more lowers the error by less than {format_percent(PAYS)}."
    if enough >= most:
        gain = format_percent(float(counts["gain"].iloc[-1]))
        text = f"The last of {most} poses still lowers the error by {gain}: measure more."
    yield Statement(text, "plain", "Poses")


def _state_frames(results: AuditResults) -> Iterator[Statement]:
    if results.summary.get("aligned"):
        text = f"Accuracies are after alignment. {ALIGNED}"
        yield Statement(text, "plain", "Frames")


# --- what checks the audit: simulated calibrations and draws of the posterior ----------------------------------------


def is_off(ratio: float, se: float) -> bool:
    """Whether a simulated sd differs from the predicted one by more than chance and by more than a twentieth."""
    return abs(ratio - 1.0) > max(OFF * se, OFF_SHARE)


def write_two(value: float) -> str:
    """Return a number with two decimals."""
    return format_fixed(value, 2)


def _state_simulated(results: AuditResults) -> Iterator[Statement]:
    """Say whether simulated calibrations with everything free agree with what is predicted of them."""
    simulated: dict[str, Any] | None = results.summary.get("simulated_calibrations")
    if simulated is None or not simulated["symbols"]:
        return
    off = [symbol for symbol, values in simulated["symbols"].items() if is_off(values["ratio"], values["ratio_se"])]
    span = format_range([values["ratio"] for values in simulated["symbols"].values()], write_two)
    text = (
        f"{simulated['n_converged']} of {simulated['n']} simulated calibrations with everything free converged; their "
        f"90 % intervals hold {format_share(simulated['coverage_90'])} of the true values, "
    )
    level: Level = "good" if simulated["n_converged"] == simulated["n"] else "warning"
    if not off:
        text += f"and their errors bear the predicted standard deviations out (ratio {span})."
    else:
        level = "warning"
        text += (
            f"but the errors of {join_words(off)} are not the predicted ones (ratio {span} over all symbols): the "
            "linear prediction does not hold there."
        )
    yield Statement(text, level, "Simulated calibrations")
    words = [
        f"{name_requirement(name)} ({one['kept']} of {one['n']}, expected {one['expected_low']} to "
        f"{one['expected_high']})"
        for name, one in simulated["requirements"].items()
        if not one["agrees"]
    ]
    if words:
        text = f"Calibrated machines do not meet {join_words(words)} as often as is claimed."
        yield Statement(text, "warning", "Requirements, simulated")


def _state_posterior(results: AuditResults) -> Iterator[Statement]:
    """Say what draws of the posterior add; nothing without them."""
    posterior = results.summary.get("posterior")
    if posterior is None:
        return
    angle = posterior.get("principal_angle_deg")
    level: Level = "plain"
    text = f"{format_count(posterior['n_draws'])} draws, {posterior['origin'].rstrip('.')}"
    if angle is not None:
        level = "good" if angle <= AGREED_DEG else "warning"
        text += f": the space of its ridges lies within {format_fixed(angle, 1)}° of that from the information"
        text += "" if level == "good" else ", so the ridges are curved or the linear picture does not hold there"
    yield Statement(f"{text}.", level, "Posterior")
    drawn, now = read_drawn_probabilities(results), {r.name: r.probability for r in results.requirements}
    words = [
        f"{name_requirement(name)} ({format_probability(value)})"
        for name, value in drawn.items()
        if value < LIKELY <= now.get(name, 0.0)
    ]
    if words:
        text = f"By the draws the machine does not reliably meet {join_words(words)}, against the linear prediction."
        yield Statement(text, "bad", "Requirements by draws")
