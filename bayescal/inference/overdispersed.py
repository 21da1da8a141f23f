"""Draws from farther out than a proposal leads, with the weights that a posterior gives them.

They are of the proposal stretched fourfold along one principal axis each, the looser an axis the more of them: what
ensembles that start from the proposal and jump by it may have missed, some of these see.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from bayescal.inference.diagnostics import LEAST_LACKING
from bayescal.inference.exploration import Exploration
from bayescal.inference.importance import evaluate_in_batches
from bayescal.inference.proposal import MixtureProposal
from bayescal.inference.stages import stage
from bayescal.numerics.geometry import Array

N_DRAWS = 5000
AT_ONCE = 50  # draws whose axes are held, a matrix each
STRETCH = 4.0
EVENLY = 0.5  # share of draws that are spread over the axes evenly
SELDOM = 20.0
"""By what factor a proposal leads somewhere less often than the posterior's mass would have it."""
CERTAIN = 2.0  # standard errors by which there have to be tails
HEAVIER = (20.0, 10.0, 6.0, 4.0)  # degrees of freedom


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

    @cached_property
    def weights(self) -> Array:
        """The same, their sum one."""
        weights = np.exp(self.log_weights - self.log_weights.max())
        return np.asarray(weights / weights.sum())

    @cached_property
    def log_evidence(self) -> float:
        """What the weights say of it."""
        highest = self.log_weights.max()
        return float(highest + np.log(np.exp(self.log_weights - highest).mean()))


def draw_far_out(exploration: Exploration, seed: np.random.SeedSequence) -> FarDraws:
    """Return draws of an explored posterior's proposal as it is stretched."""
    wide = Stretched(exploration.proposal)
    x = wide.draw(N_DRAWS, np.random.default_rng(seed))
    with np.errstate(all="ignore"), stage("tails", N_DRAWS):
        log_density = evaluate_in_batches(exploration.straight.log_density, x)
        log_weights = log_density - wide.log_density(x)
    log_weights[~np.isfinite(log_weights)] = -np.inf
    return FarDraws(x, log_density, log_weights)


def fit_tails(found: Exploration, far: FarDraws) -> Exploration:
    """Return an exploration whose proposal has tails as heavy as the posterior's, by draws from farther out.

    A proposal's own draws do not know of tails that it leads to too seldom. The mean of p / q over the posterior, one
    over the efficiency of q, does, and says how many degrees of freedom are best. Where hardly any of the mass is in
    such tails, or one draw alone says so, the exploration stays as it is.
    """
    seen = far.weights > 0.0
    x, log_posterior, weights = far.x[seen], far.log_density[seen] - far.log_evidence, far.weights[seen]
    there = log_posterior - found.proposal.log_density(x) > np.log(SELDOM)
    share = float(weights[there].sum())
    if not share > max(LEAST_LACKING, CERTAIN * float(np.linalg.norm(weights * (there - share)))):
        return found

    def rate(proposal: MixtureProposal) -> float:
        return float(np.exp(-logsumexp(log_posterior - proposal.log_density(x), b=weights)))

    best = max((replace(found.proposal, dof=dof) for dof in (found.proposal.dof, *HEAVIER)), key=rate)
    return replace(found, proposal=best, efficiency=rate(best))


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
