"""What to use, and how good it is: the headline of a study's page."""

from __future__ import annotations

from bayescal.experiments.shared.headline import say_choice, say_requirements, write_headline
from bayescal.experiments.study.page.checks import passes_with_model_error
from bayescal.experiments.study.page.results import StudyResults, get_number
from bayescal.experiments.study.page.soundness import has_doubts
from bayescal.experiments.study.page.variants import (
    choose_variant,
    label_model,
    label_variant,
    list_candidates,
    split_variant,
)
from bayescal.report.numbers import MICROMETRES, NOTHING, format_significant
from bayescal.report.variant_names import describe_deformation


def state_headline(results: StudyResults) -> str:
    """Return which variant to use and how large its errors are on poses that it has not seen."""
    if not passes_with_model_error(results):
        name = label_variant(results, results.ranking[0])
        return f"Use none yet: not everything converged (best so far: {name})."
    chosen = choose_variant(results)
    model, deformation = split_variant(results, chosen)
    name = label_variant(results, chosen)
    if model and chosen not in results.own_names:
        name = f"{label_model(results, model)} {describe_deformation(deformation)}"
    choice = say_choice(list_candidates(results, results.ranking), name, has_doubts(results))
    required = f"{say_requirements({})}; to judge them run an audit of this study"
    return write_headline([f"{choice}; {_state_accuracy(results)}", required])


def _state_accuracy(results: StudyResults) -> str:
    """Return the chosen variant's largest and mean error, and what the measurement itself may be."""
    use = "verification" if results.n_verification else "calibration"
    n = int(results.summary["n_poses"][use])
    fit, words = results.fit(choose_variant(results), "free"), "held-back" if results.n_verification else "fitted"
    largest, mean = (
        format_significant(MICROMETRES * get_number(fit[use]["position_error_mm"], key), 2) for key in ("max", "mean")
    )
    if largest == NOTHING:
        return f"no position was measured whole on its {n} {words} poses"
    noise = results.summary.get("measurement_noise_um", {}).get(use)
    measured = "" if noise is None else f"; the measurement's own noise is {format_significant(noise, 2)} µm rms"
    return f"largest error on {n} {words} pose{'s' if n != 1 else ''} {largest} µm, mean {mean} µm{measured}"
