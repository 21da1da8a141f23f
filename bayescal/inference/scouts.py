"""Walkers that start where an overdispersed proposal finds mass, and whether they end where the others are.

Ensembles that all start from one proposal agree about what that proposal misses, and neither R-hat nor effective sizes
see it. Scouts start elsewhere, as Gelman and Rubin (1992) advise: draws of the proposal are stretched fourfold along
one principal axis each, the looser an axis the more of them, and those are kept that their weights give mass. Where
nothing is missed a few steps turn them into draws like all others. Where mass was missed, in a tail, beyond a bend or
in a mode of its own, some stay: jumps that seldom lead there seldom are accepted from there. How many may stand where
hardly any other draw is has a binomial bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp
from scipy.stats import binom

from bayescal.inference.ensemble import run_ensemble
from bayescal.inference.exploration import Exploration
from bayescal.inference.importance import evaluate_in_batches
from bayescal.inference.proposal import MixtureProposal
from bayescal.inference.sampling import Sample
from bayescal.numerics.geometry import Array

N_DRAWS, N_STEPS = 2000, 20
AT_ONCE = 50  # draws whose axes are held, a matrix each
STRETCH = 4.0
EVENLY = 0.5  # share of scouts that are spread over the axes evenly
RARE, FEWEST = 1e-3, 20  # share of the other draws beyond the quantiles, and how many these are at least
FALSE_ALARM = 1e-4  # of a posterior with all its coordinates


@dataclass(frozen=True)
class Scouts:
    """How many of so many scouts stayed beyond other draws' quantiles, in the worst coordinate, and its limit."""

    n_apart: int
    n_walkers: int
    limit: int


def send_scouts(exploration: Exploration, sample: Sample, seed: np.random.SeedSequence) -> Scouts:
    """Return where walkers that start far out end, against draws of ensembles that did not."""
    density, wide = exploration.straight.log_density, Stretched(exploration.proposal)
    n_walkers, n = sample.straight.shape[1], sample.straight.shape[-1]

    def draw(n: int, rng: np.random.Generator) -> Array:
        x = wide.draw(N_DRAWS, rng)
        with np.errstate(all="ignore"):
            log_weights = evaluate_in_batches(density, x) - wide.log_density(x)
        known = np.flatnonzero(np.isfinite(log_weights))
        # those with the largest sums are n draws by weight, none of them twice (Gumbel)
        return x[known[np.argsort(log_weights[known] + rng.gumbel(size=len(known)))[-n:]]]

    run = run_ensemble(density, exploration.proposal, seed, n_walkers, N_STEPS, 1, draw)
    last = np.column_stack([run.draws[:, -1], run.log_density[:, -1]])
    others = np.column_stack([sample.straight.reshape(-1, n), sample.log_density.ravel()])
    rare = min(1.0, max(RARE, FEWEST / len(others)))
    low, high = np.quantile(others, [0.5 * rare, 1.0 - 0.5 * rare], axis=0)
    apart = ((last < low) | (last > high)).sum(axis=0)
    return Scouts(int(apart.max()), n_walkers, int(binom.isf(FALSE_ALARM / (n + 1), n_walkers, rare)) + 1)


class Stretched:
    """A mixture of normal densities, each stretched along one of its principal axes: as many as there are axes."""

    def __init__(self, proposal: MixtureProposal) -> None:
        self._weights, self._means = proposal.weights, proposal.means
        parts = [np.linalg.svd(factor) for factor in proposal.factors]
        self._axes, self._sizes = np.stack([part[0] for part in parts]), np.stack([part[1] for part in parts])
        even, loose = 1.0 / self._sizes.shape[1], self._sizes**2
        self._shares = EVENLY * even + (1.0 - EVENLY) * loose / loose.sum(axis=1, keepdims=True)

    def draw(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return independent draws, shape (n_draws, n)."""
        component = rng.choice(len(self._weights), n_draws, p=self._weights)
        normal = rng.standard_normal((n_draws, self._means.shape[1]))
        for m in np.unique(component):
            own = np.flatnonzero(component == m)
            normal[own, rng.choice(normal.shape[1], len(own), p=self._shares[m])] *= STRETCH
        normal *= self._sizes[component]
        moved = [
            np.einsum("bij,bj->bi", self._axes[component[k : k + AT_ONCE]], normal[k : k + AT_ONCE])
            for k in range(0, n_draws, AT_ONCE)
        ]
        return np.asarray(self._means[component] + np.concatenate(moved))

    def log_density(self, x: Array) -> Array:
        """Return the log-density, (B, n) to (B,)."""
        constant = 0.5 * x.shape[1] * np.log(2.0 * np.pi) + np.log(STRETCH)
        terms = np.empty((len(self._weights), len(x)))
        for m, (mean, axes, sizes) in enumerate(zip(self._means, self._axes, self._sizes, strict=True)):
            square = ((x - mean) @ axes / sizes) ** 2
            stretched = logsumexp(0.5 * square * (1.0 - STRETCH**-2), axis=1, b=self._shares[m])
            terms[m] = np.log(self._weights[m]) - np.log(sizes).sum() - 0.5 * square.sum(axis=1) + stretched
        return np.asarray(logsumexp(terms, axis=0) - constant)
