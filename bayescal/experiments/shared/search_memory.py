"""What the search for a posterior's mode, its hot loop and its sampling hold, for kinds of experiment with one."""

from __future__ import annotations

from collections.abc import Sequence

from bayescal.density.calibration.poses import MANY_ROWS
from bayescal.experiments.frame.memory import check_arrays
from bayescal.experiments.shared.trees import limit_draws
from bayescal.inference.schema import EvidenceConfig, SamplerConfig, count_walkers

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
    walkers = count_walkers(n_parameters, sampler.walkers)
    return [
        (CHAINS, sampler.ensembles, walkers, sampler.steps, n_parameters),
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


def list_saved(n_variants: int, n_poses: int, n_channels: int) -> list[Sequence[float]]:
    """Return the arrays that posteriors of readings leave until they are written; see `estimate_arrays`."""
    return [(n_variants, SAVED, _count_saved(n_poses, n_channels), n_poses, n_channels)]


def _count_saved(n_poses: int, n_channels: int) -> int:
    """Return how many draws of posterior and prior a file of readings keeps."""
    return limit_draws(KEPT_READINGS, n_poses * n_channels) + limit_draws(PRIOR_READINGS, n_poses * n_channels)


def check_readings(n_poses: int, n_channels: int, n_parameters: int, n_coordinates: int) -> None:
    """Raise InputError where there is no memory to look for so many poses by their readings."""
    held = list_readings(n_poses, n_channels, n_parameters, n_coordinates)
    check_arrays({"poses": n_poses, "parameters": n_parameters}, held, "fewer poses")
