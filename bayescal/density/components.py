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
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from bayescal.numerics.geometry import Array

AT_ONCE: Final = 300_000  # numbers of the covariances that are factorised together: they stay in the cache


@dataclass(frozen=True, eq=False)
class White:
    """S of one vector of variances, factorised."""

    factor: Array  # (M, M): lower Cholesky factor, M = P n

    def rows(self, seen: Array) -> Array:
        """Return white rows of (M, ...)."""
        return np.asarray(solve_triangular(self.factor, seen, lower=True, check_finite=False))

    def solve(self, seen: Array) -> Array:
        """Return S⁻¹ times (M, ...)."""
        return np.asarray(cho_solve((self.factor, True), seen, check_finite=False))

    @cached_property
    def inverse(self) -> Array:
        """S⁻¹, shape (M, M)."""
        return self.solve(np.eye(len(self.factor)))

    @property
    def half_log_det(self) -> float:
        """½ log |S|."""
        return float(np.log(np.diag(self.factor)).sum())


@dataclass(frozen=True, eq=False)
class Components:
    """Covariances of P poses with n rows each.

    Attributes
    ----------
    known : ndarray, shape (P, n, n)
        K.
    blocks : ndarray, shape (G, P, n, n)
        B_g.
    parts : ndarray, shape (C, M, M)
        E_t, with M = P n.
    """

    known: Array
    blocks: Array
    parts: Array

    @property
    def size(self) -> int:
        """Number M of rows."""
        return self.known.shape[0] * self.known.shape[1]

    def covariances(self, variances: Array, more: int = 0) -> Array:
        """Return S of variances (B, G + C), shape (B, M + more, M + more), with room for more rows."""
        g = len(self.blocks)
        own = self.known + (variances[:, :g] @ self.blocks.reshape(g, -1)).reshape(-1, *self.known.shape)
        return assemble(own, self.parts, variances[:, g:], more)

    def factorise(self, variances: Array) -> White:
        """Return S of variances (G + C,)."""
        return White(cholesky(self.covariances(variances[None])[0], lower=True, check_finite=False))

    def weigh(self, variances: Array, rows: Array) -> Array:
        """Return normal log-densities of rows (B, M) but for 2 π, shape (B,), for variances (B, G + C)."""
        found = np.empty(len(rows))
        for part in batches(len(rows), self.size):
            found[part] = weigh(self.covariances(variances[part], 1), rows[part])
        return found

    def weigh_each(self, variances: Array, rows: Array) -> tuple[Array, Array]:
        """Return log p(e_n | all other rows) but for 2 π of each pose and its squared deviation, shapes (B, P)."""
        return weigh_each(self.covariances(variances), rows, len(self.known))

    def leave_out(self, variances: Array, rows: Array) -> tuple[Array, Array]:
        """Return by how much each pose's rows deviate from what all others predict, (B, P, n), and their precision."""
        return leave_out(self.covariances(variances), rows, len(self.known))

    def act(self, alpha: Array) -> Array:
        """Return B_g α and E_t α, (M,) to (G + C, M)."""
        own = np.einsum("gpij,pj->gpi", self.blocks, alpha.reshape(self.known.shape[:2]))
        return np.concatenate([own.reshape(len(own), -1), self.parts @ alpha])

    def act_on_inverse(self, inverse: Array) -> Array:
        """Return S⁻¹ B_g and S⁻¹ E_t, (M, M) to (G + C, M, M)."""
        shape = self.known.shape[:2]
        own = np.einsum("mpi,gpij->gmpj", inverse.reshape(-1, *shape), self.blocks, optimize=True)
        return np.concatenate([own.reshape(len(own), *inverse.shape), inverse @ self.parts])


