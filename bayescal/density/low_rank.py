"""The density of the legs' errors at many poses, for many machines at once: by columns of a factor, or of low rank.

Many legs need no matrix of all of them: each errs by itself, but for the six of the pose. Of N legs' errors r,
C = D + U Uᵀ with D diagonal, from actuators, deformations and model errors, and U = A⁰ L of six columns, Σ = L Lᵀ, from
the measured pose. By Woodbury's identity and the determinant's lemma with M = 1 + Uᵀ D⁻¹ U,

    rᵀ C⁻¹ r = rᵀ D⁻¹ r - vᵀ M⁻¹ v,   v = Uᵀ D⁻¹ r,   log det C = log det D + log det M,

which grows with N where a factor of C grows with its cube. With six legs nothing is gained, and digits are lost where D
is tiny beside U Uᵀ: then there is no such form, as where actuators' errors are seen by other legs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array
from bayescal.numerics.scratch import Scratch

FEWEST_LEGS = 10
SMALLEST = 1e-5
"""Share of the covariance that D has to have: five of sixteen digits may be lost."""
DIAGONAL = 1e-12
"""Share that may stand beside the diagonal."""
PAIRS = np.tril_indices(DEGREES_OF_FREEDOM)


def factor_by_columns(
    known: Array, add: Callable[[int], Array], errors: Array, scratch: Scratch
) -> tuple[Array, Array]:
    """Return log-densities but for 2 π, and rᵀ C⁻¹ r; Cholesky factors of all poses and batch entries, by columns.

    The errors are carried along as one more row of the matrix; in the factor that row holds the whitened errors.

    Parameters
    ----------
    known : ndarray, shape (P, N, N)
        Covariance but for the model error.
    add : callable
        From a leg to the variance that its model error adds, shape (P, B).
    errors : ndarray, shape (N, P, B)
    scratch : Scratch

    Returns
    -------
    ndarray, ndarray, shapes (P, B)
    """
    n = len(errors)
    factor = scratch.take("factor", n + 1, n, *errors.shape[1:])
    determinant = np.ones(errors.shape[1:])
    for j in range(n):
        column = factor[j:, j]
        own = known[:, j:, j].T[..., None]
        if j:
            np.einsum("ikpb,kpb->ipb", factor[j:, :j], factor[j, :j], out=column)
            np.subtract(own, column[:-1], out=column[:-1])
            np.subtract(errors[j], column[-1], out=column[-1])
        else:
            column[:-1], column[-1] = own, errors[j]
        column[0] += add(j)
        inverse = 1.0 / np.sqrt(column[0])
        column[1:] *= inverse
        determinant *= inverse
    square = np.einsum("kpb,kpb->pb", factor[n], factor[n])
    return np.log(determinant) - 0.5 * square, square


@dataclass(frozen=True, eq=False)
class LowRank:
    """Covariances of the legs' errors at P poses, but for the model error."""

    own: Array  # (P, N): D, mm²
    columns: Array  # (P, 6, N): Uᵀ, mm
    products: Array  # (P, 21, N): products of two of the columns, those of the lower triangle row by row

    def select(self, part: slice) -> LowRank:
        """Return those of some of the poses."""
        return LowRank(self.own[part], self.columns[part], self.products[part])

    def evaluate(self, add: Callable[[int], Array], errors: Array, scratch: Scratch) -> tuple[Array, Array]:
        """Return log-densities but for 2 π, and rᵀ C⁻¹ r, both (P, B); arguments as of `factor_by_columns`."""
        n_legs, n_poses, n_batch = errors.shape
        inverse = scratch.take("inverse", n_poses, n_legs, n_batch)
        for leg in range(n_legs):
            np.add(self.own[:, leg, None], add(leg), out=inverse[:, leg])
        log_det = np.log(inverse).sum(axis=1)
        np.reciprocal(inverse, out=inverse)
        seen = errors.transpose(1, 0, 2)
        scaled = np.multiply(seen, inverse, out=scratch.take("scaled", n_poses, n_legs, n_batch))
        square = np.einsum("pib,pib->pb", seen, scaled)
        factor = scratch.take("small", DEGREES_OF_FREEDOM + 1, DEGREES_OF_FREEDOM, n_poses, n_batch)
        inner = scratch.take("inner", n_poses, len(PAIRS[0]), n_batch)
        np.matmul(self.products, inverse, out=inner)
        factor[PAIRS] = inner.transpose(1, 0, 2)
        factor[-1] = (self.columns @ scaled).transpose(1, 0, 2)
        determinant = _factorise(factor)
        square -= np.einsum("kpb,kpb->pb", factor[-1], factor[-1])
        return np.log(determinant) - 0.5 * log_det - 0.5 * square, square


def _factorise(factor: Array) -> Array:
    """Take 1 + M (6, 6, ...) to its Cholesky factor, and one more row along; return the inverse of its determinant."""
    determinant = np.ones(factor.shape[2:])
    for j in range(DEGREES_OF_FREEDOM):
        column = factor[j:, j]
        column[0] += 1.0
        if j:
            column -= np.einsum("ikpb,kpb->ipb", factor[j:, :j], factor[j, :j])
        inverse = 1.0 / np.sqrt(column[0])
        column[1:] *= inverse
        determinant *= inverse
    return determinant


def find_low_rank(pose: Array, measured: Array, known: Array) -> LowRank | None:
    """Return a covariance in terms of six columns, None where it is not worth it or loses digits.

    Parameters
    ----------
    pose : ndarray, shape (P, N, 6)
        A⁰.
    measured : ndarray, shape (P, 6, 6)
        Σ, mm and rad.
    known : ndarray, shape (P, N, N)
        C but for the model error, mm².
    """
    if pose.shape[1] < FEWEST_LEGS:
        return None
    try:
        columns = np.swapaxes(pose @ np.linalg.cholesky(measured), -1, -2)
    except np.linalg.LinAlgError:
        return None
    rest = known - np.swapaxes(columns, -1, -2) @ columns
    own = np.diagonal(rest, axis1=-2, axis2=-1)
    largest = np.diagonal(known, axis1=-2, axis2=-1).max()
    beside = rest * ~np.eye(pose.shape[1], dtype=bool)
    if own.min() < SMALLEST * largest or np.abs(beside).max() > DIAGONAL * largest:
        return None
    return LowRank(own.copy(), columns, columns[:, PAIRS[0]] * columns[:, PAIRS[1]])
