"""Whether numbers may be relied on: stated noise, tolerances and bounds, convergence, coverage, with the likely cause.

Each is a test that may fail on either side; several are made, so that each has to be clear by itself.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection

from scipy import stats

from bayescal.experiments.runner.results import Summary
from bayescal.experiments.shared.slips import EITHER, LARGE, split_advice, state_denied, state_slip
from bayescal.experiments.shared.soundness import ChiSquare
from bayescal.experiments.study.page.results import NOISE, StudyResults, get_number
from bayescal.experiments.study.page.solutions import state_solutions
from bayescal.experiments.study.rows import ParameterRow
from bayescal.limits import AGREEMENT, ESS_BULK_LIMIT, ESS_BULK_WANTED, RHAT_LIMIT
from bayescal.report.blocks import Level, Statement
from bayescal.report.numbers import format_fixed, format_percent, format_significant, name_some

SERIOUS = 1.5
"""Factor on stated noise or tolerances from which on it is bad."""
REJECTED_SHARE = 0.01
"""Of targets that normal noise leaves alone, robust fits reject fewer."""
COVERAGE, BOUND = 0.90, 0.95
"""What intervals and bounds should hold."""
RARE_PULL = 1e-3
"""Probability that any parameter lies so far from nominal, in its tolerance, below which that is said."""
RARE_BOUND = 0.01
"""A coarser test than those of χ²: with few poses none beyond a bound is rarely out of the question."""
SIZES = "Size of errors"


def has_warnings(study: StudyResults) -> bool:
    """Whether something speaks against the stated noise, tolerances or bounds; tolerances too wide cost little."""
    return any(statement.level in ("warning", "bad") for statement in state_soundness(study))


def state_soundness(study: StudyResults) -> list[Statement]:
    """Return what contradicts the stated noise and tolerances; nothing where nothing does."""
    return [
        *state_slip(study.summary),
        *state_denied(study.summary),
        *state_solutions(study),
        *_state_targets(study),
        *_state_shift(study),
        *_state_misstated(study),
        *_state_misfit(study),
        *_state_tolerances(study),
        *_state_bounds(study),
    ]


def _rate(factor: float) -> Level:
    """Return how bad deviations are that many times as large as stated."""
    return "bad" if max(factor, 1 / factor) >= SERIOUS else "warning"


# --- noise -----------------------------------------------------------------------------------------------------------


def _state_targets(study: StudyResults) -> list[Statement]:
    """Say where targets scatter about their bodies by another noise than stated, or too many were rejected."""
    extraction = study.summary.get("pose_extraction", {})
    per_dof, dof = get_number(extraction, "chi2_per_dof"), get_number(extraction, "dof")
    found, statements = ChiSquare(per_dof * dof, dof), []
    if math.isfinite(found.value) and found.is_off:
        text = f"Target scatter / target noise: {format_significant(found.factor, 2)}."
        action = f"State target noise {('larger' if found.factor > 1 else 'smaller')}, or check targets."
        level = _rate(found.factor)
        statements.append(Statement(text, level, "Noise", value=found.factor, limit=1.0, action=action))
    total, rejected = get_number(extraction, "n_targets"), len(extraction.get("rejected_targets", []))
    if total > 0 and rejected / total > REJECTED_SHARE:
        text = f"{rejected} of {format_fixed(total, 0)} targets rejected."
        level = "bad" if rejected / total > 0.05 else "warning"
        action = "Check them, or state larger noise."
        value, limit = rejected / total, REJECTED_SHARE
        statements.append(Statement(text, level, "Noise", value=value, limit=limit, action=action))
    return statements


def _state_misfit(study: StudyResults) -> list[Statement]:
    """Return whether the best variant's residuals agree with the stated noise, where no noise or tolerance is named."""
    one = study.fit(study.best_name)
    found = ChiSquare(float(one["misfit_chi2"]), float(one["misfit_dof"]))
    if not found.is_off or study.summary.get("misstated"):
        return []
    action = "State larger noise, or extend the models."
    if found.factor < 1:
        action = "State smaller noise."
    error = " and model error" if study.list_terms(study.best_name) else ""
    text = (
        f"{study.label(study.best_name)}: residuals / stated noise{error} "
        f"{format_significant(found.factor, 2)} (χ² {format_significant(found.value, 3)}, dof "
        f"{format_fixed(found.dof, 0)})."
    )
    return [Statement(text, _rate(found.factor), "Noise", value=found.factor, limit=1.0, action=action)]


# --- tolerances ------------------------------------------------------------------------------------------------------


