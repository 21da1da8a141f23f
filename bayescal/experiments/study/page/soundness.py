"""Whether stated noise, tolerances and bounds fit the measurements: said first, with the likely cause.

Each is a test that may fail on either side; several are made, so that each has to be clear by itself.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

from bayescal.experiments.shared.chi_square import ChiSquare, format_chance
from bayescal.experiments.shared.judgement_page import rate, state_misfit, state_pulls
from bayescal.experiments.shared.slips import state_slip
from bayescal.experiments.study.page.results import NOISE, SETTINGS, StudyResults, get_number
from bayescal.experiments.study.page.variants import label_variant
from bayescal.report.blocks import Statement
from bayescal.report.numbers import format_fixed, format_percent, format_significant

REJECTED_SHARE = 0.01
"""Of targets that normal noise leaves alone, robust fits reject fewer."""
BOUND = 0.95
RARE_BOUND = 0.01
"""A coarser test than those of χ²: with few poses none beyond a bound is rarely out of the question."""
FAR = 2.5  # prior standard deviations of a single parameter that are named


def has_doubts(results: StudyResults) -> bool:
    """Whether something speaks against the stated noise, tolerances or bounds; tolerances too wide cost little."""
    return any(statement.level in ("warning", "bad") for statement in state_soundness(results))


def state_soundness(results: StudyResults) -> list[Statement]:
    """Return what contradicts the stated noise and tolerances; nothing where nothing does."""
    return [
        *state_slip(results.summary),
        *_state_target_noise(results),
        *_state_rejected(results),
        *_state_misfit(results),
        *_state_tolerances(results),
        *_state_bounds(results),
    ]


# --- noise -----------------------------------------------------------------------------------------------------------


def read_misfit(results: StudyResults, name: str) -> ChiSquare:
    """Return χ² of a variant at its mode, without model error where that was computed: of the stated noise alone."""
    setting = results.settings[-1]
    one = results.fit(name, setting)
    return ChiSquare(float(one["misfit_chi2"]), float(one["misfit_dof"]))


def find_noise_fault(results: StudyResults) -> ChiSquare | None:
    """Return the misfit of the best variant where it lies far from what the stated noise lets expect."""
    found = read_misfit(results, results.ranking[0])
    return found if found.is_off else None


def _state_target_noise(results: StudyResults) -> list[Statement]:
    """Say where targets scatter about their rigid bodies by another noise than stated."""
    extraction = results.summary.get("pose_extraction", {})
    per_dof, dof = get_number(extraction, "chi2_per_dof"), get_number(extraction, "dof")
    if not (math.isfinite(per_dof) and math.isfinite(dof)):
        return []
    found = ChiSquare(per_dof * dof, dof)
    if not found.is_off:
        return []
    size = "small" if found.factor > 1 else "large"
    text = (
        f"The targets scatter about their rigid bodies {format_significant(found.factor, 2)} times as much as the "
        f"stated noise (χ² per degree of freedom {format_significant(per_dof, 3)}, {format_chance(found.chance)}): "
        f"the target noise is stated too {size}, or targets moved on their bodies."
    )
    return [Statement(text, rate(found.factor), "Noise")]


def _state_rejected(results: StudyResults) -> list[Statement]:
    """Say where robust fits rejected more targets than normal noise explains."""
    extraction = results.summary.get("pose_extraction", {})
    total, rejected = get_number(extraction, "n_targets"), len(extraction.get("rejected_targets", []))
    if not total > 0 or rejected / total <= REJECTED_SHARE:
        return []
    text = (
        f"{rejected} of {format_fixed(total, 0)} measured targets ({format_percent(rejected / total, 1)}) were "
        "rejected as outliers: single blunders, or a target noise that is stated too small."
    )
    return [Statement(text, "bad" if rejected / total > 0.05 else "warning", "Noise")]


def _state_misfit(results: StudyResults) -> list[Statement]:
    """Say where the best variant's residuals are larger or smaller than the stated noise."""
    best, found = results.ranking[0], find_noise_fault(results)
    if found is None:
        return []
    too_small = "the noise is stated too small, or every variant lacks something real."
    if "zero" not in results.settings:
        return [state_misfit(label_variant(results, best), found, "", too_small)]
    too_small += " With model error τ the intervals are widened accordingly, without it they are too narrow."
    return [state_misfit(label_variant(results, best), found, " without model error", too_small)]


