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

from bayescal.density.linear_gaussian import ConditionalNormal, condition
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


class LinearRows(NamedTuple):
    """Rows as a linear model of the geometry, with a covariance S that depends on the errors."""

    information: Array  # (m, m): of rows that do not depend on the errors
    pull: Array  # (m,): their gradient
    # from ζ (B, k) of the errors to XᵀS⁻¹X, (B, m + 1, m + 1), of slopes and residuals side by side, and (B,) of
    # ½ log |S|
    square: Callable[[Array], tuple[Array, Array]]


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

    def given(self, zeta: Array) -> tuple[Array, Array]:
        """Return mean (B, m) and covariance (B, m, m) of the geometry given ζ (B, k)."""
        found = self.solve(zeta)
        return self.centre + found.mean[..., 0], found.covariance

    def log_mass(self, zeta: Array) -> Array:
        """Return the density (B,) of the errors' unknowns alone at ζ (B, k), but for a constant."""
        return np.concatenate([self.solve(zeta[part]).log_marginal for part in batches(len(zeta), len(self.centre))])

    def solve(self, zeta: Array) -> ConditionalNormal:
        """Return the geometry's deviation from the centre given ζ (B, k); its marginal is the density of ζ alone."""
        (both, half_log_det), m = self.rows.square(zeta), len(self.pull)
        pull = self.pull[:, None] - both[:, :m, m:]
        constant = self.log_prior(zeta) - half_log_det
        return condition(self.precision + both[:, :m, :m], pull, both[:, m:, m:], constant)