def _state_misstated(study: StudyResults) -> list[Statement]:
    """Say which noise or tolerance the data explain better by another size, or how large the errors are they need."""
    found = study.summary.get("misstated")
    if not isinstance(found, dict):
        return []
    (text, advice), factor, fault = split_advice(str(found["text"])), float(found["factor"]), found["fault"]
    text = re.sub(r" \([^)]*\)", "", text.partition("; ")[0].rstrip(".")) + "."
    kinds: dict[str, tuple[str, Level, str]] = {
        LARGE: (SIZES, "warning", "Find the cause first."),
        "scatter": ("Noise", "warning", "Check the noise first."),
        EITHER: ("Tolerances", "warning", "Check the tolerances first."),
        "noise": ("Noise", _rate(factor), advice),
        "tolerance": ("Tolerances", "bad", advice),
    }
    lead, level, action = kinds.get(fault, ("Tolerances", "plain", advice))
    found_now = [Statement(text, level, lead, value=factor, limit=1.0, action=action)]
    return [*found_now, *(_state_held(study) if fault == "tolerance" else [])]


def say_misstated(study: StudyResults, faults: Collection[str] = (LARGE, EITHER, "noise", "tolerance")) -> str:
    """Return for the headline which noise or tolerance is stated too small, or that errors are far beyond that.

    Empty where it is none of the faults, and where what is stated costs accuracy alone.
    """
    found = study.summary.get("misstated")
    if not isinstance(found, dict) or found["fault"] not in faults or found["factor"] < 1.0:
        return ""
    return str(found["text"]).partition(" (")[0]


def _state_shift(study: StudyResults) -> list[Statement]:
    """Say by how much all measured poses are shifted against the machine as drawn."""
    said = [split_advice(str(text)) for text in study.summary.get("shifted", [])]
    return [Statement(text, "plain", "Data", action=advice) for text, advice in said]


def _state_held(study: StudyResults) -> list[Statement]:
    """Return which dimensions are not free, so that others make up for their errors."""
    held = list(map(str, study.summary.get("not_free", {}).get(study.best_name, [])))
    action = "Give them tolerances; free them."
    return [Statement(f"Not free: {name_some(held)}.", "warning", "Tolerances", action=action)] if held else []


def _state_tolerances(study: StudyResults) -> list[Statement]:
    """Say where the identified machine lies farther from nominal than the tolerances let expect, and none is named.

    χ² is of how far it lies from nominal along what was learnt, in units of the priors. That it lies nearer says
    nothing by itself: errors that the model leaves out may hide a machine, and tolerances too tight bind it.
    """
    best, fit = study.best_name, study.fit(study.best_name)
    found = ChiSquare(float(fit["prior_chi2"]), float(fit["prior_dof"]))
    if study.summary.get("misstated"):
        return []
    rows = [row for row in study.rows(ParameterRow, best) if row.verdict != NOISE]
    pulls = {row.parameter: (row.mean - row.nominal) / row.prior_sd for row in rows}
    far = max(pulls, key=lambda key: abs(pulls[key]), default=None)
    if not found.is_off or found.factor <= 1.0:
        return [] if far is None else _state_outlier(far, pulls[far], len(pulls))
    which = "" if far is None else f", farthest {far} by {format_significant(pulls[far], 2)}"
    text = f"Deviations from nominal / stated tolerances: {format_significant(found.factor, 2)} (rms){which}."
    action = "Widen these priors or check the model."
    said = Statement(text, _rate(found.factor), "Tolerances", value=found.factor, limit=1.0, action=action)
    return [said, *_state_held(study)]


def _state_outlier(name: str, pull: float, among: int) -> list[Statement]:
    """Say that a parameter, the farthest of so many, is too far from nominal by itself, while all together are not."""
    limit = float(stats.norm.isf(RARE_PULL / (2.0 * among)))
    if not abs(pull) > limit:
        return []
    text = f"{name} lies {format_significant(pull, 2)} times its tolerance from nominal, the others as expected."
    action = "Check this part, or widen its prior."
    return [Statement(text, "warning", "Tolerances", value=abs(pull), limit=limit, action=action)]


# --- bounds and coverage ---------------------------------------------------------------------------------------------


def _count_beyond(study: StudyResults) -> tuple[int, int, int]:
    """Return how many errors of the best variant's poses lie beyond their 95 % bounds, of how many, at how many poses.

    Of poses that were held back where there are any.
    """
    rows = study.table("pose_errors", study.best_name)
    rows = rows[rows["use"] == study.use]
    beyond, known = 0, 0
    for scale in study.error_scales:
        known += int(rows[scale.column].notna().sum())
        beyond += int((rows[scale.column] > rows[scale.bound]).sum())
    return beyond, known, len(rows)


def judge_bounds(beyond: int, total: int, n_poses: int) -> float:
    """Return the probability of as many or more, or as few or fewer where they are too few (binomial).

    Errors of a pose count as one trial together: its position and its orientation err alike.
    """
    if not total:
        return 1.0
    few, n = beyond < (1 - BOUND) * total, min(n_poses, total)
    share = beyond * n / total
    beyond = math.ceil(share) if few else math.floor(share)
    return float(stats.binomtest(beyond, n, 1 - BOUND, "less" if few else "greater").pvalue)


def _describe_bounds(study: StudyResults, beyond: int, total: int) -> str:
    """Return how many errors lie beyond their bounds, and how many are expected."""
    held = "held-back" if study.n_verification else "fitted"
    return (
        f"{beyond} of {total} errors of {held} poses exceed 95 % bounds; expected "
        f"{format_fixed((1 - BOUND) * total, 1)}."
    )