# --- tolerances ------------------------------------------------------------------------------------------------------


def read_pulls(results: StudyResults, name: str) -> ChiSquare:
    """Return χ² of how far a variant's machine lies from nominal along what was learnt, in units of the priors."""
    one = results.fit(name)
    return ChiSquare(float(one["pulls_chi2"]), float(one["pulls_dof"]))


def _state_tolerances(results: StudyResults) -> list[Statement]:
    """Say where the identified machine lies farther from nominal than the tolerances let expect, or much closer."""
    best = results.ranking[0]
    found, far = read_pulls(results, best), _describe_farthest(results, best)
    if not found.is_off:
        return []
    return [state_pulls(label_variant(results, best), found, far, _name_held(results, best))]


def _name_held(results: StudyResults, name: str) -> str:
    """Return which dimensions of a variant's model nothing frees: what is held as drawn, others err for."""
    held = results.summary.get("not_free", {}).get(name, [])
    if not held:
        return ""
    return f" Not free in this study: {', '.join(map(str, held))}. Give them tolerances and free them first."


def _describe_farthest(results: StudyResults, name: str) -> str:
    rows = [row for row in results.rows("parameters", name) if row["model_error"] == "free" and row["verdict"] != NOISE]
    pulls = {str(row["parameter"]): (row["mean"] - row["nominal"]) / row["prior_sd"] for row in rows}
    far = max(pulls, key=lambda key: abs(pulls[key]), default=None)
    if far is None or abs(pulls[far]) < FAR:
        return ""
    return f", farthest {far} by {format_significant(pulls[far], 2)}"


# --- bounds ----------------------------------------------------------------------------------------------------------


def choose_setting(results: StudyResults, name: str) -> str:
    """Return the setting of the model error that the evidence prefers: one that is not needed widens all bounds."""
    return max(("free", "zero"), key=lambda setting: results.fit(name, setting)["log_evidence"])


def count_beyond(results: StudyResults, name: str, setting: str) -> tuple[int, int]:
    """Return how many of the errors of unseen poses lie beyond their 95 % bounds, and of how many, both kinds.

    Calibration poses are left out for it: a posterior that has seen a pose fits it too well.
    """
    table = results.table("poses")
    chosen = table[(table["variant"] == name) & (table["model_error"] == setting)]
    pits = chosen[["position_pit", "orientation_pit"]].to_numpy(dtype=float).ravel()
    known = pits[np.isfinite(pits)]
    return int((known > BOUND).sum()), len(known)


def judge_bounds(beyond: int, total: int) -> float:
    """Return the probability of as many or more, or as few or fewer where they are too few (binomial)."""
    if not total:
        return 1.0
    few = beyond < (1 - BOUND) * total
    return float(stats.binomtest(beyond, total, 1 - BOUND, "less" if few else "greater").pvalue)


def describe_bounds(results: StudyResults, name: str, setting: str) -> str:
    """Return how many errors lie beyond their bounds, how many are expected, and with what probability."""
    beyond, total = count_beyond(results, name, setting)
    expected = format_fixed((1 - BOUND) * total, 1)
    chance = format_chance(judge_bounds(beyond, total))
    return (
        f"{SETTINGS[setting]}, {beyond} of {total} position and orientation errors of poses left out or held back lie "
        f"beyond their 95 % bounds, where {expected} are expected ({chance})"
    )


def _state_bounds(results: StudyResults) -> list[Statement]:
    """Say where too few or too many errors of the best variant lie beyond their bounds."""
    if not results.has("pose_errors"):
        return []
    best = results.ranking[0]
    setting = choose_setting(results, best)
    beyond, total = count_beyond(results, best, setting)
    if judge_bounds(beyond, total) >= RARE_BOUND:
        return []
    text = f"{label_variant(results, best)}: {describe_bounds(results, best, setting)}"
    if beyond < (1 - BOUND) * total:
        text += (
            ": the bounds are too wide, as from a noise stated too large, or from errors that poses share, as those "
            "of a measured K, where they count at each pose anew."
        )
        return [Statement(text, "warning", "Bounds")]
    text += ": the bounds claim too much, as from a noise stated too small or a model that lacks something real."
    return [Statement(text, "bad", "Bounds")]
