"""Posterior draws by emcee: independent ensembles that mix jumps of a global proposal with differential evolution.

An ensemble's walkers depend on each other, so a walker is not a chain: the chains of every diagnostic are the
ensembles. The draws of an ensemble are ordered walker by walker, in time within a walker, so that autocorrelation seen
along the chain is that of the walkers.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayescal.errors import NumericalError
from bayescal.inference.importance import LogDensity, evaluate_in_batches
from bayescal.inference.proposal import MixtureProposal
from bayescal.numerics.geometry import Array

type Draw = Callable[[int, np.random.Generator], Array]

JUMP_SHARE = 0.7  # of moves


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Draws of one ensemble.

    Attributes
    ----------
    draws : ndarray, shape (walkers, steps, n)
        In sampling coordinates, after burn-in.
    log_density : ndarray, shape (walkers, steps)
    acceptance : float
        Share of accepted moves.
    """

    draws: Array
    log_density: Array
    acceptance: float


def run_ensemble(
    log_density: LogDensity,
    proposal: MixtureProposal,
    seed: np.random.SeedSequence,
    n_walkers: int,
    n_burn_in: int,
    n_steps: int,
    starts: Draw | None = None,
    jump_share: float = JUMP_SHARE,
) -> Ensemble:
    """Run one ensemble that starts at draws of the proposal, or at those of ``starts``.

    That share of the moves are jumps, the others differential evolution.

    Raises
    ------
    NumericalError
        Where walkers cannot be placed or the density is NaN.
    """
    import emcee  # a second to import, for those who sample

    seed_start, seed_moves = seed.spawn(2)
    start = _draw_start(log_density, starts or proposal.draw, np.random.default_rng(seed_start), n_walkers)
    state = emcee.State(start, random_state=np.random.RandomState(seed_moves.generate_state(8)).get_state())

    def jump(coordinates: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        drawn = proposal.draw(len(coordinates), np.random.default_rng(random.randint(2**32, size=4, dtype=np.uint64)))
        return drawn, proposal.log_density(coordinates) - proposal.log_density(drawn)

    moves = [(emcee.moves.MHMove(jump), jump_share), (emcee.moves.DEMove(), 1.0 - jump_share)]
    sampler = emcee.EnsembleSampler(n_walkers, start.shape[1], log_density, moves=moves, vectorize=True)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Initial state is not linearly independent")
        state = sampler.run_mcmc(state, n_burn_in, store=False) if n_burn_in else state
        sampler.reset()
        sampler.run_mcmc(state, n_steps)
    chain, density = sampler.get_chain(), sampler.get_log_prob()
    if not np.isfinite(density).all():
        raise NumericalError("sampling: a walker has a log-density that is not finite")
    acceptance = float(np.mean(sampler.acceptance_fraction))
    return Ensemble(np.swapaxes(chain, 0, 1), density.T, acceptance)


def _draw_start(log_density: LogDensity, draw: Draw, rng: np.random.Generator, n: int) -> Array:
    """Return n draws with finite density."""
    found: list[Array] = []
    for _ in range(50):
        draws = draw(n, rng)
        found.extend(draws[np.isfinite(evaluate_in_batches(log_density, draws))])
        if len(found) >= n:
            return np.stack(found[:n])
    raise NumericalError(f"sampling: only {len(found)} of {n} walkers found a start with finite density")
