"""What to use, and how good it is: the headline of a study's page."""

from __future__ import annotations

from bayescal.experiments.study.page.checks import passes_with_model_error
from bayescal.experiments.study.page.results import StudyResults, get_number
from bayescal.experiments.study.page.soundness import has_doubts
from bayescal.experiments.study.page.variants import (
    choose_variant,
    find_leaders,
    label_model,
    label_variant,
    split_variant,
)
from bayescal.report.numbers import MICROMETRES, NOTHING, format_significant
from bayescal.report.variant_names import describe_deformation

NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
REQUIREMENTS = "Accuracy requirements: not stated; an audit of this study judges them."


def state_headline(results: StudyResults) -> str:
    """Return which variant to use and how large its errors are on poses that it has not seen."""
    accuracy = _state_accuracy(results)
    if not passes_with_model_error(results):
        name = label_variant(results, results.ranking[0])
        return f"Use none yet: not everything converged (best so far: {name})."
    return f"Use {_name_choice(results)}; {accuracy}. {REQUIREMENTS}"


def _name_choice(results: StudyResults) -> str:
    """Return the variant to use, why this one, and whether something speaks against the assumptions."""
    chosen, leaders = choose_variant(results), find_leaders(results)
    model, deformation = split_variant(results, chosen)
    name = label_variant(results, chosen)
    if model and chosen not in results.own_names:
        name = f"{label_model(results, model)} {describe_deformation(deformation)}"
    if len(results.ranking) == 1:
        name += ", the only variant"
    elif len(leaders) > 1:
        name += f", the simplest of {_count(len(leaders))} equals"
    return f"{name}, with care (see the warnings)" if has_doubts(results) else name


def _count(number: int) -> str:
    return NUMBERS[number] if number < len(NUMBERS) else str(number)


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
