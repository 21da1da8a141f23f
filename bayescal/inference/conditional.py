"""Coordinates in which geometry is normal whatever the errors are, where that is known in closed form.

Given the unknowns ζ of the errors the geometry is normal to first order, y | ζ ~ N(μ(ζ), C(ζ)), and so the density of ζ
alone is known, too: few, they are drawn by importance. Mean and Cholesky factor of C are then fitted by quadratics of ζ
to draws, y = μ(ζ) + F(ζ) x, in a basis in which C is nearly diagonal for all of them: a triangular map that is close to
the exact one and costs next to nothing. A map that is a little off costs draws of the proposal, and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from bayescal.density.components import LinearGeometry
from bayescal.inference.scales import find_scales_mode, sample_scales
from bayescal.inference.target import Target
from bayescal.numerics.geometry import Array

N_DRAWS: Final = 1000  # of the proposal of ζ
NODES_PER_FEATURE: Final = 15  # at which the map is fitted
MOST_NODES: Final = 400
WIDER: Final = 1.3  # standard deviations of half of the nodes in those of the draws
BOUND: Final = 4.0  # standard deviations of ζ at which quadratics level off


@dataclass(frozen=True, eq=False)
class ConditionalMap:
    """Geometry y = c + B (F(ζ) x + μ(ζ)), F lower triangular with a positive diagonal.

    Attributes
    ----------
    centre : ndarray, shape (m,)
        c.
    basis, inverse : ndarray, shape (m, m)
        B and B⁻¹.
    place, whitening : ndarray, shapes (k,) and (k, k)
        Mean of ζ and the inverse of its covariance's Cholesky factor.
    coefficients : ndarray, shape (f, m (m + 3) / 2)
        Of logarithms of F's diagonal, of F below it over its columns' diagonal, of μ; by features of ζ.
    errors : ndarray, shape (T, k)
        Draws of ζ.
    """

    centre: Array
    basis: Array
    inverse: Array
    place: Array
    whitening: Array
    coefficients: Array
    errors: Array

    def open(self, zeta: Array) -> tuple[Array, Array, Array]:
        """Return F (B, m, m), μ (B, m) and log |B F| (B,) at ζ (B, k)."""
        m = len(self.centre)
        values = _list_features((zeta - self.place) @ self.whitening.T) @ self.coefficients
        factor = np.zeros((len(zeta), m, m))
        factor[:, *np.tril_indices(m, -1)] = values[:, m:-m]
        factor[:, *np.diag_indices(m)] = 1.0
        factor *= np.exp(values[:, None, :m])
        return factor, values[:, -m:], values[:, :m].sum(axis=1) + self._log_volume

    @cached_property
    def _log_volume(self) -> float:
        return float(np.linalg.slogdet(self.basis)[1])

    def forward(self, x: Array, factor: Array, shift: Array) -> Array:
        """Return geometry (B, m) of x (B, m)."""
        return self.centre + ((factor @ x[..., None])[..., 0] + shift) @ self.basis.T

    def backward(self, y: Array, factor: Array, shift: Array) -> Array:
        """Return x (B, m) of geometry (B, m)."""
        return np.asarray(np.linalg.solve(factor, ((y - self.centre) @ self.inverse.T - shift)[..., None])[..., 0])


def _list_features(white: Array) -> Array:
    """Return one, bounded coordinates and their products, (B, k) to (B, f)."""
    bounded = white / np.sqrt(1.0 + (white / BOUND) ** 2)
    first, second = np.triu_indices(white.shape[1])
    return np.concatenate([np.ones((len(white), 1)), bounded, bounded[:, first] * bounded[:, second]], axis=1)


def fit_conditional(posterior: Target, y: Array) -> ConditionalMap | None:
    """Return the map of a posterior about a mode (n,); None where nothing is known in closed form.

    The same for the same posterior: its random numbers are.
    """
    linear = posterior.linear_geometry(y)
    if linear is None or len(y) == posterior.n_geometry:
        return None
    m, rng = posterior.n_geometry, np.random.default_rng(1803)
    mode = find_scales_mode(_density_of(linear), y[m:])
    found = posterior.polish(np.append(y[:m], mode))
    if np.isfinite(posterior.log_density(found[None])[0]):
        linear = posterior.linear_geometry(found) or linear
    draws = sample_scales(_density_of(linear), mode, N_DRAWS, N_DRAWS, rng).draws
    return _fit(linear, draws, rng)


def _density_of(linear: LinearGeometry) -> Callable[[Array], float]:
    return lambda zeta: linear.given(zeta).log_mass


def _fit(linear: LinearGeometry, draws: Array, rng: np.random.Generator) -> ConditionalMap:
    place, k = draws.mean(axis=0), draws.shape[1]
    spread = cholesky(np.atleast_2d(np.cov(draws.T)) + 1e-9 * np.eye(k), lower=True)
    half = min(MOST_NODES, NODES_PER_FEATURE * (1 + k + k * (k + 1) // 2)) // 2
    wide = place + WIDER * rng.standard_normal((half, k)) @ spread.T
    nodes = np.concatenate([wide, draws[rng.choice(len(draws), half)]])
    given = [linear.given(zeta) for zeta in nodes]
    mean, covariance = np.stack([one.mean for one in given]), np.stack([one.covariance for one in given])
    centre, root = mean.mean(axis=0), np.linalg.cholesky(covariance.mean(axis=0))
    inverse = np.linalg.inv(root)
    change = inverse @ covariance @ inverse.T - np.eye(len(root))
    _, axes = np.linalg.eigh(np.einsum("kij,kjl->il", change, change, optimize=True))
    basis, inverse = root @ axes, axes.T @ inverse
    factor = np.linalg.cholesky(inverse @ covariance @ inverse.T)
    diagonal = np.diagonal(factor, axis1=1, axis2=2)
    below = (factor / diagonal[:, None, :])[:, *np.tril_indices(len(root), -1)]
    wanted = np.concatenate([np.log(diagonal), below, (mean - centre) @ inverse.T], axis=1)
    whitening = solve_triangular(spread, np.eye(k), lower=True)
    features = _list_features((nodes - place) @ whitening.T)
    coefficients = np.linalg.lstsq(features, wanted, rcond=None)[0]
    return ConditionalMap(centre, basis, inverse, place, whitening, coefficients, draws)
