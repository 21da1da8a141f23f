"""A posterior around a point: what the search for its mode, and the straightening of its coordinates, go by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bayescal.numerics.geometry import Array


class Local(NamedTuple):
    """A posterior's likelihood around a point.

    Attributes
    ----------
    theta : ndarray, shape (D,)
    errors, slope : ndarray, shapes (P, K), (P, K, m)
        r and dr/dy.
    precision : ndarray, shape (P, K, K)
        Of r, as far as each pose counts.
    change : ndarray, shape (D, m)
        dθ/dy.
    counts : ndarray, shape (P,), optional
        How much each pose counts; None where all count in full.
    """

    theta: Array
    errors: Array
    slope: Array
    precision: Array
    change: Array
    counts: Array | None = None

    @property
    def weighted(self) -> Array:
        """C⁻¹ r, shape (P, K)."""
        return np.asarray((self.precision @ self.errors[..., None])[..., 0])

    @property
    def square(self) -> Array:
        """rᵀ C⁻¹ r of each pose as far as it counts, shape (P,)."""
        return np.einsum("pi,pi->p", self.errors, self.weighted)

    def inform(self) -> Array:
        """Return the information of the data on the geometry, shape (m, m)."""
        m = self.slope.shape[-1]
        return np.asarray(self.slope.reshape(-1, m).T @ (self.precision @ self.slope).reshape(-1, m))


def turn_to_coordinates(slope: Array, change: Array) -> Array:
    """Return derivatives by y, (P, K, m), from those by θ, (P, K, D), and dθ/dy (D, m): one product for all rows."""
    return np.asarray((slope.reshape(-1, len(change)) @ change).reshape(*slope.shape[:-1], change.shape[1]))


def root_of(matrix: Array) -> tuple[Array, Array]:
    """Return the symmetric square roots of positive definite matrices (..., N, N), and their inverses."""
    values, vectors = np.linalg.eigh(matrix)
    root = np.sqrt(values)[..., None, :]
    return (vectors * root) @ np.swapaxes(vectors, -1, -2), (vectors / root) @ np.swapaxes(vectors, -1, -2)


@dataclass(frozen=True, eq=False)
class Funnel:
    """How the geometry depends on the model errors around a point; see `bayescal.inference.target.Funnel`."""

    information: Array
    prior: Array
    rest: Array
    tau: Array
    parts: Array | None = None
    scores: Array | None = None
