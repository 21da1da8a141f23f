"""What calibrations of any machine will hold at once, and what is made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.shared.readings.inputs import ReadingInputs, Variant
from bayescal.experiments.shared.search_memory import list_readings, list_sampling, list_saved


def list_variant(variant: Variant) -> list[Sequence[float]]:
    """Return the arrays of a variant's posterior; see `estimate_arrays`."""
    n_poses, n_coordinates = variant.start.shape
    return list_readings(n_poses, len(variant.model.channels), len(variant.priors), n_coordinates)


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
