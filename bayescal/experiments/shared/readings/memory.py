"""What calibrations of any machine will hold at once, and what is made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayescal.density.calibration.model_error import FunctionsOfPose, ThinFunctionsOfPose
from bayescal.density.components import AT_ONCE
from bayescal.density.few_columns import list_gram_arrays
from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.shared.readings.inputs import ReadingInputs, Variant
from bayescal.experiments.shared.search_memory import list_readings, list_sampling, list_saved

WHOLE, TOGETHER, ACTED = 4, 6, 3
"""Covariances of all readings, batches of those of all equations, and what coefficients do to all readings, at once."""


def list_variant(variant: Variant) -> list[Sequence[float]]:
    """Return the arrays of a variant's posterior; see `estimate_arrays`."""
    (n_poses, n_coordinates), n_channels = variant.start.shape, len(variant.model.channels)
    return [
        *list_readings(n_poses, n_channels, len(variant.priors), n_coordinates),
        *_list_functions(variant, n_poses * n_channels, n_poses * (n_channels - n_coordinates)),
    ]


def _list_functions(variant: Variant, n_readings: int, n_equations: int) -> list[Sequence[float]]:
    """Return the arrays of errors that are functions of the pose."""
    terms = [one for one in variant.errors.terms if isinstance(one, FunctionsOfPose)]
    n_columns = sum(one.most_columns for one in terms)
    if not terms:
        return []
    if any(isinstance(one, ThinFunctionsOfPose) for one in terms):
        n = terms[0].own.readings.shape[1]
        return [
            (ACTED, n_readings, n_columns),
            (1, n_equations, n_columns / n),
            *list_gram_arrays(n_equations, n_columns),
        ]
    return [
        (len(terms), n_equations, n_equations),
        (WHOLE, n_readings, n_readings),
        (TOGETHER, max(AT_ONCE, n_equations**2)),
        (ACTED, n_readings, n_columns),
    ]


def find_largest(variants: Mapping[str, Variant]) -> Variant:
    """Return the variant with most poses by parameters."""
    return max(variants.values(), key=lambda one: len(one.start) * len(one.priors))


def estimate_calibration(inputs: ReadingInputs) -> Need:
    """Return what a calibration needs."""
    largest, config = find_largest(inputs.variants), inputs.config
    n_poses, n_parameters, held = len(largest.start), len(largest.priors), list_variant(largest)
    return estimate_arrays(
        {"poses": n_poses, "parameters": n_parameters, "variants": len(inputs.variants)},
        [*held, *list_sampling(config.sampler, config.evidence, n_parameters)],
        "fewer poses or variants",
        kept=list_saved(len(inputs.variants), n_poses, len(largest.model.channels)),
    )
