"""Whether numbers may be relied on: stated noise, tolerances and bounds, convergence, coverage, with the likely cause.

Each is a test that may fail on either side; several are made, so that each has to be clear by itself.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

from scipy import stats

from bayescal.experiments.shared.slips import LARGE, state_denied, state_slip
from bayescal.experiments.shared.soundness import ChiSquare, format_chance
from bayescal.experiments.study.page.results import NOISE, StudyResults, get_number
from bayescal.experiments.study.page.solutions import state_solutions
from bayescal.limits import AGREEMENT, ESS_BULK_LIMIT, ESS_BULK_WANTED, RHAT_LIMIT
from bayescal.report.blocks import Level, Statement
from bayescal.report.numbers import format_fixed, format_percent, format_significant, join_words

SERIOUS = 1.5
"""Factor on stated noise or tolerances from which on it is bad."""
REJECTED_SHARE = 0.01
"""Of targets that normal noise leaves alone, robust fits reject fewer."""
COVERAGE, BOUND = 0.90, 0.95
"""What intervals and bounds should hold."""
RARE_BOUND = 0.01
"""A coarser test than those of χ²: with few poses none beyond a bound is rarely out of the question."""
FAR = 2.5  # prior standard deviations of a single parameter that are named
FEW = 3  # variants to name one by one
SIZES = "Size of errors"
CHECK_SIZES = "Find out what errs so much before relying on the parameters: machine, data, units, model."


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
        size = "small" if found.factor > 1 else "large"
        text = (
            f"The targets scatter about their rigid bodies {format_significant(found.factor, 2)} times as much as the "
            f"stated noise (χ² per degree of freedom {format_significant(per_dof, 3)}, {format_chance(found.chance)}): "
            f"the target noise is stated too {size}, or targets moved on their bodies."
        )
        statements.append(Statement(text, _rate(found.factor), "Noise"))
    total, rejected = get_number(extraction, "n_targets"), len(extraction.get("rejected_targets", []))
    if total > 0 and rejected / total > REJECTED_SHARE:
        text = (
            f"{rejected} of {format_fixed(total, 0)} measured targets ({format_percent(rejected / total, 1)}) were "
            "rejected as outliers: single outliers, or a target noise that is stated too small."
        )
        statements.append(Statement(text, "bad" if rejected / total > 0.05 else "warning", "Noise"))
    return statements


def _state_misfit(study: StudyResults) -> list[Statement]:
    """Say where the best variant's residuals are larger than the stated noise, and no noise or tolerance is named."""
    one = study.fit(study.best_name)
    found = ChiSquare(float(one["misfit_chi2"]), float(one["misfit_dof"]))
    if not found.is_off or study.summary.get("misstated"):
        return []
    why = "the noise is stated too small, or every variant lacks something real."
    if found.factor < 1:
        why = "the noise is stated too large, and all intervals are wider than they need be."
    error = " and its model error" if study.list_terms(study.best_name) else ""
    text = (
        f"{study.label(study.best_name)} leaves residuals {format_significant(found.factor, 2)} times as large as the "
        f"stated noise{error} (χ² per degree of freedom {format_significant(found.value / found.dof, 3)}, "
        f"{format_fixed(found.dof, 0)} degrees, {format_chance(found.chance)}): {why}"
    )
    return [Statement(text, _rate(found.factor), "Noise")]


# --- tolerances ------------------------------------------------------------------------------------------------------


def _state_misstated(study: StudyResults) -> list[Statement]:
    """Say which noise or tolerance the data explain better by another size, or how large the errors are they need."""
    found = study.summary.get("misstated")
    if not isinstance(found, dict):
        return []
    text = f"{found['text'][0].upper()}{found['text'][1:]}"
    if found["fault"] == LARGE:
        return [Statement(f"{CHECK_SIZES} {text}.", "warning", SIZES)]
    if found["fault"] == "scatter":
        return [Statement(f"{text}. Make sure of the stated noise first.", "warning", "Noise")]
    gain = format_significant(found["gain"], 2)
    text += f". Data are explained better by {gain} nats then, whatever the sizes of the model error."
    if found["fault"] == "noise":
        return [Statement(text, _rate(found["factor"]), "Noise")]
    wide = found["fault"] != "tolerance"  # costs accuracy, and is no fault
    return [Statement(f"{text}{'' if wide else _say_held(study)}", "plain" if wide else "bad", "Tolerances")]


