"""Actuator directions as circles about the legs.

Without a free κ the poses tell one thing of a direction u: the gain along the leg, w = u · z. Directions of one gain
lie on a circle of the unit sphere about z, which in (u_x, u_y) is a strongly curved ridge. In (w, ψ), with ψ the
azimuth about z, it is straight, and w and ψ measure area on the sphere: du_x du_y = u_z dw dψ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.numerics.geometry import Array

CLEARANCE = 3.0  # prior sds between a direction and its leg, below which the azimuth means nothing


@dataclass(frozen=True, eq=False)
class DirectionCircles:
    """The map between directions and (w, ψ) for K legs; ψ counts from the nominal direction.

    Attributes
    ----------
    axis, radial, tangential : ndarray, shape (K, 3)
        Orthonormal frame of each leg: along it, towards the nominal direction, and across.
    gain, sine : ndarray, shape (K,)
        Cosine and sine of the nominal angle between direction and leg.
    """

    axis: Array
    radial: Array
    tangential: Array
    gain: Array
    sine: Array

    def directions(self, w: Array, psi: Array) -> tuple[Array, Array]:
        """Return u_x and u_y, shapes (..., K); NaN where u does not exist or does not point upwards."""
        with np.errstate(invalid="ignore"):
            sine = np.sqrt(1.0 - w * w)
        around = np.cos(psi)[..., None] * self.radial + np.sin(psi)[..., None] * self.tangential
        u = w[..., None] * self.axis + sine[..., None] * around
        upward = u[..., 2] > 0
        return np.where(upward, u[..., 0], np.nan), np.where(upward, u[..., 1], np.nan)

    def polar(self, u: Array) -> tuple[Array, Array]:
        """Return w and ψ of unit vectors (..., K, 3)."""
        w, across = (np.einsum("...k,...k->...", u, e) for e in (self.axis, self.tangential))
        return w, np.arctan2(across, np.einsum("...k,...k->...", u, self.radial))

    def slopes(self, u: Array) -> tuple[Array, Array]:
        """Return d(u_x, u_y)/dw and d(u_x, u_y)/dψ, shapes (K, 2), at unit vectors (K, 3)."""
        w, _ = self.polar(u)
        square = 1.0 - w * w
        by_w = self.axis - (w / square)[:, None] * (u - w[:, None] * self.axis)
        return by_w[:, :2], np.cross(self.axis, u)[:, :2]


def find_circles(directions: Array, legs: Array, sd: Array) -> tuple[np.ndarray, DirectionCircles]:
    """Return which of K legs have a circle, shape (K,), and the circles of those.

    Parameters
    ----------
    directions, legs : ndarray, shape (K, 3)
        Nominal unit directions and leg vectors.
    sd : ndarray, shape (K,)
        Prior standard deviation of a direction.
    """
    axis = legs / np.linalg.norm(legs, axis=1, keepdims=True)
    gain = np.einsum("ik,ik->i", directions, axis)
    sine = np.linalg.norm(directions - gain[:, None] * axis, axis=1)
    clear = sine > CLEARANCE * sd
    return clear, frame_circles(directions[clear], legs[clear])


def frame_circles(directions: Array, legs: Array) -> DirectionCircles:
    """Return the circles through nominal unit directions (K, 3) about legs (K, 3) that these do not point along."""
    axis = legs / np.linalg.norm(legs, axis=1, keepdims=True)
    gain = np.einsum("ik,ik->i", directions, axis)
    across = directions - gain[:, None] * axis
    sine = np.linalg.norm(across, axis=1)
    radial = across / sine[:, None]
    return DirectionCircles(axis, radial, np.cross(axis, radial), gain, sine)
