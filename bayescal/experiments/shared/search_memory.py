"""What the search for a posterior's mode, its hot loop and its sampling hold, for kinds of experiment with one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from bayescal.density.calibration.model_error import GPTerm, LowRankGPTerm
from bayescal.density.calibration.poses import MANY_ROWS
from bayescal.density.components import AT_ONCE
from bayescal.density.low_rank_covariance import list_gram_arrays
from bayescal.experiments.runner.memory import MemoryEstimate, check_arrays, estimate_arrays
from bayescal.experiments.shared.posterior_files import limit_draws
from bayescal.inference.schema import EvidenceConfig, SamplerConfig, count_walkers

if TYPE_CHECKING:
    from bayescal.experiments.shared.readings.inputs import ReadingInputs, Variant

DERIVATIVES = 8
"""Arrays of all rows by all parameters in a mode search."""
CHAINS, PROPOSED, WEIGHTS = 4, 6, 4
"""Arrays of all chains, of draws of a proposal, and of their weights."""
VECTORS = 64  # of readings' hot loop at a time
DRAWN, DENSITIES, SAVED = 4, 4, 1
"""Arrays of what draws of posterior and prior read, and of the rows' densities by draws, while they are made; and what
stays of the former: readings in single precision."""
KEPT_READINGS, PRIOR_READINGS = 1000, 300
"""Of a posterior of readings, all ensembles together, and of its prior."""


def list_sampling(sampler: SamplerConfig, effort: EvidenceConfig, n_parameters: int) -> list[Sequence[float]]:
    """Return the arrays of a posterior's ensembles and of its draws for the evidence; see `estimate_arrays`."""
    walkers, effort = count_walkers(n_parameters, sampler.walkers), effort.follow(sampler.effort)
    return [
        (CHAINS, sampler.ensembles, walkers, sampler.most_steps, n_parameters),
        (PROPOSED, effort.draws, n_parameters),
        (WEIGHTS, effort.max_draws),
    ]


def list_readings(n_poses: int, n_channels: int, n_parameters: int, n_coordinates: int) -> list[Sequence[float]]:
    """Return the arrays of a posterior: derivatives, hot loop, draws that are kept; see `estimate_arrays`."""
    width = n_parameters + n_coordinates + n_channels
    return [
        (DERIVATIVES, n_poses, n_channels, width),
        (DERIVATIVES, min(VECTORS, max(1, MANY_ROWS // n_poses)), n_poses, n_channels, 1 + n_coordinates),
        (DRAWN, _count_saved(n_poses, n_channels), n_poses, n_channels),
        (DENSITIES, KEPT_READINGS, n_poses),
    ]


def _count_saved(n_poses: int, n_channels: int) -> int:
    """Return how many draws of posterior and prior a file of readings keeps."""
    return limit_draws(KEPT_READINGS, n_poses * n_channels) + limit_draws(PRIOR_READINGS, n_poses * n_channels)


def check_readings(n_poses: int, n_channels: int, n_parameters: int, n_coordinates: int) -> None:
    """Raise InputError where there is no memory to look for so many poses by their readings."""
    held = list_readings(n_poses, n_channels, n_parameters, n_coordinates)
    check_arrays({"poses": n_poses, "parameters": n_parameters}, held, "fewer poses")


# --- of a calibration's variants ------------------------------------------------------------------------------------

WHOLE, BATCH, ACTED = 4, 6, 3
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
    terms = variant.errors.terms_of(GPTerm)
    n_columns = sum(one.most_columns for one in terms)
    if not terms:
        return []
    if variant.errors.terms_of(LowRankGPTerm):
        n = len(terms[0].own.places)
        return [
            (ACTED, n_readings, n_columns),
            (1, n_equations, n_columns / n),
            *list_gram_arrays(n_equations, n_columns),
        ]
    return [
        (len(terms), n_equations, n_equations),
        (WHOLE, n_readings, n_readings),
        (BATCH, max(AT_ONCE, n_equations**2)),
        (ACTED, n_readings, n_columns),
    ]


def find_largest(variants: Mapping[str, Variant]) -> Variant:
    """Return the variant with most poses by parameters."""
    return max(variants.values(), key=lambda one: len(one.start) * len(one.priors))


def estimate_calibration(inputs: ReadingInputs) -> MemoryEstimate:
    """Return what a calibration needs."""
    largest, config = find_largest(inputs.variants), inputs.config
    n_poses, n_parameters, n_channels = len(largest.start), len(largest.priors), len(largest.model.channels)
    return estimate_arrays(
        {"poses": n_poses, "parameters": n_parameters, "variants": len(inputs.variants)},
        [*list_variant(largest), *list_sampling(config.sampler, config.evidence, n_parameters)],
        "fewer poses or variants",
        kept=[(len(inputs.variants), SAVED, _count_saved(n_poses, n_channels), n_poses, n_channels)],
    )
