"""Readings whose errors are functions of the pose, by one covariance of all rows: fast where machines are much alike.

About a machine that explains the readings, H of the best poses hardly turns with the machine. With Z of orthonormal
columns that span what H leaves of a pose's white readings there, and poses flat along H,

    ∫ N(e; H v, R + A D Aᵀ) dv = N(Zᵀ e; 0, Zᵀ R Z + Zᵀ A D Aᵀ Z) |HᵀH|^(-1/2)

whatever the errors are that R and D stand for: rows Zᵀ e are free of the poses, and functions of one amplitude s add s²
times a matrix that is known beforehand (`bayescal.density.components`). That costs one factorisation of all rows, where
columns cost those of all coefficients, which are more wherever smooth functions are allowed for.

Coefficients u of the errors given the rows are drawn by Matheron's rule: with u' and rows e' = A u' + ε' of the prior,

    u = u' + Aᵀ S⁻¹ (e - e'),    S = Zᵀ R Z + A Aᵀ.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cholesky

from bayescal.density.calibration.terms import Errors
from bayescal.density.components import LinearRows, White, assemble, batches, leave_out, weigh, weigh_left_out
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
    anchor : ndarray, shape (D,)
        The machine.
    white : Whitening
        By the stated noise, (1, P, K).
    left : ndarray, shape (P, K, m)
        Z.
    shown : tuple of ndarray, shapes (P m, N)
        What coefficients of each of C errors do to the rows at an amplitude of one.
    """

    anchor: Array
    white: Whitening
    left: Array
    shown: tuple[Array, ...]

    @cached_property
    def parts(self) -> Array:
        """What errors of an amplitude of one add to the rows' covariance, (C, P m, P m)."""
        return np.stack([one @ one.T for one in self.shown])

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
        slope = likelihood.stand(theta[None], white).slope[0]
        if not np.isfinite(slope).all():
            return None
        size = np.linalg.norm(slope, axis=1, keepdims=True)
        axes, _ = np.linalg.qr(slope / np.where(size > 0.0, size, 1.0), mode="complete")
        left = np.ascontiguousarray(axes[..., slope.shape[-1] :])
        turned = np.swapaxes(left, -1, -2)
        seen = (white.rows(np.where(data.present[..., None], act, 0.0)[None])[0] for act in acts)
        return cls(theta, white, left, tuple((turned @ one).reshape(n_poses * m, -1) for one in seen))

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
            total = assemble(own, self.parts, weights)
            found[part] += weigh_left_out(*leave_out(total, rows[part], len(self.left)))[0]
        return np.where(np.isfinite(found), found, -np.inf)

    def density_of_others(
        self, likelihood: CalibrationLikelihood, other: CalibrationLikelihood, theta: Array, errors: Errors, zeta: Array
    ) -> Array | None:
        """Return the log-density of each of Q other poses' readings given these, (B, Q); None where it cannot.

        Given the rows others are normal about C S⁻¹ e with the covariance that they have less C S⁻¹ Cᵀ.
        """
        beyond = FrozenRows.build(other, errors, self.anchor)
        if beyond is None:
            return None
        rows, rest = self._find_rows(likelihood, theta)
        there, found = beyond._find_rows(other, theta)
        found[~np.isfinite(rest).all(axis=1)] = -np.inf
        n_poses, m = other.data.n_poses, beyond.left.shape[-1]
        across = np.stack([one @ two.T for one, two in zip(beyond.shown, self.shown, strict=True)])
        by_pose = [one.reshape(n_poses, m, -1) for one in beyond.shown]
        inner = np.stack([one @ np.swapaxes(one, -1, -2) for one in by_pose])
        for part in batches(len(theta), rows.shape[1] + there.shape[1]):
            weights = errors.amplitudes(zeta[part]) ** 2
            total = assemble(self._blocks(likelihood, errors, zeta[part]), self.parts, weights)
            shared = np.tensordot(weights, across, 1)
            solved = np.linalg.solve(total, np.concatenate([np.swapaxes(shared, -1, -2), rows[part, :, None]], axis=-1))
            left = (there[part, :, None] - shared @ solved[..., -1:]).reshape(len(weights), n_poses, m)
            told = shared.reshape(len(weights), n_poses, m, -1) @ np.moveaxis(
                solved[..., :-1].reshape(*solved.shape[:2], n_poses, m), 1, 2
            )
            own = beyond._blocks(other, errors, zeta[part]) + np.tensordot(weights, inner, 1) - told
            square = np.einsum("bpi,bpi->bp", left, np.linalg.solve(own, left[..., None])[..., 0])
            found[part] -= 0.5 * (np.linalg.slogdet(own)[1] + square)
        return np.where(np.isfinite(found), found, -np.inf)

    def draw(
        self,
        likelihood: CalibrationLikelihood,
        theta: Array,
        errors: Errors,
        zeta: Array,
        rng: np.random.Generator,
    ) -> Array:
        """Return draws of the coefficients of all errors given the rows, one for each machine, shape (B, N)."""
        rows, _ = self._find_rows(likelihood, theta)
        ends = np.cumsum([one.shape[1] for one in self.shown])
        drawn, noise = rng.standard_normal((len(theta), ends[-1])), rng.standard_normal(rows.shape)
        for part in batches(len(theta), rows.shape[1]):
            own, amplitudes = self._blocks(likelihood, errors, zeta[part]), errors.amplitudes(zeta[part])
            apart = np.linalg.cholesky(own) @ noise[part].reshape(*own.shape[:3], 1)
            left, each = rows[part] - apart.reshape(len(own), -1), np.split(drawn[part], ends[:-1], axis=1)
            for one, shown, size in zip(each, self.shown, amplitudes.T, strict=True):
                left -= size[:, None] * (one @ shown.T)
            told = np.linalg.solve(assemble(own, self.parts, amplitudes**2), left[..., None])[..., 0]
            for one, shown, size in zip(each, self.shown, amplitudes.T, strict=True):
                one += size[:, None] * (told @ shown)  # a view of ``drawn``
        return drawn

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

        def square(one: Array) -> tuple[Array, float]:
            own = self._blocks(likelihood, errors, one[None])
            total = assemble(own, self.parts, errors.amplitudes(one[None]) ** 2)[0]
            white = White(cholesky(total, lower=True, check_finite=False))
            return white.square(np.column_stack([slope, residual])), white.half_log_det

        return LinearRows(np.zeros((m, m)), np.zeros(m), square)

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
