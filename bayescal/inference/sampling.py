"""Draws of an explored posterior by independent ensembles, in all coordinates that somebody needs, with diagnostics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.inference.diagnostics import Diagnostics, diagnose
from bayescal.inference.ensemble import JUMP_SHARE, run_ensembles
from bayescal.inference.exploration import GOOD_ENOUGH, Exploration, count_walkers
from bayescal.numerics.geometry import Array

GOOD_JUMP_SHARE = 0.9  # of moves, by a proposal that is good enough: then they move walkers farther than others


@dataclass(frozen=True, eq=False)
class Sample:
    """Draws of E ensembles of W walkers in S steps, of n parameters.

    Attributes
    ----------
    straight, y, natural : ndarray, shape (E, W, S, n)
        In the proposal's coordinates, in sampling coordinates, in natural units.
    log_density : ndarray, shape (E, W, S)
        In the proposal's coordinates.
    acceptance : ndarray, shape (E,)
    """

    straight: Array
    y: Array
    natural: Array
    log_density: Array
    acceptance: Array

    @cached_property
    def diagnostics(self) -> Diagnostics:
        """Of the natural units."""
        return diagnose(self.natural)


def sample_posterior(
    exploration: Exploration,
    seed: np.random.SeedSequence,
    n_ensembles: int,
    n_walkers: int,
    n_burn_in: int,
    n_steps: int,
) -> Sample:
    """Return draws from ensembles that start at the exploration's proposal; a seed of its own for each."""
    straight = exploration.straight
    posterior = straight.posterior
    walkers = count_walkers(posterior.n_parameters, n_walkers)
    share = GOOD_JUMP_SHARE if exploration.efficiency >= GOOD_ENOUGH else JUMP_SHARE
    seeds = seed.spawn(n_ensembles)
    density, proposal = straight.log_density, exploration.proposal
    ensembles = run_ensembles(density, proposal, seeds, walkers, n_burn_in, n_steps, jump_share=share)
    draws = np.stack([ensemble.draws for ensemble in ensembles])
    y = straight.y_from_x(draws.reshape(-1, posterior.n_parameters)).reshape(draws.shape)
    natural = posterior.natural(y)
    log_density = np.stack([ensemble.log_density for ensemble in ensembles])
    acceptance = np.array([ensemble.acceptance for ensemble in ensembles])
    return Sample(draws, y, natural, log_density, acceptance)
