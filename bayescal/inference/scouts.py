"""Walkers that start where an overdispersed proposal finds mass, and whether they end where the others are.

Ensembles that all start from one proposal agree about what that proposal misses, and neither R-hat nor effective sizes
see it. Scouts start elsewhere, as Gelman and Rubin (1992) advise: at draws from farther out that their weights give
mass. Where nothing is missed a few steps turn them into draws like all others. Where mass was missed, in a tail, beyond
a bend or in a mode of its own, some stay: jumps that seldom lead there seldom are accepted from there. How many may
stand where hardly any other draw is has a binomial bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.inference.ensemble import run_ensemble
from bayescal.inference.exploration import Exploration
from bayescal.inference.overdispersed import FarDraws
from bayescal.inference.sampling import Sample
from bayescal.inference.stages import stage
from bayescal.numerics.geometry import Array

N_STEPS = 20
RARE, FEWEST = 1e-3, 20  # share of the other draws beyond the quantiles, and how many these are at least
FALSE_ALARM = 1e-4  # of a posterior with all its coordinates


@dataclass(frozen=True)
class Scouts:
    """How many of so many scouts stayed beyond other draws' quantiles, in the worst coordinate, and its limit."""

    n_apart: int
    n_walkers: int
    limit: int


def send_scouts(exploration: Exploration, sample: Sample, far: FarDraws, seed: np.random.SeedSequence) -> Scouts:
    """Return where walkers that start far out end, against draws of ensembles that did not."""
    from scipy.stats import binom  # a second to import, for those who sample

    n_walkers, n = sample.straight.shape[1], sample.straight.shape[-1]
    known = np.flatnonzero(np.isfinite(far.log_weights))

    def draw(n: int, rng: np.random.Generator) -> Array:
        # those with the largest sums are n draws by weight, none of them twice (Gumbel)
        return far.x[known[np.argsort(far.log_weights[known] + rng.gumbel(size=len(known)))[-n:]]]

    density = exploration.straight.log_density
    with stage("comparison of walkers", n_walkers * (N_STEPS + 2)):
        run = run_ensemble(density, exploration.proposal, seed, n_walkers, N_STEPS, 1, draw)
    last = np.column_stack([run.draws[:, -1], run.log_density[:, -1]])
    others = np.column_stack([sample.straight.reshape(-1, n), sample.log_density.ravel()])
    rare = min(1.0, max(RARE, FEWEST / len(others)))
    low, high = np.quantile(others, [0.5 * rare, 1.0 - 0.5 * rare], axis=0)
    apart = ((last < low) | (last > high)).sum(axis=0)
    return Scouts(int(apart.max()), n_walkers, int(binom.isf(FALSE_ALARM / (n + 1), n_walkers, rare)) + 1)