def _state_bounds(study: StudyResults) -> list[Statement]:
    """Return whether too few or too many errors of the best variant lie beyond their bounds.

    Of poses that were fitted too few say nothing: a posterior that has seen a pose lies nearer to it.
    """
    beyond, total, n_poses = _count_beyond(study)
    too_few = beyond < (1 - BOUND) * total
    if judge_bounds(beyond, total, n_poses) >= RARE_BOUND or (too_few and not study.n_verification):
        return []
    action = "Check noise and model."
    if too_few:
        action = "Check noise and common errors."
    text = _describe_bounds(study, beyond, total)
    level: Level = "warning" if too_few else "bad"
    return [Statement(text, level, "Bounds", value=beyond / total, limit=1.0 - BOUND, action=action)]


def state_coverage(study: StudyResults) -> list[Statement]:
    """Return how often 90 % predictive intervals and 95 % bounds hold the poses that an instrument saw."""
    fits = {name: fit for name in study.ranking if (fit := study.fit(name))["calibration"]}
    if not fits:
        return []
    coverage = {name: fit["calibration"]["interval_90_coverage"] for name, fit in fits.items()}
    narrow = [name for name, share in coverage.items() if is_too_narrow(share, study.count_seen(name, "calibration"))]
    span = " to ".join(dict.fromkeys(format_percent(x) for x in (min(coverage.values()), max(coverage.values()))))
    text = f"90 % intervals hold {span} of the measurements"
    text += f"; too narrow for {len(narrow)} of {len(fits)} variants." if narrow else "."
    level: Level = "warning" if narrow else "plain"
    found = [Statement(text, level, "Coverage", value=min(coverage.values()), limit=COVERAGE)]
    beyond, total, _ = _count_beyond(study)
    if total and not _state_bounds(study):
        text = _describe_bounds(study, beyond, total)
        found.append(Statement(text, lead="Coverage", value=beyond / total, limit=1.0 - BOUND))
    return found


def is_too_narrow(coverage: float, n_poses: int) -> bool:
    """Whether a coverage lies two standard errors below 90 %, counting a pose's six components as one trial."""
    return bool(coverage < COVERAGE - 2 * math.sqrt(COVERAGE * (1 - COVERAGE) / max(n_poses, 1)))


# --- convergence -----------------------------------------------------------------------------------------------------


def list_failures(study: StudyResults) -> list[Statement]:
    """Return everything that speaks against relying on the numbers, posterior by posterior."""
    failures = []
    for variant, fit in study.fits.items():
        problems = [one for one in fit["problems"].split("; ") if one]
        if not problems and measure_gap(fit) > AGREEMENT:
            problems = [f"log-evidences differ by {format_fixed(measure_gap(fit), 2)} nat, limit {AGREEMENT}"]
        if not problems and not fit["converged"]:
            problems = ["not converged"]
        failures += [Statement(f"{study.label(variant)}: {problem}", "bad") for problem in problems]
    return failures


def measure_gap(fit: Summary) -> float:
    """Return how far the two log-evidences of a posterior lie apart; not a number of a preliminary one."""
    return abs(float(fit["log_evidence_importance"] - fit["log_evidence_bridge"]))


def is_sound(fit: Summary) -> bool:
    """Whether a posterior passed its checks."""
    return bool(fit["converged"]) and not fit["problems"] and not measure_gap(fit) > AGREEMENT


def state_convergence(study: StudyResults) -> list[Statement]:
    """Return whether all posteriors passed their checks, and by what margin."""
    fits = study.fits.values()
    failed = sum(not is_sound(fit) for fit in fits)
    if failed:
        text = f"{failed} of {len(fits)} posteriors failed checks."
        return [Statement(text, "bad", "Checks", value=float(failed), limit=0.0)]
    if study.is_preliminary:
        text = "Preliminary: importance sampling, no chain."
        return [Statement(text, "warning", "Checks", action='Run with `effort = "standard"` in `[sampler]`.')]
    bulk = min(fit["ess_bulk_min"] for fit in fits)
    numbers = (
        (f"Largest R-hat, {len(fits)} posteriors", max(fit["rhat_max"] for fit in fits), RHAT_LIMIT, 4),
        ("Largest evidence difference", max(map(measure_gap, fits)), AGREEMENT, 3),
        ("Smallest bulk ESS", bulk, ESS_BULK_LIMIT, 0),
    )
    found = [
        Statement(
            f"{what}: {format_fixed(value, places)} (limit {limit:g}).", "good", "Checks", value=value, limit=limit
        )
        for what, value, limit, places in numbers
    ]
    if bulk < ESS_BULK_WANTED:
        text = f"Smallest bulk ESS: {format_fixed(bulk, 0)} (wanted {ESS_BULK_WANTED:g})."
        action = "Use more `steps` in `[sampler]`."
        found[-1] = Statement(text, "warning", "Checks", value=bulk, limit=ESS_BULK_WANTED, action=action)
    return found
