"""Cholesky factors of many small covariances at once, column by column: those of all poses and batch entries."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.numerics.geometry import Array
from bayescal.numerics.scratch import Scratch


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
