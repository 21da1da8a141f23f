"""Proposals close to the posterior: Laplace's approximation, sharpened by adaptive importance sampling."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import gammaln, logsumexp

from bayescal.numerics.geometry import Array

COMPONENTS = (1, 2, 4, 8, 16, 32)
DOF = 10.0  # heavier tails than a Gaussian's, since a cloud of draws tells little of its own tails
GAIN = 0.02  # nats per draw that more components have to gain on draws they have not seen
SWEEPS = 8
MIN_DRAWS_PER_COMPONENT = 4  # effective draws per component and coordinate
FLOOR = 1e-3  # of the whole cloud's variance that each component keeps


@dataclass(frozen=True, eq=False)
class MixtureProposal:
    """A mixture of multivariate Student t densities."""

    weights: Array  # (M,)
    means: Array  # (M, n)
    factors: Array  # (M, n, n): lower Cholesky factors of the scale matrices
    dof: float  # degrees of freedom of every component

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Return n independent draws, shape (n, n_parameters)."""
        component = rng.choice(len(self.weights), n, p=self.weights)
        normal = rng.standard_normal((n, self.means.shape[1]))
        stretch = np.sqrt(self.dof / rng.chisquare(self.dof, n))
        draws = np.empty_like(normal)
        for m in range(len(self.weights)):
            chosen = component == m
            draws[chosen] = self.means[m] + (normal[chosen] @ self.factors[m].T) * stretch[chosen, None]
        return draws

    def component_log_densities(self, y: Array) -> Array:
        """Return the weighted log-density of each component, shape (M, B), for vectors (B, n)."""
        n = self.means.shape[1]
        terms = np.empty((len(self.weights), len(y)))
        for m, (peak, mean, factor) in enumerate(zip(self._log_peaks, self.means, self.factors, strict=True)):
            white = solve_triangular(factor, (y - mean).T, lower=True)
            square = np.einsum("ib,ib->b", white, white)
            terms[m] = peak - 0.5 * (self.dof + n) * np.log1p(square / self.dof)
        return terms

    @cached_property
    def _log_peaks(self) -> list[float]:
        """Weighted log-density of each component at its mean."""
        n, log_volumes = self.means.shape[1], [np.log(np.diag(factor)).sum() for factor in self.factors]
        constant = gammaln(0.5 * (self.dof + n)) - gammaln(0.5 * self.dof) - 0.5 * n * np.log(self.dof * np.pi)
        with np.errstate(divide="ignore"):  # a component whose weight is too small for a float
            log_weights = np.log(self.weights)
        return [log_weight + constant - volume for log_weight, volume in zip(log_weights, log_volumes, strict=True)]

    def log_density(self, y: Array) -> Array:
        """Return the normalised log-density, shape (B, n) to (B,)."""
        terms = self.component_log_densities(y)
        return terms[0] if len(terms) == 1 else logsumexp(terms, axis=0)  # the same number, which takes as long again


def proposal_from_draws(draws: Array, dof: float) -> MixtureProposal:
    """Return a single component with the mean and covariance of draws (B, n)."""
    covariance = np.atleast_2d(np.cov(draws.T))
    return MixtureProposal(np.ones(1), draws.mean(axis=0)[None], np.linalg.cholesky(covariance)[None], dof)


def fit_mixture(draws: Array, weights: Array, seen: np.ndarray, rng: np.random.Generator) -> MixtureProposal:
    """Return the mixture that describes weighted draws best: as many components as those left out ask for.

    Parameters
    ----------
    draws : ndarray, shape (B, n)
    weights : ndarray, shape (B,)
        They add up to one.
    seen : ndarray of bool, shape (B,)
        Draws to be fitted to; how many components are worth it is judged by the others. Draws of one chain belong on
        one side, lest components settle on single draws.
    rng : Generator
        For where components start.
    """
    n = draws.shape[1]
    centre = weights @ draws
    covariance = (draws - centre).T @ ((draws - centre) * weights[:, None])
    factor = np.linalg.cholesky(covariance + 1e-12 * np.trace(covariance) / n * np.eye(n))
    white = np.linalg.solve(factor, (draws - centre).T).T
    best, score = MixtureProposal(np.ones(1), np.zeros((1, n)), np.eye(n)[None], DOF), -np.inf
    effective = weights[seen].sum() ** 2 / (weights[seen] ** 2).sum()
    for n_components in COMPONENTS:
        if n_components * MIN_DRAWS_PER_COMPONENT * n > effective:
            break
        found = best if n_components == 1 else _fit(white[seen], weights[seen], n_components, rng)
        gained = float(weights[~seen] @ found.log_density(white[~seen]) / weights[~seen].sum())
        if gained < score + GAIN:
            break
        best, score = found, gained
    return MixtureProposal(best.weights, centre + best.means @ factor.T, factor @ best.factors, DOF)


def _fit(white: Array, weights: Array, n_components: int, rng: np.random.Generator) -> MixtureProposal:
    """Return a mixture of so many components fitted to whitened draws (B, n) by expectation and maximisation."""
    from scipy.cluster.vq import kmeans2

    start = rng.choice(len(white), min(len(white), 1000), p=weights / weights.sum())
    centres, _ = kmeans2(white[start], n_components, minit="++", rng=rng)
    distance = ((white[:, None] - centres) ** 2).sum(axis=2)
    share = np.eye(n_components)[distance.argmin(axis=1)].T
    for _ in range(SWEEPS):
        terms = _maximise(white, share * weights).component_log_densities(white)
        share = np.exp(terms - logsumexp(terms, axis=0))
    return _maximise(white, share * weights)


def _maximise(white: Array, share: Array) -> MixtureProposal:
    """Return the mixture of draws (B, n) that belong to components by shares (M, B)."""
    counts = share.sum(axis=1) + 1e-9 * share.sum()
    means = (share @ white) / counts[:, None]
    second = np.einsum("mb,bi,bj->mij", share, white, white, optimize=True) / counts[:, None, None]
    covariance = second - means[:, :, None] * means[:, None, :] + FLOOR * np.eye(white.shape[1])
    return MixtureProposal(counts / counts.sum(), means, np.linalg.cholesky(covariance), DOF)
