"""Draws from farther out than a proposal leads, with the weights that a posterior gives them.

They are of the proposal stretched fourfold along one principal axis each, the looser an axis the more of them: what
ensembles that start from the proposal and jump by it may have missed, some of these see.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayescal.inference.exploration import Exploration
from bayescal.inference.importance import evaluate_in_batches
from bayescal.inference.proposal import MixtureProposal
from bayescal.numerics.geometry import Array

N_DRAWS = 5000
AT_ONCE = 50  # draws whose axes are held, a matrix each
STRETCH = 4.0
EVENLY = 0.5  # share of draws that are spread over the axes evenly


@dataclass(frozen=True, eq=False)
class FarDraws:
    """Independent draws from farther out.

    Attributes
    ----------
    x : ndarray, shape (B, n)
        In the proposal's coordinates.
    log_density : ndarray, shape (B,)
        Of the posterior there.
    log_weights : ndarray, shape (B,)
        By which they are draws of the posterior; minus infinity where that has no density.
    """

    x: Array
    log_density: Array
    log_weights: Array


def draw_far_out(exploration: Exploration, seed: np.random.SeedSequence) -> FarDraws:
    """Return draws of an explored posterior's proposal as it is stretched."""
    wide = Stretched(exploration.proposal)
    x = wide.draw(N_DRAWS, np.random.default_rng(seed))
    with np.errstate(all="ignore"):
        log_density = evaluate_in_batches(exploration.straight.log_density, x)
        log_weights = log_density - wide.log_density(x)
    log_weights[~np.isfinite(log_weights)] = -np.inf
    return FarDraws(x, log_density, log_weights)


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
