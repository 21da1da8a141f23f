"""Draws of a posterior as an audit uses them: natural units, all ensembles together, thinned where that will do."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.density.legs import LegPosterior
from bayescal.inference.diagnostics import Diagnostics
from bayescal.inference.exploration import explore
from bayescal.inference.sampling import sample_posterior
from bayescal.inference.schema import DrawsConfig, count_walkers
from bayescal.numerics.geometry import Array

LEAST_STEPS = 4  # R-hat splits an ensemble in time


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws of m free parameters and of the model errors that go with them.

    Attributes
    ----------
    n_geometry : int
        m.
    natural : ndarray, shape (E, S, n)
        Ensemble by ensemble, in natural units: the m parameters, then the free model errors.
    diagnostics : Diagnostics
    problems : list of str
        What speaks against convergence, in words.
    """

    n_geometry: int
    natural: Array
    diagnostics: Diagnostics
    problems: list[str]

    @cached_property
    def values(self) -> Array:
        """The parameters of all draws, shape (E S, m)."""
        return self.natural[..., : self.n_geometry].reshape(-1, self.n_geometry)

    @cached_property
    def mean(self) -> Array:
        """LegPosterior mean of the parameters, shape (m,)."""
        return np.asarray(self.values.mean(axis=0))

    def thin(self, n: int) -> Array:
        """Return the parameters of at most n draws, evenly taken, shape (n', m)."""
        return self.values[np.linspace(0, len(self.values) - 1, min(n, len(self.values))).astype(int)]


def draw_posterior(posterior: LegPosterior, config: DrawsConfig, n_draws: int, seed: np.random.SeedSequence) -> Draws:
    """Return at least n draws of a posterior, explored first, as a study does it."""
    explore_seed, ensemble_seed = seed.spawn(2)
    exploration = explore(posterior, explore_seed, config.walkers)
    walkers = count_walkers(posterior.n_parameters, config.walkers)
    steps = max(LEAST_STEPS, -(-n_draws // (config.ensembles * walkers)))
    sample = sample_posterior(exploration, ensemble_seed, config.ensembles, config.walkers, config.burn_in, steps)
    problems = sample.diagnostics.list_problems()
    if not all(mode.converged for mode in exploration.modes):
        problems.append("the mode search did not converge")
    natural = sample.natural.reshape(config.ensembles, -1, posterior.n_parameters)
    return Draws(posterior.n_geometry, natural, sample.diagnostics, problems)
