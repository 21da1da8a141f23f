"""Practical identifiability: information of the planned measurements against what is known a priori.

In units of the tolerances the prior is a standard normal and the measurements have the information Λ; the posterior is
then N(0, (1 + Λ)⁻¹) to first order. Contraction of a direction v is 1 - vᵀ(1 + Λ)⁻¹v, and -½ log(1 - contraction) nats
are what is learnt of it. Neither depends on units.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from bayescal.numerics.geometry import Array

UNSEEN = 1e-13  # of a scaled matrix: what rounding leaves of a coordinate that nothing tells of


@dataclass(frozen=True, eq=False)
class Information:
    """Information of a plan in units of the tolerances."""

    # (k, n): R with Λ = RᵀR, k not above n; everything is found from it, since squaring loses half of the digits
    root: Array
    # (q, n): K = (1 + VᵀV)⁻¹ VᵀR of q others of unit prior, by how much their estimates fall as parameters rise
    follow: Array | None = None

    @cached_property
    def matrix(self) -> Array:
        """Λ, shape (n, n)."""
        return self.root.T @ self.root

    def spectrum(self, space: Array | None = None) -> tuple[Array, Array]:
        """Return eigenvalues and eigenvectors of Λ in a space (n, k) with orthonormal columns, smallest first."""
        n = self.root.shape[1]
        basis = np.eye(n) if space is None else space
        seen = self.root @ basis
        padded = np.concatenate([seen, np.zeros((max(0, basis.shape[1] - len(seen)), basis.shape[1]))])
        _, values, vectors = np.linalg.svd(padded, full_matrices=False)
        return values[::-1] ** 2, basis @ vectors[::-1].T

    @cached_property
    def covariance(self) -> Array:
        """Posterior covariance in units of the tolerances, shape (n, n)."""
        values, vectors = self.spectrum()
        return np.asarray((vectors / (1.0 + values)) @ vectors.T)

    @cached_property
    def contraction(self) -> Array:
        """Contraction of each parameter, shape (n,)."""
        return 1.0 - np.diagonal(self.covariance)

    def contraction_along(self, directions: Array) -> Array:
        """Return the contraction along directions (n, k), shape (k,); their lengths do not matter."""
        unit = directions / np.linalg.norm(directions, axis=0)
        return 1.0 - np.einsum("ik,ij,jk->k", unit, self.covariance, unit)

    def join(self, errors: Array, free: tuple[int, ...] | None = None) -> Array:
        """Return a covariance (n, n) of errors of the parameters with that of the others as they are, (n + q, n + q).

        Parameters err by θ - θ̂ = ... - G XᵀS⁻¹V u, G being the covariance of those that are fitted: what they take up
        of the others they have with the opposite sign. By default all are fitted.
        """
        if self.follow is None:
            return errors
        gain = np.zeros_like(errors)
        if free is None:
            gain = self.covariance
        elif free:
            inner = np.ix_(free, free)
            gain[inner] = np.linalg.inv(self.matrix[inner] + np.eye(len(free)))
        across = -gain @ self.follow.T
        return np.block([[errors, across], [across.T, np.eye(len(self.follow))]])

    @cached_property
    def joint(self) -> Array:
        """Posterior covariance of the parameters with that of the others as they are, (n + q, n + q)."""
        return self.join(self.covariance)

    def errors_of_reduced(self, free: tuple[int, ...]) -> Array:
        """Return the covariance (n, n) of the errors where some parameters are fitted and the others taken for nominal.

        The others are off by their tolerances all the same; what is fitted takes up what it can of that:
        with K = (1 + Λ_ff)⁻¹ its errors are K z_f - K Λ_fo z_o - K R_fᵀ ε.
        """
        n = self.root.shape[1]
        chosen, others = np.array(free, dtype=int), np.setdiff1d(np.arange(n), free)
        inner = np.linalg.inv(self.matrix[np.ix_(chosen, chosen)] + np.eye(len(chosen)))
        across = inner @ self.matrix[np.ix_(chosen, others)]
        result = np.eye(n)
        result[np.ix_(chosen, chosen)] = inner + across @ across.T
        result[np.ix_(chosen, others)], result[np.ix_(others, chosen)] = -across, -across.T
        return result

    @property
    def nats(self) -> float:
        """All that the measurements tell, ½ log det(1 + Λ)."""
        return 0.5 * float(np.log1p(self.spectrum()[0]).sum())


def information_of_rows(rows: Array, sd: Array) -> Information:
    """Return the information of an identification Jacobian (..., n) in units of the noise, with tolerances (n,)."""
    return Information(np.linalg.qr(rows.reshape(-1, rows.shape[-1]) * sd, mode="r"))


def marginalise(rows: Array, others: Array, signs: Array | None = None) -> Information:
    """Return the information of rows (K, n) on their parameters, given others (K, q) of unit prior with rows V.

    With Q R a factorisation of (V X; 1 0), R = (R_cc R_cθ; 0 R_θθ), it is R_θθᵀ R_θθ = Xᵀ (1 + V Vᵀ)⁻¹ X, all digits
    of which are kept. Others with a negative sign, (q,), take W Wᵀ away from the covariance: they add B (1 - D)⁻¹ Bᵀ
    with (X W)ᵀ (1 + V Vᵀ)⁻¹ (X W) = (A B; Bᵀ D), and nothing is said of how others follow.
    """
    if signs is not None:
        n, less = rows.shape[1], signs < 0.0
        found = marginalise(np.concatenate([rows, others[:, less]], axis=1), others[:, ~less]).root
        own, taken = found[:, :n], found[:, n:]
        left = np.linalg.cholesky(np.eye(taken.shape[1]) - taken.T @ taken)
        return Information(np.linalg.qr(np.concatenate([own, np.linalg.solve(left, taken.T @ own)]), mode="r"))
    q = others.shape[1]
    stacked = np.block([[others, rows], [np.eye(q), np.zeros((q, rows.shape[1]))]])
    root = np.linalg.qr(stacked, mode="r")
    return Information(root[q:, q:], solve_triangular(root[:q, :q], root[:q, q:]))


def nats_from_contraction(contraction: Array) -> Array:
    """Return what a contraction is worth in nats."""
    return np.asarray(-0.5 * np.log1p(-np.minimum(contraction, 1.0 - 1e-16)))


def complement_of(space: Array) -> Array:
    """Return an orthonormal basis of what is orthogonal to a space, both with orthonormal columns, (n, n - k)."""
    n, k = space.shape
    return np.asarray(np.linalg.svd(space, full_matrices=True)[0][:, k:]) if k else np.eye(n)


def root_of(matrix: Array) -> Array:
    """Return the roots R of positive semi-definite matrices that are symmetric but for units, RᵀR = M, (..., k, k).

    Unlike a factor from an eigendecomposition it hangs continuously together with M, so that Jacobians can be compared.
    """
    symmetric = 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
    scale = np.sqrt(np.maximum(np.diagonal(symmetric, axis1=-2, axis2=-1), 0.0))
    scale = np.where(scale > 0.0, scale, 1.0)[..., None]  # mm and rad side by side: first without units
    values, vectors = np.linalg.eigh(symmetric / scale / np.swapaxes(scale, -1, -2))
    values = np.where(values > UNSEEN, values, 0.0)
    half = (vectors * np.sqrt(values)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return half * np.swapaxes(scale, -1, -2)