def say_misstated(study: StudyResults, faults: Collection[str] = (LARGE, "noise", "tolerance")) -> str:
    """Return for the headline which noise or tolerance is stated too small, or that errors are far beyond that.

    Empty where it is none of the faults, and where what is stated costs accuracy alone.
    """
    found = study.summary.get("misstated")
    if not isinstance(found, dict) or found["fault"] not in faults or found["factor"] < 1.0:
        return ""
    return str(found["text"]).partition(" (")[0]


def _say_held(study: StudyResults) -> str:
    """Return which dimensions are not free, for which others err."""
    held = study.summary.get("not_free", {}).get(study.best_name, [])
    names = ", ".join(map(str, held))
    return f" Not free in this study: {names}. Give them tolerances and free them first." if held else ""


def _state_tolerances(study: StudyResults) -> list[Statement]:
    """Say where the identified machine lies farther from nominal than the tolerances let expect, and none is named.

    χ² is of how far it lies from nominal along what was learnt, in units of the priors. That it lies nearer says
    nothing by itself: errors that the model leaves out may hide a machine, and tolerances too tight bind it.
    """
    best, fit = study.best_name, study.fit(study.best_name)
    found = ChiSquare(float(fit["pulls_chi2"]), float(fit["pulls_dof"]))
    if not found.is_off or found.factor <= 1.0 or study.summary.get("misstated"):
        return []
    rows = [row for row in study.rows("parameters", best) if row["verdict"] != NOISE]
    pulls = {str(row["parameter"]): (row["mean"] - row["nominal"]) / row["prior_sd"] for row in rows}
    far = max(pulls, key=lambda key: abs(pulls[key]), default=None)
    text = (
        f"{study.label(best)}: deviations from nominal are {format_significant(found.factor, 2)} times the stated "
        f"tolerances (rms over the {format_fixed(found.dof, 0)} directions that the data determine)"
    )
    if far is not None and abs(pulls[far]) >= FAR:
        text += f", farthest {far} by {format_significant(pulls[far], 2)}"
    text += f" ({format_chance(found.chance)}): "
    text += "the tolerances are stated too tight, a nominal value is wrong, or the model makes up for what it lacks."
    return [Statement(f"{text}{_say_held(study)}", _rate(found.factor), "Tolerances")]


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


def _describe_bounds(study: StudyResults, beyond: int, total: int, n_poses: int) -> str:
    """Return how many errors lie beyond their bounds, how many are expected, and with what probability."""
    held = "held back" if study.n_verification else "that were fitted"
    kinds = join_words([scale.what for scale in study.error_scales])
    return (
        f"{study.label(study.best_name)}: {beyond} of {total} {kinds} errors of poses {held} lie "
        f"beyond their 95 % bounds, where {format_fixed((1 - BOUND) * total, 1)} are expected "
        f"({format_chance(judge_bounds(beyond, total, n_poses))})"
    )


def _state_bounds(study: StudyResults) -> list[Statement]:
    """Say where too few or too many errors of the best variant lie beyond their bounds.

    Of poses that were fitted too few say nothing: a posterior that has seen a pose lies nearer to it.
    """
    beyond, total, n_poses = _count_beyond(study)
    too_few = beyond < (1 - BOUND) * total
    if judge_bounds(beyond, total, n_poses) >= RARE_BOUND or (too_few and not study.n_verification):
        return []
    text = _describe_bounds(study, beyond, total, n_poses)
    if too_few:
        text += (
            ": the bounds are too wide, as from a noise stated too large, or from errors that poses share, as those "
            "of a measured K, where they count at each pose anew."
        )
        return [Statement(text, "warning", "Bounds")]
    text += ": the bounds claim too much, as from a noise stated too small or a model that lacks something real."
    return [Statement(text, "bad", "Bounds")]


