"""Directions that data leave loose, and how those that they hold follow them: a shear by a quadratic.

Data that do not tell where a frame stands let it turn as far as tolerances do; what they hold sharply, other frames
and places seen in them, goes along on an arc. To first order it leaves on the tangent, many of its own posterior
standard deviations off. In axes of one posterior standard deviation each, -log p has the third derivatives

    D_ijk = ½ (∂_i G_jk + ∂_j G_ik + ∂_k G_ij)

of least squares, G the information, and directions that are held, T, are best where they follow the loose ones, U, by
-½ D: the quadratic is a shear of unit volume,

    T = T_0 + Σ_ij β_ij U_i U_j .

Places on arcs of turns that no data see (`tests/inference/test_loose.py`) need it: without it none of the draws counts,
and the evidence is 0.57 nats low (`benchmarks/ablation`). So does an arm of six joints whose errors are all free, half
of which tolerances hold: of its draws one in a thousand counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from bayescal.inference.target import LogDensity
from bayescal.numerics.geometry import Array

LOOSE: Final = 0.01  # share of the prior variance that is left, above which a direction is loose
MOST_LOOSE: Final = 40  # directions: those along which others move most
APART: Final = 1.0  # posterior sds either side, of which information is differenced
BENT: Final = 0.1  # posterior sds of what follows, at a place one sd away, below which all is straight


@dataclass(frozen=True, eq=False)
class LooseShear:
    """The shear in a basis of the m coordinates of the geometry, whose first u axes are the loose ones.

    Attributes
    ----------
    centre : ndarray, shape (m,)
    basis, inverse : ndarray, shape (m, m)
        Axes in columns, and its inverse.
    bent : ndarray, shape (u (u + 1) / 2, m - u)
        How the other axes follow products of two loose ones.
    """

    centre: Array
    basis: Array
    inverse: Array
    bent: Array

    @cached_property
    def _n_loose(self) -> int:
        return len(self.centre) - self.bent.shape[1]

    def add_to(self, w: Array, sign: float) -> None:
        """Add the shear to vectors (B, n) in place, or take it away."""
        m, u = len(self.centre), self._n_loose
        place = (w[:, :m] - self.centre) @ self.inverse[:u].T
        w[:, :m] += sign * (multiply(place) @ self.bent) @ self.basis[:, u:].T


def multiply(place: Array) -> Array:
    """Return all products of two of u numbers, (B, u) to (B, u (u + 1) / 2)."""
    first, second = np.triu_indices(place.shape[1])
    return np.asarray(place[:, first] * place[:, second])


def fit_loose_shear(posterior: LogDensity, y: Array) -> LooseShear | None:
    """Return the shear of a posterior about its mode (n,); None where nothing is loose, held, or bent."""
    m = posterior.n_geometry
    try:  # a factor of the covariance first: what data hold may be so by a millionth of the prior and less
        factor = np.linalg.cholesky(find_information(posterior, y))
    except np.linalg.LinAlgError:
        return None
    root = np.linalg.inv(factor).T
    variance, turn = np.linalg.eigh(root.T @ root)
    loose, held = np.flatnonzero(variance > LOOSE), np.flatnonzero(variance <= LOOSE)
    if not (len(loose) and len(held)):
        return None
    basis, inverse = root @ turn, turn.T @ factor.T
    change, away = np.empty((m, m, m)), y.copy()
    for own, axis in zip(change, APART * basis.T, strict=True):
        sides = np.empty((2, m, m))
        for side, sign in zip(sides, (1.0, -1.0), strict=True):
            away[:m] = y[:m] + sign * axis
            side[:] = find_information(posterior, away)
        own[:] = basis.T @ (sides[0] - sides[1]) @ basis / (2.0 * APART)
    third = 0.5 * (change + np.moveaxis(change, 0, 1) + np.moveaxis(change, 0, 2))
    if not np.isfinite(third).all():
        return None
    if len(loose) > MOST_LOOSE:
        loose = loose[np.argsort(np.linalg.norm(third[np.ix_(loose, loose, held)], axis=(1, 2)))[-MOST_LOOSE:]]
        held = np.setdiff1d(np.arange(m), loose)
    first, second = np.triu_indices(len(loose))
    bent = -third[loose[first], loose[second]][:, held] * np.where(first == second, 0.5, 1.0)[:, None]
    if np.abs(bent).max() < BENT:
        return None
    order = np.concatenate([loose, held])
    return LooseShear(y[:m].copy(), basis[:, order], inverse[order], bent)


def find_information(posterior: LogDensity, y: Array) -> Array:
    """Return the geometry's information (m, m) at y (n,), by linear rows where there are any."""
    linear = posterior.linear_geometry(y)
    if linear is None:
        return -posterior.gradient(y)[1][: posterior.n_geometry, : posterior.n_geometry]
    factor = np.tril(linear.solve(y[None, posterior.n_geometry :]).factor[0])  # errors are not differentiated
    return factor @ factor.T
