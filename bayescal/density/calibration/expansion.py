"""Machines near one that was linearised: where their poses are, and what H is there, to first order in the parameters.

A posterior's machines differ by so little that H = ∂h/∂v along the poses that explain the readings is linear in the
parameters to a part in millions. H then costs one product of matrices in place of q directional derivatives of the
readings, and a pose that has it is found in one or two steps. How far this holds is measured, not assumed: the error of
the log-density is quadratic in the change M = H⁺ dH of the slopes, with a factor that trial machines give.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.numerics.geometry import Array

LARGEST = 2**24  # entries of the derivatives of H, 128 MB


@dataclass(frozen=True, eq=False)
class Expansion:
    """Poses and H of machines near an anchor of D parameters, at P poses of q coordinates with K readings.

    Attributes
    ----------
    anchor : ndarray, shape (D,)
    pose : ndarray, shape (P, q)
        Where the anchor explains the readings.
    slope : ndarray, shape (q, P, K)
        H there, not white.
    moves : ndarray, shape (D, P, q)
        How poses follow the parameters.
    close : float
        White readings that a pose may move by in a step that is taken to first order.
    free : ndarray of int, shape (F,)
        Which parameters may differ from the anchor's.
    bends : ndarray, shape (F, q, P, K), or None
        How H follows them; None where that is not known.
    metric : ndarray, shape (F, F)
        The square of M, summed over poses and coordinates, as a quadratic form of the parameters' change.
    limit : float
        Its value up to which H is good enough.
    """

    anchor: Array
    pose: Array
    slope: Array
    moves: Array
    close: float
    free: np.ndarray
    bends: Array | None
    metric: Array
    limit: float

    def measure(self, theta: Array) -> Array:
        """Return the square of the slopes' relative change for machines (C, D), shape (C,); infinite if not known."""
        change = theta - self.anchor
        own = change[:, self.free]
        square = np.einsum("ci,ci->c", own @ self.metric, own)
        alien = np.delete(change, self.free, axis=1).any(axis=1)
        return np.where(alien | (self.bends is None), np.inf, square)

    def predict(self, theta: Array) -> tuple[Array, Array]:
        """Return poses (C, P, q) and H (C, P, K, q), not white, of machines (C, D)."""
        change = theta - self.anchor
        pose = self.pose + (change @ self.moves.reshape(len(self.anchor), -1)).reshape(-1, *self.pose.shape)
        slope = np.broadcast_to(self.slope, (len(theta), *self.slope.shape))
        if self.bends is not None:
            slope = self.slope + (change[:, self.free] @ self.bends.reshape(len(self.free), -1)).reshape(slope.shape)
        return pose, np.moveaxis(slope, 1, -1)

    @property
    def by_parameter(self) -> Array:
        """How H follows the free parameters, not white, (F, P, K, q)."""
        assert self.bends is not None
        return np.moveaxis(self.bends, 1, -1)

    def pick(self, which: np.ndarray) -> Expansion:
        """Return that of some of the poses; of fewer ones it is as good."""
        bends = None if self.bends is None else self.bends[:, :, which]
        return replace(self, pose=self.pose[which], slope=self.slope[:, which], moves=self.moves[:, which], bends=bends)
