"""Readings made independent and of unit noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayescal.numerics.geometry import Array

FEW = 16


@dataclass(frozen=True, eq=False)
class Whitening:
    """What makes readings of C machines at P poses independent and of unit noise, those not taken zero.

    ``diagonal`` (C, P, K), or ``matrix`` (C, P, K, K) where the noise is correlated; ``log_det`` (C, P) is that of the
    whitening, of the readings taken.
    """

    diagonal: Array | None
    matrix: Array | None
    log_det: Array

    def pick(self, some: np.ndarray | slice) -> Whitening:
        """Return that of some of the machines."""
        diagonal = None if self.diagonal is None else self.diagonal[some]
        return Whitening(diagonal, None if self.matrix is None else self.matrix[some], self.log_det[some])

    def vector(self, error: Array) -> Array:
        """Return white errors (C, P, K)."""
        if self.diagonal is not None:
            return np.asarray(self.diagonal * error)
        assert self.matrix is not None
        return np.asarray((self.matrix @ error[..., None])[..., 0])

    def colour(self, white: Array) -> Array:
        """Return errors of readings (C, P, K) from white ones; those not taken stay zero."""
        if self.diagonal is not None:
            return np.where(self.diagonal > 0, white / np.where(self.diagonal > 0, self.diagonal, 1.0), 0.0)
        assert self.matrix is not None
        return np.asarray(np.linalg.solve(self.matrix, white[..., None])[..., 0])

    def rows(self, slope: Array) -> Array:
        """Return white derivatives (C, P, K, n)."""
        if self.diagonal is not None and slope.shape[-1] > FEW:
            return np.asarray(self.diagonal[..., None] * slope)
        if self.diagonal is not None:  # column by column: a last axis that short is slow
            shape = np.broadcast_shapes(self.diagonal.shape, slope.shape[:-1])
            result = np.empty((*shape, slope.shape[-1]))
            for i in range(slope.shape[-1]):
                np.multiply(self.diagonal, slope[..., i], out=result[..., i])
            return result
        assert self.matrix is not None
        return np.asarray(self.matrix @ slope)


@dataclass(frozen=True, eq=False)
class WhiteResiduals:
    """Residuals of the readings of P poses with B machines: what no pose explains.

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
        """Return the size of residuals, (..., P, K) to (..., P), rms over the readings beyond what a pose needs."""
        spare = self.present.sum(axis=1) - self.slope.shape[-1]
        return np.sqrt(np.sum(white**2, axis=-1) / np.maximum(spare, 1))
