"""Directions that data leave loose, and how those that they hold follow them: a shear by a quadratic.

Data that do not tell where a frame stands let it turn as far as tolerances do; what they hold sharply, other frames
and places seen in them, goes along on an arc. To first order it leaves on the tangent, many of its own posterior
standard deviations off. From the mode the loose directions U are gone along, one and two at a time, and those that are
held, T, follow to where the density is largest. The quadratic that this gives is a shear of unit volume,

    T = T_0 + Σ_ij β_ij U_i U_j .

Places on arcs of turns that no data see (`tests/inference/test_loose.py`) need it: without it none of the draws counts,
and the evidence is 0.57 nats low (`benchmarks/ablation`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from bayescal.inference.target import LogDensity
from bayescal.numerics.geometry import Array

LOOSE: Final = 0.25  # share of the prior variance that is left, above which a direction is loose
MOST_LOOSE: Final = 6  # directions: those along which others move most
FAR: Final = 1.5  # posterior sds gone along each
NEWTON_STEPS: Final = 2  # of those that follow
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
    _, precision = differentiate_geometry(posterior, y)
    try:  # a factor of the covariance first: what data hold may be so by a millionth of the prior and less
        factor = np.linalg.cholesky(precision)
    except np.linalg.LinAlgError:
        return None
    root = np.linalg.inv(factor).T
    variance, turn = np.linalg.eigh(root.T @ root)
    loose = np.flatnonzero(variance > LOOSE)
    if not 0 < len(loose) < m:
        return None
    basis, inverse = root @ turn, turn.T @ factor.T
    if len(loose) > MOST_LOOSE:
        alone = _Followers(posterior, y, basis, loose)
        moved = [np.linalg.norm(alone.follow(one) + alone.follow(-one)) for one in FAR * np.eye(len(loose))]
        loose = loose[np.argsort(moved)[-MOST_LOOSE:]]
    found = _Followers(posterior, y, basis, loose)
    places = _list_places(len(loose))
    # what both sides have in common is even in the place
    moves = np.array([0.5 * (found.follow(one) + found.follow(-one)) for one in places])
    if not np.isfinite(moves).all():
        return None
    bent = np.linalg.lstsq(multiply(places), moves, rcond=None)[0]
    if np.abs(bent).max() < BENT:
        return None
    order = np.concatenate([loose, found.held])
    return LooseShear(y[:m].copy(), basis[:, order], inverse[order], bent)


def differentiate_geometry(posterior: LogDensity, y: Array) -> tuple[Array, Array]:
    """Return the log-density's gradient (m,) by the geometry at y (n,), and minus its Hessian, of linear rows there."""
    m, linear = posterior.n_geometry, posterior.linear_geometry(y)
    if linear is None:
        gradient, hessian = posterior.gradient(y)
        return gradient[:m], -hessian[:m, :m]
    found = linear.solve(y[None, m:])  # many times as fast: errors are not differentiated
    factor = np.tril(found.factor[0])
    return factor @ found.white[0, :, 0], factor @ factor.T


def _list_places(u: int) -> Array:
    """Return places to go to, with their opposites: along each of u axes, and between two of them."""
    first, second = np.triu_indices(u, 1)
    between = np.zeros((2, len(first), u))
    for side, sign in zip(between, (1.0, -1.0), strict=True):
        side[np.arange(len(first)), first] = np.sqrt(0.5)
        side[np.arange(len(first)), second] = sign * np.sqrt(0.5)
    return FAR * np.concatenate([np.eye(u), *between])


@dataclass(frozen=True, eq=False)
class _Followers:
    """Where the directions that data hold are best, given the loose ones."""

    posterior: LogDensity
    y: Array  # (n,): the mode
    basis: Array  # (m, m): axes of one posterior sd in columns
    loose: np.ndarray  # (u,): which of them are given

    @cached_property
    def held(self) -> np.ndarray:
        return np.setdiff1d(np.arange(len(self.basis)), self.loose)

    def follow(self, place: Array) -> Array:
        """Return how far the others are best off the mode at a place (u,) of the loose ones, (m - u,).

        NaN where the density has no slope on the way.
        """
        m, at, own = len(self.basis), self.y.copy(), self.basis[:, self.held]
        at[:m] += self.basis[:, self.loose] @ place
        moved = np.zeros(len(self.held))
        for _ in range(NEWTON_STEPS):
            gradient, precision = differentiate_geometry(self.posterior, at)
            if not (np.isfinite(gradient).all() and np.isfinite(precision).all()):  # LAPACK prints a line of its own
                return np.full(len(self.held), np.nan)
            step = np.linalg.lstsq(own.T @ precision @ own, own.T @ gradient, rcond=None)[0]
            moved += step
            at[:m] += own @ step
        return moved
