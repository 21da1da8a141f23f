"""Rows that are linear in normal unknowns, with normal noise: the one place where these are conditioned.

Rows e = A x + ε with x ~ N(0, Λ⁻¹) and ε ~ N(0, R) have, x integrated out, the covariance S = R + A Λ⁻¹ Aᵀ. With
H = Λ + Aᵀ R⁻¹ A = L Lᵀ and w = L⁻¹ Aᵀ R⁻¹ e (Woodbury's identity and the determinant's lemma)

    eᵀS⁻¹e = eᵀR⁻¹e - |w|²,    ½ log |S| = ½ log |R| + Σ log L_ii - ½ log |Λ|,    x | e ~ N(L⁻ᵀ w, H⁻¹).

`condition` takes H, Aᵀ R⁻¹ e and eᵀ R⁻¹ e alone: what a caller's columns are made of, products of Kronecker's kind or
of few functions, shows in how these Gram products are formed and nowhere else. A mean m of the prior is a row more, and
adds Λ m and mᵀΛm. Where S is whole there is nothing to condition, and `whiten` and `weigh` take it as R.

Arrays may have batch axes in front.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dtrtrs

from bayescal.numerics.geometry import Array

SMALL: Final = 20
"""Rows up to which numpy's routines for a stack of matrices take less time than LAPACK's, called for each matrix."""


def factorise(covariance: Array) -> Array:
    """Return lower Cholesky factors L, numbers above them undefined, of covariances (..., n, n), which are used up.

    LAPACK itself is called, in place: of matrices of some ten rows scipy's checks take as long.

    Raises
    ------
    LinAlgError
        Where a covariance is not positive definite.
    """
    if not covariance.size:
        return covariance
    if covariance.ndim > 2 and covariance.shape[-1] <= SMALL:
        return np.linalg.cholesky(covariance)
    factor = np.swapaxes(covariance, -1, -2).reshape(-1, *covariance.shape[-2:])  # each in Fortran's order
    for own in factor:
        found, info = dpotrf(own, lower=1, clean=0, overwrite_a=1)
        if info:
            raise np.linalg.LinAlgError(f"found an indefinite covariance at row {info}")
        if found is not own:
            own[:] = found
    return factor.reshape(covariance.shape)


def solve_factor(factor: Array, rows: Array, transposed: bool = False) -> Array:
    """Return L⁻¹ X, or L⁻ᵀ X where it is to be transposed, of lower factors (..., n, n).

    Rows X are (..., n, k) each, or what can be broadcast to that, as (n, k) for all.
    """
    if not factor.size:
        return np.zeros((*factor.shape[:-2], *rows.shape[-2:]))
    if factor.ndim > 2 and factor.shape[-1] <= SMALL:
        factor = np.swapaxes(factor, -1, -2) if transposed else factor
        many = rows.shape[-1] > factor.shape[-1]
        return np.asarray(np.linalg.inv(factor) @ rows if many else np.linalg.solve(factor, rows))
    found = np.empty((*factor.shape[:-2], *rows.shape[-2:]))
    found[...] = rows
    flat = factor.reshape(-1, *factor.shape[-2:])
    for own, row in zip(flat, found.reshape(-1, *rows.shape[-2:]), strict=True):
        row[:] = dtrtrs(own, row, lower=1, trans=int(transposed))[0]
    return found


def whiten(covariance: Array, rows: Array) -> tuple[Array, Array]:
    """Return white rows L⁻¹ X, (..., n, k), and ½ log |R|, (...), of covariances R (..., n, n), which are used up."""
    factor = factorise(covariance)
    return solve_factor(factor, rows), half_log_det(factor)


def half_log_det(factor: Array) -> Array:
    """Return ½ log |R| of lower factors (..., n, n), shape (...)."""
    return np.asarray(np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1))


def weigh(covariance: Array, rows: Array) -> Array:
    """Return normal log-densities of rows (..., n) but for 2 π, shape (...); covariances (..., n, n) are used up."""
    white, volume = whiten(covariance, rows[..., None])
    return np.asarray(-volume - 0.5 * np.einsum("...ik,...ik->...", white, white))


def invert(covariance: Array, rows: Array) -> tuple[Array, Array]:
    """Return S⁻¹ (..., n, n), numbers below its diagonal undefined, and S⁻¹ e (..., n) of rows e; S is used up."""
    factor = factorise(covariance)
    pull = solve_factor(factor, solve_factor(factor, rows[..., None]), transposed=True)[..., 0]
    for own in factor.reshape(-1, *factor.shape[-2:]):
        own[:] = dpotri(own, lower=1, overwrite_c=1)[0]
    return np.swapaxes(factor, -1, -2), pull


def weigh_left_out(precision: Array, pull: Array) -> Array:
    """Return log-densities (...) but for 2 π of groups of rows given all other groups.

    A group deviates from what the others predict by Ω⁻¹ (S⁻¹ e)_g with precision Ω = (S⁻¹)_gg, (..., n, n), of which
    numbers below the diagonal do not count; ``pull`` (..., n) are (S⁻¹ e)_g.
    """
    precision = np.triu(precision) + np.swapaxes(np.triu(precision, 1), -1, -2)
    deviation = np.linalg.solve(precision, pull[..., None])[..., 0]
    return np.asarray(0.5 * np.linalg.slogdet(precision)[1] - 0.5 * np.einsum("...i,...i->...", pull, deviation))


@dataclass(frozen=True, eq=False)
class ConditionalNormal:
    """Unknowns x (..., n) given rows X (..., M, k) side by side: normal about a mean for each of them."""

    factor: Array  # (..., n, n): L, numbers above its diagonal undefined
    white: Array  # (..., n, k): w
    square: Array  # (..., k, k): XᵀS⁻¹X
    constant: Array | float  # (...): of the log-density, ½ log |Λ| - ½ log |R|

    @property
    def log_marginal(self) -> Array:
        """Log-density (...) of the last of the rows but for 2 π, x integrated."""
        return np.asarray(self.constant - 0.5 * self.square[..., -1, -1] - half_log_det(self.factor))

    @property
    def mean(self) -> Array:
        """Means (..., n, k)."""
        return solve_factor(self.factor, self.white, transposed=True)

    @property
    def covariance(self) -> Array:
        """H⁻¹, (..., n, n)."""
        root = solve_factor(self.factor, np.eye(self.factor.shape[-1]))
        return np.asarray(np.swapaxes(root, -1, -2) @ root)

    def predict(self, columns: Array) -> tuple[Array, Array]:
        """Return means (..., g, m, k) and covariances (..., g, m, m) of g groups of rows A x, A (..., g, m, n)."""
        flat = columns.reshape(*columns.shape[:-3], -1, columns.shape[-1])
        root = np.swapaxes(solve_factor(self.factor, np.swapaxes(flat, -1, -2)), -1, -2).reshape(columns.shape)
        return root @ self.white[..., None, :, :], root @ np.swapaxes(root, -1, -2)

    def draw(self, normal: Array) -> Array:
        """Return draws (..., n, k) about the means, or the mean, from standard normal numbers of that shape."""
        return solve_factor(self.factor, self.white + normal, transposed=True)


def condition(precision: Array, pull: Array, square: Array | float, constant: Array | float = 0.0) -> ConditionalNormal:
    """Return unknowns given rows X by H (..., n, n), which is used up, AᵀR⁻¹X (..., n, k) and XᵀR⁻¹X (..., k, k).

    The constant (...) is ½ log |Λ| - ½ log |R|, and what else the rows' log-density has.
    """
    factor = factorise(precision)
    white = solve_factor(factor, pull)
    return ConditionalNormal(factor, white, np.asarray(square - np.swapaxes(white, -1, -2) @ white), constant)


def condition_white(columns: Array, rows: Array, constant: Array | float = 0.0) -> ConditionalNormal:
    """Return standard normal unknowns given rows (..., M, k) and columns A (..., M, n) in white noise."""
    turned, back = np.swapaxes(columns, -1, -2), np.swapaxes(rows, -1, -2)
    precision = turned @ columns
    np.einsum("...ii->...i", precision)[:] += 1.0
    return condition(precision, turned @ rows, back @ rows, constant)
