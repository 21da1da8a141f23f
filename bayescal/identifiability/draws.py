"""Draws of a posterior as an audit uses them: natural units, all ensembles together, thinned where that will do."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.inference.diagnostics import Diagnostics
from bayescal.inference.exploration import explore
from bayescal.inference.sampling import sample_posterior
from bayescal.inference.schema import DrawsConfig, count_walkers
from bayescal.inference.target import Target
from bayescal.numerics.geometry import Array

LEAST_STEPS = 4  # R-hat splits an ensemble in time


@dataclass(frozen=True, eq=False)
class Draws:
    """S draws of m free parameters, and of k errors that go with them."""

    values: Array  # (S, m): the parameters in natural units
    zeta: Array  # (S, k): coordinates of the errors
    diagnostics: Diagnostics
    problems: list[str]  # what speaks against convergence, in words

    @cached_property
    def mean(self) -> Array:
        """Posterior mean of the parameters, shape (m,)."""
        return np.asarray(self.values.mean(axis=0))

    def thin(self, n: int) -> Array:
        """Return the parameters of at most n draws, evenly taken, shape (n', m)."""
        return self.values[np.linspace(0, len(self.values) - 1, min(n, len(self.values))).astype(int)]


def sample(
    target: Target, config: DrawsConfig, n_draws: int, seed: np.random.SeedSequence
) -> tuple[Array, Diagnostics, list[str]]:
    """Return at least n draws (S, n) in sampling coordinates, explored first, as a study does it, and their faults."""
    explore_seed, ensemble_seed = seed.spawn(2)
    exploration = explore(target, explore_seed, config.walkers)
    walkers = count_walkers(target.n_parameters, config.walkers)
    steps = max(LEAST_STEPS, -(-n_draws // (config.ensembles * walkers)))
    found = sample_posterior(exploration, ensemble_seed, config.ensembles, config.walkers, config.burn_in, steps)
    problems = found.diagnostics.list_problems()
    if not all(mode.converged for mode in exploration.modes):
        problems.append("the mode search did not converge")
    return found.y.reshape(-1, target.n_parameters), found.diagnostics, problems
