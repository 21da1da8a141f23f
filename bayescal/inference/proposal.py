"""Proposals close to the posterior: Laplace's approximation, sharpened by adaptive importance sampling."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import gammaln, logsumexp

from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class MixtureProposal:
    """A mixture of multivariate Student t densities.

    Attributes
    ----------
    weights : ndarray, shape (M,)
    means : ndarray, shape (M, n)
    factors : ndarray, shape (M, n, n)
        Lower Cholesky factors of the scale matrices.
    dof : float
        Degrees of freedom of every component.
    """

    weights: Array
    means: Array
    factors: Array
    dof: float

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
