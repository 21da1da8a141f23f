"""What the best poses leave of readings: the part that no pose explains, from which machines are told apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class LeftOver:
    """What B machines leave of the readings of P poses.

    Attributes
    ----------
    error : ndarray, shape (B, P, K)
        White: in units of the noise, without correlation; zero where there is no reading.
    slope : ndarray, shape (B, P, K, q)
        H, white.
    present : ndarray of bool, shape (P, K)
    freedom : float
        ν of a robust density, infinite for a normal one.
    whiten, colour : callable
        From errors of readings to white ones, (..., P, K), and back.
    """

    error: Array
    slope: Array
    present: np.ndarray
    freedom: float
    whiten: Callable[[Array], Array]
    colour: Callable[[Array], Array]

    def draw_noise(self, rng: np.random.Generator) -> Array:
        """Return white noise of the readings, (B, P, K)."""
        noise = rng.standard_normal(self.error.shape)
        if np.isfinite(self.freedom):
            noise *= np.sqrt(self.freedom / rng.chisquare(self.freedom, noise.shape[:2]))[..., None]
        return np.where(self.present, noise, 0.0)

    def remove_poses(self, white: Array) -> Array:
        """Return white errors (B, P, K) without what poses explain, all by the H of the first machine."""
        basis = np.linalg.qr(self.slope[0])[0]
        return white - np.einsum("pkq,pjq,...pj->...pk", basis, basis, white, optimize=True)

    def measure(self, white: Array) -> Array:
        """Return the size of what is left, (..., P, K) to (..., P), rms over the readings beyond what a pose needs."""
        spare = self.present.sum(axis=1) - self.slope.shape[-1]
        return np.sqrt(np.sum(white**2, axis=-1) / np.maximum(spare, 1))
