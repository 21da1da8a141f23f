"""Readings made independent and of unit noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.numerics.geometry import Array

FEW = 16


@dataclass(frozen=True, eq=False)
class Whitening:
    """What makes readings of C machines at P poses independent and of unit noise, those not taken zero.

    Attributes
    ----------
    diagonal : ndarray, shape (C, P, K)
        One over the deviation of readings whose noise is their own, zero for the others.
    matrix : ndarray, shape (C or 1, P, k, k), or None
        Of those whose noise depends on each other, which stand at ``places``.
    places : ndarray of int, shape (k,)
    log_det : ndarray, shape (C, P)
        Of the whitening, of the readings taken.
    """

    diagonal: Array
    matrix: Array | None
    places: np.ndarray
    log_det: Array

    def pick(self, some: np.ndarray | slice) -> Whitening:
        """Return that of some of the machines."""
        matrix = self.matrix if self.matrix is None or len(self.matrix) == 1 else self.matrix[some]
        return Whitening(self.diagonal[some], matrix, self.places, self.log_det[some])

    def vector(self, error: Array) -> Array:
        """Return white errors (C, P, K)."""
        result = self.diagonal * error
        if self.matrix is not None:
            result[..., self.places] = (self.matrix @ error[..., self.places, None])[..., 0]
        return np.asarray(result)

    def colour(self, white: Array) -> Array:
        """Return errors of readings (C, P, K) from white ones; those not taken stay zero."""
        result = np.where(self.diagonal > 0, white / np.where(self.diagonal > 0, self.diagonal, 1.0), 0.0)
        if self.matrix is not None:
            result[..., self.places] = np.linalg.solve(self.matrix, white[..., self.places, None])[..., 0]
        return np.asarray(result)

    def rows(self, slope: Array) -> Array:
        """Return white derivatives (C, P, K, n)."""
        if slope.shape[-1] > FEW:
            result = self.diagonal[..., None] * slope
        else:  # column by column: a last axis that short is slow
            shape = np.broadcast_shapes(self.diagonal.shape, slope.shape[:-1])
            result = np.empty((*shape, slope.shape[-1]))
            for i in range(slope.shape[-1]):
                np.multiply(self.diagonal, slope[..., i], out=result[..., i])
        if self.matrix is not None:
            result[..., self.places, :] = self.matrix @ slope[..., self.places, :]
        return np.asarray(result)
