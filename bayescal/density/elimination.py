"""Eliminating poses: least squares of a few coordinates at many poses at once, of readings made independent.

H (..., K, q) is white; K readings, q coordinates. By entries where they are few, or by singular values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.numerics.geometry import Array

SINGULAR = 1e-14  # of a column's square, below which the others leave nothing of it
MOST_ENTRIES = 16  # rows of a matrix that is factorised by its entries
RANK = 1e-7  # of the largest singular value of H, below which a pose is not told


def half_log_volume(slope: Array) -> Array:
    """Return ½ log |HᵀΣ⁻¹H| for white H (..., K, q)."""
    if not slope.shape[-1]:
        return np.zeros(slope.shape[:-2])
    with np.errstate(all="ignore"):
        return log_root(factorise(slope))


def log_root(factor: list[list[Array]]) -> Array:
    """Return ½ log |HᵀΣ⁻¹H|, shape (...), from the factor of a white H with at least one column."""
    return np.asarray(sum(np.log(row[-1]) for row in factor))


def factorise(slope: Array) -> list[list[Array]]:
    """Return the Cholesky factor L of HᵀH for H (..., K, q), L[i][j] of shape (...); NaN where there is none.

    By entries, for q is small: a few passes over whole batches, where LAPACK would be called for each pose.
    """
    columns = [np.ascontiguousarray(slope[..., k]) for k in range(slope.shape[-1])]
    factor: list[list[Array]] = []
    for i, column in enumerate(columns):
        row: list[Array] = []
        for j in range(i):
            rest = np.einsum("...k,...k->...", column, columns[j]) - sum(row[k] * factor[j][k] for k in range(j))
            row.append(rest / factor[j][j])
        square = np.einsum("...k,...k->...", column, column)
        rest = square - sum(one * one for one in row)
        row.append(np.sqrt(np.where(rest > SINGULAR * square, rest, np.nan)))
        factor.append(row)
    return factor


def find_step(slope: Array, error: Array) -> tuple[Array, Array]:
    """Return the step of the pose (..., q) that leaves least of white errors (..., K), and what it leaves.

    NaN where H (..., K, q) is singular.
    """
    with np.errstate(all="ignore"):
        step, _ = solve_step(slope, factorise(slope), error)
        return step, subtract_step(slope, step, error)


def subtract_step(slope: Array, step: Array, error: Array) -> Array:
    """Return what a step (..., q) leaves of white errors (..., K), to first order."""
    return np.asarray(error - sum(slope[..., i] * step[..., i, None] for i in range(slope.shape[-1])))


def solve_step(slope: Array, factor: list[list[Array]], error: Array) -> tuple[Array, Array]:
    """Return the same step from H and the factor of HᵀH, and by how much white readings move with it, |H v| (...)."""
    q = slope.shape[-1]
    solved: list[Array] = []
    if not q:  # nothing moves
        return np.zeros((*error.shape[:-1], 0)), np.zeros(error.shape[:-1])
    with np.errstate(all="ignore"):
        for i in range(q):
            side = np.einsum("...k,...k->...", slope[..., i], error) - sum(factor[i][k] * solved[k] for k in range(i))
            solved.append(side / factor[i][i])
        length = np.sqrt(sum(one * one for one in solved))
        for i in reversed(range(q)):
            solved[i] = (solved[i] - sum(factor[k][i] * solved[k] for k in range(i + 1, q))) / factor[i][i]
    return np.stack(solved, axis=-1), length


def whiten_covariance(covariance: Array) -> tuple[Array, Array]:
    """Return the inverse of the Cholesky factor of covariances (..., K, K), and the logarithm of its determinant (...).

    By entries where they are few and the matrices many, as in `factorise`; NaN where a matrix is not positive definite.
    """
    n = covariance.shape[-1]
    if n > MOST_ENTRIES:
        factor = np.linalg.cholesky(covariance)
        return np.linalg.inv(factor), -np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
    there = covariance.reshape(-1, n, n).any(axis=0)
    factors: dict[tuple[int, int], Array] = {}
    inverse: dict[tuple[int, int], Array] = {}
    result = np.zeros_like(covariance)
    with np.errstate(all="ignore"):
        for i in range(n):
            for j in range(i + 1):
                terms = [factors[i, k] * factors[j, k] for k in range(j) if (i, k) in factors and (j, k) in factors]
                if terms or there[i, j]:
                    rest = covariance[..., i, j] - sum(terms)
                    factors[i, j] = np.sqrt(rest) if i == j else rest / factors[j, j]
            inverse[i, i] = 1.0 / factors[i, i]
            for j in range(i):
                terms = [factors[i, k] * inverse[k, j] for k in range(j, i) if (i, k) in factors and (k, j) in inverse]
                if terms:
                    inverse[i, j] = -inverse[i, i] * sum(terms)
        for (i, j), entry in inverse.items():
            result[..., i, j] = entry
        return result, np.asarray(sum(np.log(inverse[i, i]) for i in range(n)))


def orthonormalise(slope: Array) -> Array:
    """Return orthonormal columns (..., K, q) that span those of white H (..., K, q); NaN where H is singular."""
    factor, axes = factorise(slope), np.empty(slope.shape)
    for i in range(slope.shape[-1]):
        rest = slope[..., i] - sum(factor[i][k][..., None] * axes[..., k] for k in range(i))
        axes[..., i] = rest / factor[i][i][..., None]
    return axes


def project_out(slope: Array) -> Array:
    """Return 1 - H (HᵀH)⁻¹ Hᵀ for H (P, K, q), shape (P, K, K)."""
    return np.asarray(np.eye(slope.shape[1]) - slope @ invert(slope, 0.0))


def invert(slope: Array, damping: float) -> Array:
    """Return (HᵀH + λ diag HᵀH)⁻¹ Hᵀ for H (P, K, q), shape (P, q, K); zero where H is singular.

    By singular values: beside a constraint all else is so small that HᵀH would not hold it.
    """
    scale = np.linalg.norm(slope, axis=-2, keepdims=True)
    scale = np.where(scale > 0.0, scale, 1.0)
    left, values, right = np.linalg.svd(np.nan_to_num(slope / scale), full_matrices=False)
    good = np.isfinite(slope).all(axis=(-1, -2)) & (slope.shape[-2] >= slope.shape[-1])
    if slope.shape[-1]:
        good &= values[:, -1] > RANK * values[:, 0]
    gain = values / np.where(good[:, None], values**2 + damping, 1.0)
    inverse = np.swapaxes(left * gain[:, None] @ right, -1, -2) / np.swapaxes(scale, -1, -2)
    return np.asarray(np.where(good[:, None, None], inverse, 0.0))


def left_of(matrix: Array, vector: Array) -> Array:
    """Return matrices (P, i, k) times vectors (P, k)."""
    return np.asarray((matrix @ vector[..., None])[..., 0])


FEW = 16


@dataclass(frozen=True, eq=False)
class Whitening:
    """What makes readings of C machines at P poses independent and of unit noise, those not taken zero."""

    diagonal: Array  # (C, P, K): one over the deviation of readings whose noise is their own, zero for the others
    matrix: Array | None  # (C or 1, P, k, k): of those whose noise depends on each other, which stand at ``places``
    places: np.ndarray  # (k,)
    log_det: Array  # (C, P): of the whitening, of the readings taken

    def pick(self, some: np.ndarray | slice) -> Whitening:
        """Return that of some of the machines."""
        matrix = self.matrix if self.matrix is None or len(self.matrix) == 1 else self.matrix[some]
        return Whitening(self.diagonal[some], matrix, self.places, self.log_det[some])

    def at_poses(self, some: np.ndarray) -> Whitening:
        """Return that of some of the poses."""
        matrix = self.matrix if self.matrix is None else self.matrix[:, some]
        return Whitening(self.diagonal[:, some], matrix, self.places, self.log_det[:, some])

    def repeat(self, n: int) -> Whitening:
        """Return that of one machine for n of them."""
        matrix = self.matrix if self.matrix is None else np.broadcast_to(self.matrix, (n, *self.matrix.shape[1:]))
        diagonal, log_det = (np.broadcast_to(one, (n, *one.shape[1:])) for one in (self.diagonal, self.log_det))
        return Whitening(diagonal, matrix, self.places, log_det)

    def vector(self, error: Array) -> Array:
        """Return white errors (C, P, K)."""
        result = self.diagonal * error
        if self.matrix is not None:
            result[..., self.places] = (self.matrix @ error[..., self.places, None])[..., 0]
        return np.asarray(result)

    def colour(self, white: Array) -> Array:
        """Return errors of readings (C, P, K) from white ones; those not taken stay zero."""
        result = np.where(self.diagonal > 0, white / np.where(self.diagonal > 0, self.diagonal, 1.0), 0.0)
        if self.matrix is not None:
            result[..., self.places] = np.linalg.solve(self.matrix, white[..., self.places, None])[..., 0]
        return np.asarray(result)

    def rows(self, slope: Array) -> Array:
        """Return white derivatives (C, P, K, n)."""
        if slope.shape[-1] > FEW:
            result = self.diagonal[..., None] * slope
        else:  # column by column: a last axis that short is slow
            shape = np.broadcast_shapes(self.diagonal.shape, slope.shape[:-1])
            result = np.empty((*shape, slope.shape[-1]))
            for i in range(slope.shape[-1]):
                np.multiply(self.diagonal, slope[..., i], out=result[..., i])
        if self.matrix is not None:
            result[..., self.places, :] = self.matrix @ slope[..., self.places, :]
        return np.asarray(result)