def state_coverage(study: StudyResults) -> list[Statement]:
    """Say how often 90 % predictive intervals and 95 % bounds hold the poses that an instrument saw."""
    fits = {name: fit for name in study.ranking if (fit := study.fit(name))["calibration"]}
    if not fits:
        return []
    coverage = {name: fit["calibration"]["interval_90_coverage"] for name, fit in fits.items()}
    narrow = [name for name, share in coverage.items() if is_too_narrow(share, study.count_seen(name, "calibration"))]
    span = " to ".join(dict.fromkeys(format_percent(x) for x in (min(coverage.values()), max(coverage.values()))))
    text = f"The 90 % predictive intervals hold {span} of the calibration measurements"
    if narrow:
        shares = [f"{study.label(name)} ({_cover_both(fits[name])})" for name in narrow]
        text += f": intervals too narrow for {name_or_count(shares, len(coverage))}"
    statements = [Statement(f"{text}.", "warning" if narrow else "plain", "Coverage")]
    counts = _count_beyond(study)
    if counts[1] and not _state_bounds(study):
        statements.append(Statement(f"{_describe_bounds(study, *counts)}.", lead="Coverage"))
    return statements


def _cover_both(fit: Mapping[str, Any]) -> str:
    text = format_percent(fit["calibration"]["interval_90_coverage"])
    if fit.get("verification"):
        text += f", verification {format_percent(fit['verification']['interval_90_coverage'])}"
    return text


def is_too_narrow(coverage: float, n_poses: int) -> bool:
    """Whether a coverage lies two standard errors below 90 %, counting a pose's six components as one trial."""
    return bool(coverage < COVERAGE - 2 * math.sqrt(COVERAGE * (1 - COVERAGE) / max(n_poses, 1)))


def name_or_count(words: list[str], total: int) -> str:
    """Return a few variants by name, many as a count."""
    return join_words(words) if len(words) <= FEW else f"{len(words)} of {total} variants (tables below)"


# --- convergence -----------------------------------------------------------------------------------------------------


def list_failures(study: StudyResults) -> list[Statement]:
    """Return everything that speaks against relying on the numbers, posterior by posterior."""
    failures = []
    for variant, fit in study.fits.items():
        problems = [one for one in fit["problems"].split("; ") if one]
        if not problems and measure_gap(fit) > AGREEMENT:
            problems = [f"the two log-evidences differ by {format_fixed(measure_gap(fit), 2)} nat, limit {AGREEMENT}"]
        if not problems and not fit["converged"]:
            problems = ["not converged"]
        failures += [Statement(f"{study.label(variant)}: {problem}", "bad") for problem in problems]
    return failures


def measure_gap(fit: Mapping[str, Any]) -> float:
    """Return how far the two log-evidences of a posterior lie apart."""
    return abs(float(fit["log_evidence_importance"] - fit["log_evidence_bridge"]))


def state_convergence(study: StudyResults) -> list[Statement]:
    """Say whether all posteriors passed their checks, and by what margin."""
    fits = study.fits.values()
    failed = sum(not fit["converged"] or bool(fit["problems"]) or not measure_gap(fit) <= AGREEMENT for fit in fits)
    if failed:
        text = f"{failed} of {len(fits)} posteriors did not pass their checks (listed above)."
        return [Statement(text, "bad", "Checks")]
    gap = max(measure_gap(fit) for fit in fits)
    rhat = max(fit["rhat_max"] for fit in fits)
    bulk = min(fit["ess_bulk_min"] for fit in fits)
    text = (
        f"All {len(fits)} posteriors converged: R-hat at most {format_fixed(rhat, 4)} (limit {RHAT_LIMIT}), bulk ESS "
        f"at least {format_fixed(bulk, 0)} (limit {format_fixed(ESS_BULK_LIMIT, 0)}). Both evidence estimators agree "
        f"to {format_fixed(gap, 3)} nat or better (limit {AGREEMENT})."
    )
    if bulk < ESS_BULK_WANTED:
        rough = f"Means are known to {format_significant(100.0 / math.sqrt(bulk), 2)} % of a standard deviation; more"
        return [Statement(f"{text} {rough} steps of [sampler] make them surer.", "warning", "Checks")]
    if has_warnings(study):
        caveat = "That follows from what was stated of noise and tolerances; what speaks against it is said above."
        return [Statement(f"{text} {caveat}", "plain", "Checks")]
    return [Statement(text, "good", "Checks")]
