"""Coordinates in which geometry is normal whatever the errors are, where that is known in closed form.

Given the unknowns ζ of the errors the geometry is normal to first order, y | ζ ~ N(μ(ζ), C(ζ)), and so the density of ζ
alone is known, too: few, they are drawn by importance. Mean and Cholesky factor of C are then fitted to draws of ζ by
cubics of log(s² + r), s the errors' sizes: flat where an error is too small to matter, straight where it is large. The
map y = μ + F x that they give is triangular in a basis in which C is nearly diagonal for all ζ, close to the exact one,
and costs next to nothing. A map that is a little off costs draws of the proposal, and nothing else. Where it is far
off, as where sizes that make up for each other are all small together, the exact one takes its place, which factorises
the rows' covariance once more for each ζ.

Machines beside the default model error need the map, an evidence of `tests/cases/own_term_shrinks_gains` 0.20 nats low
without it, and the printer of `tests/cases/delta_default_not_converged` the exact one, 0.23 nats low
(`benchmarks/ablation`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Final

import numpy as np

from bayescal.density.components import LinearGeometry
from bayescal.density.linear_gaussian import half_log_det, solve_factor
from bayescal.inference.scales import sample_scales
from bayescal.inference.target import LogDensity
from bayescal.numerics.geometry import Array

N_DRAWS: Final = 600  # of the proposal of ζ
LEAST, WANTED, MOST_DRAWS = 200, 1000, 8000
MOST = (0.05, 0.95)  # quantiles of an error's draws that have to differ
"""Effective draws below which there are too few, about as many then, and most draws for that: the shape of a proposal
that is fitted to some eighty is chance, and its efficiency anything from one to 40 per cent."""
NODES_PER_FEATURE: Final = 6  # at which the map is fitted
MOST_NODES: Final = 800
WIDER: Final = 1.3  # standard deviations of half of the nodes in those of the draws
BOUND: Final = 4.0  # standard deviations of log(s² + r) at which features level off
FAR: Final = 1e6  # the same, beyond which features do not tell them apart
REST: Final = 0.1  # r, in medians of s²


@dataclass(frozen=True, eq=False)
class Features:
    """Functions of ζ that maps are made of.

    Attributes
    ----------
    sizes : callable
        From ζ (B, k) to the errors' sizes s (B, k).
    rest : ndarray, shape (k,)
        r.
    place, width : ndarray, shape (k,)
        Mean and standard deviation of log(s² + r).
    is_cubic : bool
        Whether there are products of three.
    """

    sizes: Callable[[Array], Array]
    rest: Array
    place: Array
    width: Array
    is_cubic: bool

    @classmethod
    def fit(cls, sizes: Callable[[Array], Array], draws: Array) -> Features:
        """Return those of draws (T, k)."""
        square = sizes(draws) ** 2
        rest = np.maximum(REST * np.median(square, axis=0), np.finfo(float).tiny)
        log = np.log(square + rest)
        k = draws.shape[1]
        n_cubic = 1 + k + k * (k + 1) // 2 + k**2
        return cls(sizes, rest, log.mean(axis=0), log.std(axis=0) + 1e-9, n_cubic * NODES_PER_FEATURE <= MOST_NODES)

    def list(self, zeta: Array) -> Array:
        """Return them at ζ, (B, k) to (B, f): one, coordinates, products of two, and of three but for distinct ones."""
        with np.errstate(over="ignore"):  # of walkers that are far out
            white = (np.log(self.sizes(zeta) ** 2 + self.rest) - self.place) / self.width
        white = np.minimum(white, FAR)
        one = white / np.sqrt(1.0 + (white / BOUND) ** 2)
        first, second = np.triu_indices(one.shape[1])
        parts = [np.ones((len(one), 1)), one, one[:, first] * one[:, second]]
        if self.is_cubic:
            parts.append((one[:, :, None] ** 2 * one[:, None, :]).reshape(len(one), -1))
        return np.concatenate(parts, axis=1)


@dataclass(frozen=True, eq=False)
class ExactConditional:
    """Geometry y = c + L⁻ᵀ (x + s) with L Lᵀ its precision given ζ and s = L⁻¹ times its pull, exact to first order.

    Attributes
    ----------
    geometry : LinearGeometry
    errors : ndarray, shape (T, k)
        Draws of ζ.
    """

    geometry: LinearGeometry
    errors: Array
    exact: ClassVar[None] = None  # it is no fit

    def open(self, zeta: Array) -> tuple[Array, Array, Array]:
        """Return L⁻ᵀ (B, m, m), s (B, m) and log |L⁻ᵀ| (B,) at ζ (B, k)."""
        found = self.geometry.solve(zeta)
        inverse = solve_factor(found.factor, np.eye(found.factor.shape[-1]))
        return np.swapaxes(inverse, 1, 2), found.white[..., 0], -half_log_det(found.factor)

    def forward(self, x: Array, factor: Array, shift: Array) -> Array:
        """Return geometry (B, m) of x (B, m)."""
        return np.asarray(self.geometry.centre + (factor @ (x + shift)[..., None])[..., 0])

    def backward(self, y: Array, factor: Array, shift: Array) -> Array:
        """Return x (B, m) of geometry (B, m)."""
        return np.asarray(np.linalg.solve(factor, (y - self.geometry.centre)[..., None])[..., 0] - shift)


@dataclass(frozen=True, eq=False)
class ConditionalMap:
    """Geometry y = c + B (F(ζ) x + μ(ζ)), F lower triangular with a positive diagonal.

    Attributes
    ----------
    centre : ndarray, shape (m,)
        c.
    basis, inverse : ndarray, shape (m, m)
        B and B⁻¹.
    features : Features
    coefficients : ndarray, shape (f, m (m + 3) / 2)
        Of logarithms of F's diagonal, of F below it over its columns' diagonal, of μ; by features of ζ.
    errors : ndarray, shape (T, k)
        Draws of ζ.
    exact : ExactConditional
        What the map is fitted to.
    """

    centre: Array
    basis: Array
    inverse: Array
    features: Features
    coefficients: Array
    errors: Array
    exact: ExactConditional

    def open(self, zeta: Array) -> tuple[Array, Array, Array]:
        """Return F (B, m, m), μ (B, m) and log |B F| (B,) at ζ (B, k)."""
        m = len(self.centre)
        values = self.features.list(zeta) @ self.coefficients
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


def fit_conditional(posterior: LogDensity, y: Array) -> ConditionalMap | None:
    """Return the map of a posterior about a mode (n,); None where nothing is known in closed form.

    None, too, where sizes of errors are held at the end of their range by data that contradict a model: nothing varies,
    or no more than single draws do.
    The same for the same posterior: its random numbers are.
    """
    linear = posterior.linear_geometry(y)
    if linear is None or len(y) == posterior.n_geometry:
        return None
    rng, mode = np.random.default_rng(1803), y[posterior.n_geometry :]
    scales = sample_scales(linear.log_mass, mode, N_DRAWS, N_DRAWS, rng)
    if scales.efficiency * N_DRAWS < LEAST:
        scales = sample_scales(linear.log_mass, mode, min(MOST_DRAWS, round(WANTED / scales.efficiency)), WANTED, rng)
    varies = (np.ptp(np.quantile(scales.draws, MOST, axis=0), axis=0) > 0.0).all()
    return _fit(linear, scales.draws, rng) if varies else None


def _fit(linear: LinearGeometry, draws: Array, rng: np.random.Generator) -> ConditionalMap:
    features, k = Features.fit(linear.sizes, draws), draws.shape[1]
    half = min(MOST_NODES, NODES_PER_FEATURE * features.list(draws[:1]).shape[1]) // 2
    spread = np.linalg.cholesky(np.atleast_2d(np.cov(draws.T)) + 1e-9 * np.eye(k))
    wide = draws.mean(axis=0) + WIDER * rng.standard_normal((half, k)) @ spread.T
    nodes = np.concatenate([wide, draws[rng.choice(len(draws), half)]])
    mean, covariance = linear.given(nodes)
    centre, root = mean.mean(axis=0), np.linalg.cholesky(covariance.mean(axis=0))
    inverse = np.linalg.inv(root)
    change = inverse @ covariance @ inverse.T - np.eye(len(root))
    _, axes = np.linalg.eigh(np.einsum("kij,kjl->il", change, change, optimize=True))
    basis, inverse = root @ axes, axes.T @ inverse
    factor = np.linalg.cholesky(inverse @ covariance @ inverse.T)
    diagonal = np.diagonal(factor, axis1=1, axis2=2)
    below = (factor / diagonal[:, None, :])[:, *np.tril_indices(len(root), -1)]
    wanted = np.concatenate([np.log(diagonal), below, (mean - centre) @ inverse.T], axis=1)
    coefficients = np.linalg.lstsq(features.list(nodes), wanted, rcond=None)[0]
    return ConditionalMap(centre, basis, inverse, features, coefficients, draws, ExactConditional(linear, draws))
