"""Readings made independent and of unit noise."""

from __future__ import annotations

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
