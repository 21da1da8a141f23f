"""Simulation-based calibration of one data set: where the truth lies among the draws of its posterior.

Of truths drawn from the priors (Talts et al. 2018) the rank is uniform if everything between priors and intervals is
right. Of truths drawn from the posterior of the measured data, with measured and simulated data fitted together
(Säilynoja et al. 2025), it is uniform where it matters: near the machine that was measured.
"""

from __future__ import annotations

import time
import zlib

import numpy as np

from bayescal.errors import NumericalError
from bayescal.experiments.check.subject import Subject
from bayescal.experiments.shared.measured import Found
from bayescal.inference.exploration import Exploration, explore
from bayescal.inference.importance import resample
from bayescal.inference.sampling import sample_posterior
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

PRIOR, POSTERIOR = "prior", "posterior"
KEPT = 1000
ENSEMBLES, WALKERS, BURN_IN, STEPS = 4, 64, 30, 30  # where importance resampling will not do

type Arrays = dict[str, Array]
type Shared = tuple[Subject, Array, Array, int, int]
"""Subject, draws of its posterior (S, n), natural and in coordinates, draws to be made of each data set's, seed."""


def draw_posterior(
    posterior: Found, n_draws: int, seed: np.random.SeedSequence
) -> tuple[Array, Array, Exploration, Array]:
    """Return draws (S, n), natural and in coordinates, the exploration, and their weights' efficiency and Pareto k.

    Draws of the proposal resampled by their weights; of an ensemble where their tail forbids it.
    """
    explore_seed, draw_seed, ensemble_seed = seed.spawn(3)
    found = explore(posterior, explore_seed)
    straight = found.straight
    made = resample(straight.log_density, found.proposal, np.random.default_rng(draw_seed), n_draws, KEPT)
    quality = np.array([made.efficiency, made.pareto_k])
    if made.pareto_k > PARETO_K_LIMIT:
        sample = sample_posterior(found, ensemble_seed, ENSEMBLES, WALKERS, BURN_IN, STEPS)
        n = posterior.n_parameters
        return sample.natural.reshape(-1, n), sample.y.reshape(-1, n), found, quality
    y = straight.y_from_x(made.draws)
    return posterior.natural(y), y, found, quality


def rank_truth(shared: Shared, name: str) -> Arrays:
    """Return the ranks of a data set's truth, shape (n,), in shares; its name says whence and which.

    Without ranks where no posterior is found.
    """
    began = time.perf_counter()
    try:
        found = _rank(shared, name)
    except (NumericalError, np.linalg.LinAlgError):
        found = {}
    return {**found, "wall_seconds": np.array(time.perf_counter() - began)}


def _rank(shared: Shared, name: str) -> Arrays:
    subject, draws, coordinates, n_draws, seed = shared
    whence, _, number = name.partition(" ")
    simulate_seed, draw_seed, tie_seed = np.random.SeedSequence([seed, zlib.crc32(name.encode())]).spawn(3)
    rng = np.random.default_rng(simulate_seed)
    if whence == PRIOR:
        truth, posterior = subject.draw_case(rng)
    else:
        k = int(number) % len(draws)
        truth, posterior = draws[k], subject.repeat(coordinates[k], rng)
    found, _, _, quality = draw_posterior(posterior, n_draws, draw_seed)
    ties = np.random.default_rng(tie_seed).random(len(truth))
    below = np.sum(found < truth, axis=0)
    return {
        "rank": (below + ties) / (len(found) + 1.0),
        "z": (found.mean(axis=0) - truth) / found.std(axis=0),
        "quality": quality,
    }
