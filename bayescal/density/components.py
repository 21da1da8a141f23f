"""Normal rows whose covariance is a sum of known matrices, each times a variance that is not known.

Rows e of P poses, n of each, white but for what is unknown, have the covariance (variance components: Patterson and
Thompson 1971)

    S = K + Σ_g v_g B_g + Σ_t v_t E_t

with K and B_g block diagonal, a block a pose, and E_t (P n, P n) whole: errors that are functions of the pose or of
time. Its Cholesky factor is the density's cost. Given the variances, geometry about which rows are linear is normal in
closed form (`LinearGeometry`), and so is the density of the variances alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs, dtrtrs

from bayescal.numerics.geometry import Array

AT_ONCE: Final = 300_000  # numbers of the covariances that are factorised together: they stay in the cache


MOST_ROWS: Final = 900
"""Rows of all poses together up to which S is factorised as a whole; with more functions are made of few columns."""


def batches(size: int, n_rows: int) -> list[slice]:
    """Return which of so many covariances of M rows are taken together."""
    most = max(1, AT_ONCE // n_rows**2)
    return [slice(k, k + most) for k in range(0, size, most)]


def assemble(own: Array, parts: Array, weights: Array) -> Array:
    """Return block diagonal matrices plus weighted parts.

    Parameters
    ----------
    own : ndarray, shape (B, P, n, n)
    parts : ndarray, shape (C, M, M)
        M = P n.
    weights : ndarray, shape (B, C)

    Returns
    -------
    ndarray, shape (B, M, M)
    """
    n, m = own.shape[2], parts.shape[-1]
    total = np.asarray(weights @ parts.reshape(len(parts), -1)).reshape(-1, m, m)
    batch, row, column = total.strides
    blocks = as_strided(total, own.shape, (batch, n * (row + column), row, column))  # a pose's rows with its columns
    blocks += own
    return total


def factorise(covariance: Array) -> Array:
    """Return a lower Cholesky factor in Fortran's order, numbers above it undefined; a covariance (M, M) is used up.

    LAPACK itself is called: of matrices that small scipy's checks take as long.
    """
    factor, info = dpotrf(covariance.T, lower=1, clean=0, overwrite_a=1)  # in place: the transpose is in that order
    if info:
        raise np.linalg.LinAlgError(f"found a covariance that is not positive definite at row {info}")
    return np.asarray(factor)


def square_whole(covariance: Array, seen: Array) -> tuple[Array, float]:
    """Return XᵀS⁻¹X of X (M, m), shape (m, m), and ½ log |S|; the covariance (M, M) is used up."""
    factor = factorise(covariance)
    white = np.asarray(dtrtrs(factor, seen, lower=1)[0])
    return white.T @ white, float(np.log(np.diag(factor)).sum())


def carry(covariance: Array, rows: Array) -> tuple[Array, Array]:
    """Return ½ log |S| and eᵀS⁻¹e of rows e (B, M), shapes (B,); covariances (B, M, M) are used up."""
    white, half_log_det = np.empty_like(rows), np.empty(len(rows))
    for k, one in enumerate(covariance):
        factor = factorise(one)
        white[k] = dtrtrs(factor, rows[k], lower=1)[0]
        half_log_det[k] = np.log(np.diag(factor)).sum()
    return half_log_det, np.einsum("bm,bm->b", white, white)


def weigh(covariance: Array, rows: Array) -> Array:
    """Return normal log-densities of rows (B, M) but for 2 π, shape (B,); covariances (B, M, M) are used up."""
    half_log_det, square = carry(covariance, rows)
    return np.asarray(-half_log_det - 0.5 * square)


def leave_out(covariance: Array, rows: Array, n_poses: int) -> tuple[Array, Array]:
    """Return by how much each pose's rows deviate from what all others predict, and their precision then.

    With A = S⁻¹ and α = A e the density of e_n given the others is normal with precision A_nn, shape (B, P, n, n), and
    its deviation from its mean is A_nn⁻¹ α_n, shape (B, P, n). Covariances are used up.
    """
    shape = n_poses, rows.shape[1] // n_poses
    alpha, precision = np.empty_like(rows), np.empty((len(rows), *shape, shape[1]))
    for k, one in enumerate(covariance):
        factor = factorise(one)
        alpha[k] = dpotrs(factor, rows[k], lower=1)[0]
        inverse = np.asarray(dpotri(factor, lower=1, overwrite_c=1)[0]).T  # its upper triangle, row by row
        precision[k] = np.einsum("pjpi->pij", inverse.reshape(*shape, *shape))
    below = np.tril(precision)
    precision = below + np.swapaxes(np.tril(precision, -1), -1, -2)
    return np.linalg.solve(precision, alpha.reshape(-1, *shape)[..., None])[..., 0], precision


def weigh_left_out(deviation: Array, precision: Array) -> Array:
    """Return log-densities but for 2 π of what `leave_out` finds of each pose, (B, P)."""
    square = np.einsum("bpi,bpij,bpj->bp", deviation, precision, deviation)
    return np.asarray(0.5 * np.linalg.slogdet(precision)[1] - 0.5 * square)


class LinearRows(NamedTuple):
    """Rows as a linear model of the geometry, with a covariance S that depends on the errors."""

    information: Array  # (m, m): of rows that do not depend on the errors
    pull: Array  # (m,): their gradient
    # from ζ (B, k) of the errors to XᵀS⁻¹X, (B, m + 1, m + 1), of slopes and residuals side by side, and (B,) of
    # ½ log |S|
    square: Callable[[Array], tuple[Array, Array]]


class GeometryGiven(NamedTuple):
    """Geometry given what is unknown of the errors, to first order about a machine: normal."""

    mean: Array  # (B, m)
    covariance: Array  # (B, m, m)


@dataclass(frozen=True, eq=False)
class LinearGeometry:
    """Geometry whose rows and prior are linear about a machine."""

    centre: Array  # (m,): the machine's coordinates
    rows: LinearRows
    # (m, m) or (B, m, m), and (m,): minus the Hessian and the gradient there of the prior and of all rows that do not
    # depend on the errors
    precision: Array
    pull: Array
    log_prior: Callable[[Array], Array]  # the log-prior (B,) of coordinates ζ (B, k) of the errors
    sizes: Callable[[Array], Array]  # from ζ (B, k) to the errors in their own units

    def given(self, zeta: Array) -> GeometryGiven:
        """Return the geometry given ζ (B, k): with J of the white rows e, H = P + JᵀJ and mean H⁻¹ (p - Jᵀ e)."""
        factor, step, _ = self.solve(zeta)
        inverse = np.linalg.inv(factor)
        mean = self.centre + (step[:, None] @ inverse)[:, 0]
        return GeometryGiven(mean, np.swapaxes(inverse, 1, 2) @ inverse)

    def log_mass(self, zeta: Array) -> Array:
        """Return the density (B,) of the errors' unknowns alone at ζ (B, k), but for a constant."""
        parts = [self.solve(zeta[part])[2] for part in batches(len(zeta), len(self.centre))]
        return np.concatenate(parts)

    def solve(self, zeta: Array) -> tuple[Array, Array, Array]:
        """Return H's lower factors L (B, m, m), L⁻¹ (p - Jᵀ e), (B, m), and the density (B,) of ζ (B, k) alone."""
        (both, half_log_det), m = self.rows.square(zeta), len(self.pull)
        factor = np.linalg.cholesky(self.precision + both[:, :m, :m])
        step = np.linalg.solve(factor, (self.pull - both[:, :m, m])[..., None])[..., 0]
        log_mass = 0.5 * (np.einsum("bi,bi->b", step, step) - both[:, m, m]) - half_log_det
        log_mass -= np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return factor, step, log_mass + self.log_prior(zeta)
