"""Readings whose errors are functions of the pose, by one covariance of all rows: fast where machines are much alike.

About a machine that explains the readings, H of the best poses hardly turns with the machine. With Z of orthonormal
columns that span what H leaves of a pose's white readings there, and poses flat along H,

    ∫ N(e; H v, R + A D Aᵀ) dv = N(Zᵀ e; 0, Zᵀ R Z + Zᵀ A D Aᵀ Z) |HᵀH|^(-1/2)

whatever the errors are that R and D stand for: rows Zᵀ e are free of the poses, and functions of one amplitude s add s²
times a matrix that is known beforehand (`bayescal.density.components`). That costs one factorisation of all rows, where
columns cost those of all coefficients, which are more wherever smooth functions are allowed for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cholesky

from bayescal.density.calibration.terms import Errors
from bayescal.density.components import LinearRows, White, assemble, batches, weigh, weigh_each
from bayescal.density.elimination import Whitening
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from bayescal.density.calibration.likelihood import CalibrationLikelihood

MOST_ROWS = 1200  # of all poses together, that are factorised at once


@dataclass(frozen=True, eq=False)
class FrozenRows:
    """The density of readings about a machine, with errors whose columns have one amplitude each.

    Attributes
    ----------
    white : Whitening
        By the stated noise, (1, P, K).
    left : ndarray, shape (P, K, m)
        Z.
    parts : ndarray, shape (C, P m, P m)
        What functions of an amplitude of one add.
    """

    white: Whitening
    left: Array
    parts: Array

    @classmethod
    def build(cls, likelihood: CalibrationLikelihood, errors: Errors, theta: Array) -> FrozenRows | None:
        """Return it about a machine (D,) for a density that starts where that explains the readings; None if it cannot.

        It cannot where single rows may be outliers, where columns have more than an amplitude, and with too many rows.
        """
        data = likelihood.data
        n_poses, n = data.sd.shape
        acts = errors.list_acts(data, likelihood.error_gain)
        m = n - len(likelihood.model.coordinates)
        if not acts or errors.outliers.expected or m < 1 or n_poses * m > MOST_ROWS:
            return None
        white = likelihood.whiten(likelihood.sd[None], np.zeros((1, 1, n)))
        slope = likelihood.linearise(theta[None], likelihood.start[None], white)[1][0]
        if not np.isfinite(slope).all():
            return None
        size = np.linalg.norm(slope, axis=1, keepdims=True)
        axes, _ = np.linalg.qr(slope / np.where(size > 0.0, size, 1.0), mode="complete")
        left = np.ascontiguousarray(axes[..., slope.shape[-1] :])
        parts = np.empty((len(acts), n_poses * m, n_poses * m))
        for part, act in zip(parts, acts, strict=True):
            shown = white.rows(np.where(data.present[..., None], act, 0.0)[None])[0]
            flat = (np.swapaxes(left, -1, -2) @ shown).reshape(n_poses * m, -1)
            part[:] = flat @ flat.T
        return cls(white, left, parts)

    def density(self, likelihood: CalibrationLikelihood, theta: Array, errors: Errors, zeta: Array) -> Array:
        """Return the log-likelihood, shape (B,), for machines (B, D) and coordinates of errors (B, k)."""
        rows, rest = self._find_rows(likelihood, theta)
        total = rest.sum(axis=1)
        for part in batches(len(theta), rows.shape[1]):
            own, weights = self._blocks(likelihood, errors, zeta[part]), errors.amplitudes(zeta[part]) ** 2
            total[part] += weigh(assemble(own, self.parts, weights), rows[part])
        return np.where(np.isfinite(total), total, -np.inf)

    def density_by_row(self, likelihood: CalibrationLikelihood, theta: Array, errors: Errors, zeta: Array) -> Array:
        """Return the log-likelihood of each pose's readings given all others, shape (B, P)."""
        rows, found = self._find_rows(likelihood, theta)
        for part in batches(len(theta), rows.shape[1]):
            own, weights = self._blocks(likelihood, errors, zeta[part]), errors.amplitudes(zeta[part]) ** 2
            found[part] += weigh_each(assemble(own, self.parts, weights), rows[part], len(self.left))[0]
        return np.where(np.isfinite(found), found, -np.inf)

    def _find_rows(self, likelihood: CalibrationLikelihood, theta: Array) -> tuple[Array, Array]:
        """Return rows (B, P m), and what log-densities have beside theirs, (B, P); -inf where there is no machine."""
        white = self.white.repeat(len(theta))
        at = likelihood.stand(theta, white)
        rows = np.einsum("pkm,bpk->bpm", self.left, at.error).reshape(len(theta), -1)
        rest = likelihood.offset(white, at) - 0.5 * np.log(2.0 * np.pi) * likelihood.n_spare
        good = np.isfinite(rows).all(axis=1) & np.isfinite(rest).all(axis=1)
        return np.where(good[:, None], rows, 0.0), np.where(good[:, None], rest, -np.inf)

    def linear_rows(self, likelihood: CalibrationLikelihood, theta: Array, change: Array, errors: Errors) -> LinearRows:
        """Return rows about a machine (D,) with dθ/dy (D, m) as linear in the geometry."""
        at = likelihood.stand(theta[None], self.white)
        error, _, by_parameters = likelihood.rows(theta, change, self.white, at.pose)
        left = np.swapaxes(self.left, -1, -2)
        residual = (left @ error[..., None]).ravel()
        slope = -(left @ by_parameters).reshape(len(residual), -1)
        m = slope.shape[1]

        def factorise(one: Array) -> White:
            own = self._blocks(likelihood, errors, one[None])
            total = assemble(own, self.parts, errors.amplitudes(one[None]) ** 2)[0]
            return White(cholesky(total, lower=True, check_finite=False))

        return LinearRows(residual, slope, np.zeros((m, m)), np.zeros(m), factorise)

    def _blocks(self, likelihood: CalibrationLikelihood, errors: Errors, zeta: Array) -> Array:
        """Return Zᵀ R Z of coordinates (B, k), shape (B, P, m, m)."""
        there = likelihood.data.present
        own, tau = likelihood.noise(errors, zeta)
        if self.white.matrix is None:
            ratio = np.where(there, (own**2 + tau**2) / likelihood.sd**2, 1.0)
            return np.einsum("pkm,bpk,pkn->bpmn", self.left, ratio, self.left, optimize=True)
        covariance = own[..., :, None] * likelihood.correlation * own[..., None, :]
        gain = likelihood.error_gain
        spread = tau[..., None, :] * (np.eye(there.shape[1]) if gain is None else gain)
        covariance = covariance + spread @ np.swapaxes(spread, -1, -2)
        white = self.white.rows(np.swapaxes(self.white.rows(covariance), -1, -2))
        missing = np.eye(there.shape[1]) * ~there[:, None, :]
        return np.asarray(np.swapaxes(self.left, -1, -2) @ (white + missing) @ self.left)