def batches(size: int, n_rows: int) -> list[slice]:
    """Return which of so many covariances of M rows are taken together."""
    most = max(1, AT_ONCE // n_rows**2)
    return [slice(k, k + most) for k in range(0, size, most)]


def assemble(own: Array, parts: Array, weights: Array, more: int = 0) -> Array:
    """Return block diagonal matrices plus weighted parts, with room for more rows.

    Parameters
    ----------
    own : ndarray, shape (B, P, n, n)
    parts : ndarray, shape (C, M, M)
        M = P n.
    weights : ndarray, shape (B, C)
    more : int

    Returns
    -------
    ndarray, shape (B, M + more, M + more)
    """
    n_poses, n, m = own.shape[1], own.shape[2], parts.shape[-1]
    total = np.zeros((len(weights), m + more, m + more))
    inner = total[:, :m, :m]
    inner[:] = (weights @ parts.reshape(-1, m * m)).reshape(-1, m, m)
    for p in range(n_poses):
        inner[:, p * n : (p + 1) * n, p * n : (p + 1) * n] += own[:, p]
    return total


CORNER: Final = 1e200  # larger than any square of white rows; what comes before it in a factor does not depend on it


def weigh(covariance: Array, rows: Array) -> Array:
    """Return normal log-densities of rows (B, M) but for 2 π, shape (B,); covariances (B, M + 1, M + 1) are used up.

    The rows are carried along as one more row of the matrix; in the factor it holds the white ones.
    """
    m = rows.shape[1]
    covariance[:, m, :m], covariance[:, :m, m], covariance[:, m, m] = rows, rows, CORNER
    factor = np.linalg.cholesky(covariance)
    white = factor[:, m, :m]
    half_log_det = np.log(np.diagonal(factor, axis1=1, axis2=2)[:, :m]).sum(axis=1)
    return np.asarray(-half_log_det - 0.5 * np.einsum("bm,bm->b", white, white))


def leave_out(covariance: Array, rows: Array, n_poses: int) -> tuple[Array, Array]:
    """Return by how much each pose's rows deviate from what all others predict, and their precision then.

    With A = S⁻¹ and α = A e the density of e_n given the others is normal with precision A_nn, shape (B, P, n, n), and
    its deviation from its mean is A_nn⁻¹ α_n, shape (B, P, n).
    """
    shape = n_poses, rows.shape[1] // n_poses
    inverse = np.linalg.inv(covariance)
    alpha = (inverse @ rows[..., None]).reshape(-1, *shape)
    precision = np.einsum("bpipj->bpij", inverse.reshape(-1, *shape, *shape))
    return np.linalg.solve(precision, alpha[..., None])[..., 0], precision


def weigh_each(covariance: Array, rows: Array, n_poses: int) -> tuple[Array, Array]:
    """Return log p(e_n | all other rows) but for 2 π of each pose and its squared deviation, shapes (B, P)."""
    deviation, precision = leave_out(covariance, rows, n_poses)
    square = np.einsum("bpi,bpij,bpj->bp", deviation, precision, deviation)
    return 0.5 * np.linalg.slogdet(precision)[1] - 0.5 * square, square


class LinearRows(NamedTuple):
    """Rows as a linear model of the geometry, with a covariance S that depends on the errors."""

    residual: Array  # (M,)
    slope: Array  # (M, m)
    information: Array  # (m, m): of rows that do not depend on the errors
    pull: Array  # (m,): their gradient
    factorise: Callable[[Array], White]  # from coordinates ζ (k,) of the errors to S


class GeometryGiven(NamedTuple):
    """Geometry given what is unknown of the errors, to first order about a machine: normal."""

    mean: Array  # (m,)
    covariance: Array  # (m, m)
    log_mass: float  # density of the errors' unknowns alone, their prior included, but for a constant


@dataclass(frozen=True, eq=False)
class LinearGeometry:
    """Geometry whose rows and prior are linear about a machine.

    Attributes
    ----------
    centre : ndarray, shape (m,)
        The machine's coordinates.
    rows : LinearRows
    precision, pull : ndarray, shapes (m, m) and (m,)
        Minus the Hessian and the gradient there of the prior and of all rows that do not depend on the errors.
    log_prior : callable
        The log-prior of coordinates ζ (k,) of the errors.
    sizes : callable
        From ζ (B, k) to the errors in their own units.
    """

    centre: Array
    rows: LinearRows
    precision: Array
    pull: Array
    log_prior: Callable[[Array], float]
    sizes: Callable[[Array], Array]

    def given(self, zeta: Array) -> GeometryGiven:
        """Return the geometry given ζ (k,): with J of the white rows e, H = P + JᵀJ and mean H⁻¹ (p - Jᵀ e)."""
        white, m = self.rows.factorise(zeta), len(self.pull)
        both = white.rows(np.column_stack([self.rows.slope, self.rows.residual]))
        slope, residual = both[:, :m], both[:, m]
        factor = cholesky(self.precision + slope.T @ slope, lower=True, check_finite=False)
        inverse = solve_triangular(factor, np.eye(m), lower=True, check_finite=False)
        step = inverse @ (self.pull - slope.T @ residual)
        log_mass = 0.5 * (step @ step - residual @ residual) - white.half_log_det - np.log(np.diag(factor)).sum()
        mean = self.centre + inverse.T @ step
        return GeometryGiven(mean, inverse.T @ inverse, float(log_mass) + self.log_prior(zeta))

    def log_mass(self, zeta: Array) -> float:
        """Return the density of the errors' unknowns alone at ζ (k,), but for a constant."""
        return self.given(zeta).log_mass
