"""What the search for a posterior's mode, its hot loop and its sampling hold, for kinds of experiment with one."""

from __future__ import annotations

from collections.abc import Sequence

from bayescal.density.calibration.poses import MANY_ROWS
from bayescal.density.functions import FunctionLikelihood, list_arrays
from bayescal.density.legs import BATCH, POSES, LegPosterior, Likelihood
from bayescal.experiments.frame.memory import Need, check_arrays, estimate_arrays
from bayescal.experiments.shared.trees import PRIOR_DRAWS, SAVED_DRAWS, limit_draws
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
KEPT_DRAWS = 1920
"""Of each ensemble of a posterior of poses, for everything after the diagnostics."""
DEPENDENT_DRAWS = 250
"""The same where poses depend on each other, whose densities given the others take long."""
POSE_NUMBERS = 6
SINGLE = 0.5  # numbers of four bytes, in doubles
COPIES = 3
"""Of what is saved of poses: as it is computed, as a record, as it is written."""
ARRAYS, OF_POSES = 40, 28
"""Of the hot loop of an instrument's readings, components of vectors counted one by one, and of poses', as measured."""


def list_search(posterior: LegPosterior) -> list[Sequence[float]]:
    """Return the arrays of a posterior's derivatives and hot loop; see `estimate_arrays`."""
    likelihood = posterior.likelihood
    rows = likelihood.n_poses * likelihood.n_legs
    hot = ARRAYS if likelihood.of_poses is None else OF_POSES
    dependent = isinstance(likelihood, FunctionLikelihood)
    return [
        (DERIVATIVES, rows, posterior.n_parameters + likelihood.n_legs),
        (hot, BATCH, min(rows, POSES * likelihood.n_legs)),
        *(list_arrays(likelihood.n_poses, likelihood.n_legs) if dependent else []),
    ]


def choose_kept(likelihood: Likelihood, n_ensembles: int, n_poses: int) -> int:
    """Return how many draws of each ensemble are kept of a posterior of poses, fewer where these are very many."""
    wanted = DEPENDENT_DRAWS if isinstance(likelihood, FunctionLikelihood) else KEPT_DRAWS
    return limit_draws(wanted, n_ensembles * n_poses)


def estimate_legs(
    posterior: LegPosterior, sampler: SamplerConfig, effort: EvidenceConfig, n_poses: int, n_fits: int
) -> Need:
    """Return what so many posteriors like one take, with what they predict of so many poses."""
    n = posterior.n_parameters
    steps = sampler.steps * count_walkers(n, sampler.walkers)
    kept = sampler.ensembles * min(choose_kept(posterior.likelihood, sampler.ensembles, n_poses), steps)
    numbers = POSE_NUMBERS * n_poses
    made = min(kept, limit_draws(SAVED_DRAWS, numbers)) * numbers
    prior = limit_draws(PRIOR_DRAWS, numbers) * numbers
    one = [(n_poses, kept), (SINGLE, made + prior)]
    return estimate_arrays(
        {"poses": n_poses, "parameters": n, "posteriors": n_fits},
        [*((COPIES, *size) for size in one), *list_search(posterior), *list_sampling(sampler, effort, n)],
        "fewer poses or variants",
        kept=[(n_fits + COPIES, *size) for size in one],
    )


def list_sampling(sampler: SamplerConfig, effort: EvidenceConfig, n_parameters: int) -> list[Sequence[float]]:
    """Return the arrays of a posterior's ensembles and of its draws for the evidence; see `estimate_arrays`."""
    walkers = count_walkers(n_parameters, sampler.walkers)
    return [
        (CHAINS, sampler.ensembles, walkers, sampler.steps, n_parameters),
        (PROPOSED, effort.draws, n_parameters),
        (WEIGHTS, effort.max_draws),
    ]


def list_readings(n_poses: int, n_channels: int, n_parameters: int, n_coordinates: int) -> list[Sequence[float]]:
    """Return the arrays of a posterior of readings: derivatives, hot loop, draws that are kept; as `list_search`."""
    width = n_parameters + n_coordinates + n_channels
    return [
        (DERIVATIVES, n_poses, n_channels, width),
        (DERIVATIVES, min(VECTORS, max(1, MANY_ROWS // n_poses)), n_poses, n_channels, 1 + n_coordinates),
        (DRAWN, _count_saved(n_poses, n_channels), n_poses, n_channels),
        (DENSITIES, KEPT_READINGS, n_poses),
    ]


def list_saved(n_variants: int, n_poses: int, n_channels: int) -> list[Sequence[float]]:
    """Return the arrays that posteriors of readings leave until they are written; as `list_search`."""
    return [(n_variants, SAVED, _count_saved(n_poses, n_channels), n_poses, n_channels)]


def _count_saved(n_poses: int, n_channels: int) -> int:
    """Return how many draws of posterior and prior a file of readings keeps."""
    return limit_draws(KEPT_READINGS, n_poses * n_channels) + limit_draws(PRIOR_READINGS, n_poses * n_channels)


def check_poses(n_poses: int, n_legs: int, n_parameters: int) -> None:
    """Raise InputError where there is no memory for the derivatives at so many measured poses.

    Building a density of poses takes them already.
    """
    held = [(DERIVATIVES, n_poses * n_legs, n_parameters + n_legs)]
    check_arrays({"poses": n_poses, "parameters": n_parameters}, held, "fewer poses")


def check_readings(n_poses: int, n_channels: int, n_parameters: int, n_coordinates: int) -> None:
    """Raise InputError where there is no memory to look for so many poses by their readings."""
    held = list_readings(n_poses, n_channels, n_parameters, n_coordinates)
    check_arrays({"poses": n_poses, "parameters": n_parameters}, held, "fewer poses")
