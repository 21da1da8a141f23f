"""Eliminating poses: least squares of a few coordinates at many poses at once, by entries or by singular values.

H (..., K, q) is white; K readings, q coordinates.
"""

from __future__ import annotations

import numpy as np

from bayescal.numerics.geometry import Array

SINGULAR = 1e-14  # of a column's square, below which the others leave nothing of it
RANK = 1e-7  # of the largest singular value of H, below which a pose is not told


def half_log_volume(slope: Array) -> Array:
    """Return ½ log |HᵀΣ⁻¹H| for white H (..., K, q)."""
    if not slope.shape[-1]:
        return np.zeros(slope.shape[:-2])
    with np.errstate(all="ignore"):
        factor = factorise(slope)
        return np.asarray(sum(np.log(factor[k][k]) for k in range(slope.shape[-1])))


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
        left = error - sum(slope[..., i] * step[..., i, None] for i in range(slope.shape[-1]))
    return step, np.asarray(left)


def solve_step(slope: Array, factor: list[list[Array]], error: Array) -> tuple[Array, Array]:
    """Return the same step from H and the factor of HᵀH, and by how much white readings move with it, |H v| (...)."""
    q = slope.shape[-1]
    solved: list[Array] = []
    with np.errstate(all="ignore"):
        for i in range(q):
            side = np.einsum("...k,...k->...", slope[..., i], error) - sum(factor[i][k] * solved[k] for k in range(i))
            solved.append(side / factor[i][i])
        length = np.sqrt(sum(one * one for one in solved))
        for i in reversed(range(q)):
            solved[i] = (solved[i] - sum(factor[k][i] * solved[k] for k in range(i + 1, q))) / factor[i][i]
    return np.stack(solved, axis=-1), length


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
