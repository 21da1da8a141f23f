"""Draws of an explored posterior by independent ensembles, in all coordinates that somebody needs, with diagnostics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.inference.diagnostics import Diagnostics, diagnose
from bayescal.inference.ensemble import JUMP_SHARE, Draw, Ensemble, run_ensembles
from bayescal.inference.exploration import GOOD_ENOUGH, Exploration
from bayescal.inference.importance import resample
from bayescal.inference.reparameterisation import Reparameterisation
from bayescal.inference.schema import count_walkers
from bayescal.inference.stages import stage
from bayescal.numerics.geometry import Array

GOOD_JUMP_SHARE = 0.9  # of moves, by a proposal that is good enough: then they move walkers farther than others


@dataclass(frozen=True, eq=False)
class Sample:
    """Draws of E ensembles of W walkers in S steps, of n parameters; in other coordinates when these are asked for."""

    straightening: Reparameterisation  # to the proposal's coordinates
    straight: Array  # (E, W, S, n): in the proposal's coordinates
    log_density: Array  # (E, W, S): in the proposal's coordinates
    acceptance: Array  # (E,)

    @classmethod
    def from_ensembles(cls, straightening: Reparameterisation, ensembles: Sequence[Ensemble]) -> Sample:
        """Return the draws of several ensembles."""
        draws = np.stack([ensemble.draws for ensemble in ensembles])
        log_density = np.stack([ensemble.log_density for ensemble in ensembles])
        return cls(straightening, draws, log_density, np.array([ensemble.acceptance for ensemble in ensembles]))

    @cached_property
    def y(self) -> Array:
        """In sampling coordinates, shape (E, W, S, n)."""
        flat = self.straight.reshape(-1, self.straight.shape[-1])
        return self.straightening.y_from_x(flat).reshape(self.straight.shape)

    @cached_property
    def natural(self) -> Array:
        """In natural units, shape (E, W, S, n)."""
        return self.straightening.posterior.natural(self.y)

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
    walkers = count_walkers(straight.posterior.n_parameters, n_walkers)
    share = GOOD_JUMP_SHARE if exploration.efficiency >= GOOD_ENOUGH else JUMP_SHARE
    seeds = seed.spawn(n_ensembles)
    density, proposal = straight.log_density, exploration.proposal
    with stage("sampling", n_ensembles * walkers * (1 + n_burn_in + n_steps)):
        ensembles = run_ensembles(density, proposal, seeds, walkers, n_burn_in, n_steps, jump_share=share)
    return Sample.from_ensembles(straight, ensembles)


def draw_by_importance(
    exploration: Exploration, seed: np.random.SeedSequence, n_runs: int, n_proposed: int, n_drawn: int
) -> Sample:
    """Return independent draws by the weights of the proposal's, in runs that have no step in common.

    Each of n_runs runs takes so many draws out of so many proposed, and lays them out as walkers.

    Raises
    ------
    NumericalError
        Where no proposed draw has a finite density.
    """
    straight, n = exploration.straight, exploration.straight.posterior.n_parameters
    n_walkers = count_walkers(n, 0)
    shape = (n_runs, n_walkers, max(2, n_drawn // n_walkers))
    each = shape[1] * shape[2]
    x = np.concatenate(
        [
            resample(straight.log_density, exploration.proposal, np.random.default_rng(one), n_proposed, each).draws
            for one in seed.spawn(n_runs)
        ]
    )
    return Sample(straight, x.reshape(*shape, n), straight.log_density(x).reshape(shape), np.ones(n_runs))


def continue_sample(exploration: Exploration, sample: Sample, seed: np.random.SeedSequence) -> Sample:
    """Return a sample whose ensembles have gone on from where they stood, for as many steps as they had."""
    n_ensembles, n_walkers, n_steps = sample.log_density.shape
    share = GOOD_JUMP_SHARE if exploration.efficiency >= GOOD_ENOUGH else JUMP_SHARE
    density, proposal = exploration.straight.log_density, exploration.proposal
    stood = iter(sample.straight[:, :, -1])

    def start_from(last: Array) -> Draw:
        return lambda n_wanted, rng: last

    starts = [start_from(one) for one in stood]
    with stage("sampling", n_ensembles * n_walkers * (1 + n_steps)):
        more = run_ensembles(density, proposal, seed.spawn(n_ensembles), n_walkers, 0, n_steps, starts, share)
    added = Sample.from_ensembles(exploration.straight, more)
    return Sample(
        sample.straightening,
        np.concatenate([sample.straight, added.straight], axis=2),
        np.concatenate([sample.log_density, added.log_density], axis=2),
        0.5 * (sample.acceptance + added.acceptance),
    )
