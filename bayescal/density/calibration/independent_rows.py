"""Readings of poses that do not depend on each other, fast where a machine's readings are bound to poses that stay.

About a machine that explains the readings, H of the best poses hardly turns with the machine. With Z of orthonormal
columns that span what H leaves of a pose's white readings there, and readings errors e(θ) at poses that stay,

    z(θ) = Zᵀ (e(θ) - H(θ) δ),    δ = H⁺ e(θ),    z ~ N(0, Zᵀ R Z)

up to the square of how far H turns: one evaluation and one directional derivative, which a machine binds to the poses
(`bayescal.machines.readings.BoundReadings`), instead of a search for the poses. Logarithms of volumes are taken as
linear in the parameters. What was found is corrected by the density that leaves nothing out
(`CalibrationLikelihood.exact`).

Errors that rows have in common, and that are known but for their coefficients, count for each row alone.

Model errors τ_c of M channels add columns Zᵀ g_c τ_c; where M is the number of rows, rows are turned so that these are
the unit matrix, and C = C⁰ + diag(τ²) is factorised by columns.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from bayescal.density.calibration.fixed_covariance import turn_to_present
from bayescal.density.calibration.measurements import Comparison
from bayescal.density.calibration.poses import PoseEstimate
from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.components import LinearRows
from bayescal.density.elimination import Whitening, find_step, invert
from bayescal.density.linear_gaussian import whiten
from bayescal.density.low_rank import factor_by_columns
from bayescal.machines.readings.base import BoundReadings
from bayescal.numerics.geometry import Array
from bayescal.numerics.scratch import Scratch

if TYPE_CHECKING:
    from bayescal.density.calibration.likelihood import CalibrationLikelihood

ROUNDS = 3  # of following readings to a pose by slopes that are off by some per cent
ILL = 1e8  # condition of the columns of model errors, beyond which rows are not turned to them


@dataclass(frozen=True, eq=False)
class IndependentRowsLikelihood:
    """The density of readings about a machine, each pose by itself.

    Attributes
    ----------
    bound : Bound
        The machine's readings at the poses that stay.
    comparison : Comparison
        Of the C channels that are bound.
    values : ndarray, shape (C, P, 1)
        What they read.
    anchor : ndarray, shape (D,)
    turn : ndarray, shape (P, m, C)
        From errors of the C readings that are bound to rows.
    follow : ndarray, shape (P, q, C)
        H⁺ of the same errors.
    others : ndarray of int
        Channels of the other readings, which no machine changes.
    left, unlike : ndarray, shape (P, K - C)
        Errors of these at the poses that stay, and what they read there.
    by_pose : ndarray, shape (P, K - C, q)
        How they follow a pose.
    rest : ndarray, shape (P, m)
        What their errors make of the rows.
    step : ndarray, shape (P, q)
        And of the poses' steps.
    loss : ndarray, shape (P, m, q)
        What steps make of the rows by these readings.
    back : ndarray, shape (P, m, m)
        From rows to white ones, Zᵀ e, as `bayescal.density.calibration.fixed_covariance` has them.
    known : ndarray, shape (P, m, m)
        Covariance of the rows by the stated noise.
    channels : ndarray of int, shape (m,)
        Channels whose model errors are the rows.
    offset : ndarray, shape (P,)
        What log-densities have beside those of the rows, at the anchor.
    drift : ndarray, shape (D, P)
        How that follows the parameters.
    slope : ndarray, shape (P, C, q)
        How the readings that are bound follow a pose, at the anchor.
    """

    bound: BoundReadings
    comparison: Comparison
    values: Array
    anchor: Array
    turn: Array
    follow: Array
    others: np.ndarray
    left: Array
    unlike: Array
    by_pose: Array
    rest: Array
    step: Array
    loss: Array
    back: Array
    known: Array
    channels: np.ndarray
    offset: Array
    drift: Array
    slope: Array
    scratch: Scratch = field(default_factory=Scratch)

    @classmethod
    def build(
        cls, likelihood: CalibrationLikelihood, errors: ErrorModel, theta: Array, turns: bool = True
    ) -> IndependentRowsLikelihood | None:
        """Return it about a machine (D,) for a density that starts where that explains the readings; None if it cannot.

        It cannot where readings are missing, the machine binds no readings, or model errors are not those of as many
        channels as there are rows. Where noise has an unknown factor it finds the rows by the stated one. Readings that
        are bound by `BoundModel` cost two of the machine's own: only where slopes so turn is that less than poses cost.
        """
        data, near = likelihood.data, likelihood.expansion
        n, q = data.sd.shape[1], len(likelihood.model.coordinates)
        if not q or n <= q or near is None or near.bends is None:
            return None
        if errors.has_columns and not errors.is_common_known:
            return None
        if errors.has_factors or not data.present.all():
            errors = errors.without(errors.noisy)
        bound = likelihood.model.bind(theta, data.values, likelihood.start, data.given)
        if bound is None or not (bound.is_own or turns):
            return None
        white = likelihood.whiten(likelihood.sd[None], np.zeros((1, 1, n)))
        at = likelihood.stand(theta[None], white)
        slope = at.slope[0]
        if not (np.isfinite(slope).all() and np.isfinite(at.error).all()):
            return None
        size = np.linalg.norm(slope, axis=1, keepdims=True)
        axes, _ = np.linalg.qr(slope / np.where(size > 0.0, size, 1.0), mode="complete")
        spare = axes[..., q:] if data.present.all() else turn_to_present(axes[..., q:], data.present)[0]
        whitening = white.rows(np.broadcast_to(np.eye(n), (1, data.n_poses, n, n)))[0]
        left = np.swapaxes(spare, -1, -2) @ whitening
        channels = np.flatnonzero(~errors.is_known(n)) if errors.noisy else np.arange(n - q)
        gain = np.eye(n)[None] if likelihood.error_gain is None else likelihood.error_gain
        seen = left @ gain[..., channels] if errors.noisy else np.tile(np.eye(n - q), (data.n_poses, 1, 1))
        if seen.shape[-1] != n - q or not np.all(np.linalg.cond(seen) < ILL):
            return None
        to_rows, follow = np.linalg.inv(seen), invert(slope, 0.0) @ whitening
        turn, own, other = to_rows @ left, bound.places, np.delete(np.arange(n), bound.places)
        (error,), (raw,), _ = likelihood.linearise_raw(theta[None], likelihood.start[None])
        error, by_pose = error[..., other, None], raw[:, other]
        known = to_rows @ np.swapaxes(to_rows, -1, -2)
        for term in errors.known:  # what rows have in common counts for each of them alone
            acted = turn @ term.act(data)
            known = known + term.sign * acted @ np.swapaxes(acted, -1, -2)
        here = likelihood.model.linearise(theta, likelihood.start, False, data.given)
        drift = np.zeros((len(theta), data.n_poses))
        drift[near.free] = likelihood.differentiate_volumes(theta, white, slope)
        return cls(
            bound,
            Comparison(tuple(likelihood.model.channels[k] for k in own)),
            np.ascontiguousarray(np.where(data.present, data.values, np.nan)[:, own].T[..., None]),
            theta,
            turn[..., own],
            follow[..., own],
            other,
            error[..., 0],
            here.values[:, other],
            here.by_pose[:, other],
            (turn[..., other] @ error)[..., 0],
            (follow[..., other] @ error)[..., 0],
            turn[..., other] @ by_pose,
            np.broadcast_to(seen, to_rows.shape),
            known,
            channels if errors.noisy else channels[:0],
            likelihood.offset(white, at)[0] + np.linalg.slogdet(to_rows)[1],
            drift,
            raw[:, own],
        )

    @property
    def is_own(self) -> bool:
        """Whether the machine itself binds its readings, in a form of its own."""
        return self.bound.is_own

    @property
    def followed(self) -> IndependentRowsLikelihood:
        """The same with readings followed to the pose that a machine takes, whatever the scale of their slopes."""
        bound = FollowedBound(self.bound, self.comparison, self.values, self.slope, np.linalg.pinv(self.slope))
        return replace(self, bound=bound, scratch=Scratch())

    def evaluate(
        self, likelihood: CalibrationLikelihood, theta: Array, errors: ErrorModel, zeta: Array
    ) -> tuple[Array, Array]:
        """Return log-densities but for those of rows' squares, and the squares, both (B, P)."""
        rows = self._find_rows(theta)
        beside = errors.noise(zeta, likelihood.data, likelihood.sd)[1] if len(self.channels) else None

        def add(row: int) -> Array:
            if beside is None:
                return np.zeros(1)
            return np.asarray(beside[..., self.channels[row]].T ** 2)

        density, square = factor_by_columns(self.known, add, rows, self.scratch)
        rest = self.offset + (theta - self.anchor) @ self.drift
        return (density + 0.5 * square).T + rest, square.T

    def inform(
        self, likelihood: CalibrationLikelihood, theta: Array, change: Array, errors: ErrorModel, zeta: Array
    ) -> Array:
        """Return what these rows tell of the geometry's coordinates, (m, m), at θ (D,) with dθ/dy (D, m), ζ (k,)."""
        rows = self._differentiate_rows(theta, change)
        weighed = np.linalg.solve(self._cover(likelihood, errors, zeta[None])[0], rows)
        return np.asarray(np.einsum("pki,pkj->ij", rows, weighed, optimize=True))

    def differentiate(
        self, likelihood: CalibrationLikelihood, theta: Array, change: Array, errors: ErrorModel, zeta: Array
    ) -> tuple[Array, Array]:
        """Return gradient and Gauss and Newton's Hessian of the log-likelihood; see `Elimination.differentiate`."""
        m, n = change.shape[1], change.shape[1] + len(zeta)
        gradient, hessian = np.zeros(n), np.zeros((n, n))
        with np.errstate(all="ignore"):
            rows, slope = self._find_rows(theta[None])[..., 0].T, self._differentiate_rows(theta, change)
            inverse = np.linalg.inv(self._cover(likelihood, errors, zeta[None])[0])
            weighed, tails = (inverse @ rows[..., None])[..., 0], errors.tails(zeta[None])
            square = np.einsum("pk,pk->p", rows, weighed)[None]
            trust = tails.trust(square, likelihood.n_spare)[0]
            gradient[:m] = (self.drift.sum(axis=1) @ change) - np.einsum("p,pk,pki->i", trust, weighed, slope)
            hessian[:m, :m] = -np.einsum("p,pki,pkl,plj->ij", trust, slope, inverse, slope, optimize=True)
            if n > m:
                each = [one.variance for one in errors.slopes(zeta, likelihood.data)]
                shape, own = likelihood.data.sd.shape, np.zeros((n - m, len(rows), len(self.channels)))
                for k, one in enumerate(each):
                    if one is not None:
                        own[k] = np.broadcast_to(one, shape)[:, self.channels]
                diagonal = np.diagonal(inverse, axis1=1, axis2=2)
                gradient[m:] = 0.5 * np.einsum("npk,pk->n", own, trust[:, None] * weighed**2 - diagonal)
                hessian[m:, m:] = -0.5 * np.einsum("npi,pij,opj->no", own, inverse**2, own, optimize=True)
                by_own = tails.slopes(square, likelihood.n_spare)[0]
                last = slice(n - by_own.shape[1], n)
                gradient[last] += by_own.sum(axis=0)
                hessian[last, last] -= by_own.T @ by_own
        return gradient, hessian

    def linear_rows(
        self, likelihood: CalibrationLikelihood, theta: Array, change: Array, errors: ErrorModel
    ) -> LinearRows:
        """Return the rows as linear in the geometry about θ (D,), with dθ/dy (D, m)."""
        slope, here = self._differentiate_rows(theta, change), self._find_rows(theta[None])[..., 0].T
        both = np.concatenate([slope, here[..., None]], axis=-1)

        m = change.shape[1]

        def look(zeta: Array) -> tuple[Array, Array]:
            cover = self._cover(likelihood, errors, zeta)
            white, volume = whiten(cover.copy(), np.broadcast_to(both, (len(cover), *both.shape)))
            rows = white.reshape(len(white), -1, m + 1)
            covers = len(zeta) // len(rows)  # a covariance that depends on no error is one for all
            square = np.swapaxes(rows, 1, 2) @ rows
            return np.repeat(square, covers, axis=0), np.repeat(volume.sum(axis=1), covers)

        def square(zeta: Array) -> tuple[Array, Array]:
            parts = [look(zeta[part]) for part in likelihood.batches(len(zeta))]
            return np.concatenate([one for one, _ in parts]), np.concatenate([one for _, one in parts])

        return LinearRows(np.zeros((m, m)), self.drift.sum(axis=1) @ change, square)

    def _cover(self, likelihood: CalibrationLikelihood, errors: ErrorModel, zeta: Array) -> Array:
        """Return the rows' covariance at ζ (B, k), (B, P, m, m); one for all where no error enters."""
        if not len(self.channels):
            return self.known[None]
        beside = errors.noise(zeta, likelihood.data, likelihood.sd)[1]
        return self.known + np.eye(len(self.channels)) * beside[:, :, self.channels, None] ** 2

    def _differentiate_rows(self, theta: Array, change: Array) -> Array:
        """Return derivatives of the rows by the geometry's coordinates at θ (D,), (P, m, m')."""
        by_pose, by_parameters = self.bound.differentiate(theta)
        moved = by_parameters @ change
        step = self.follow @ moved
        return np.asarray(self.loss @ step - self.turn @ (moved - by_pose @ step))

    # --- where machines stand ------------------------------------------------------------------------------------

    def find_white(self, theta: Array) -> tuple[Array, Array]:
        """Return white rows (B, P, m), and what log-densities of poses have beside those of the rows, (B, P)."""
        rows = (self.back @ self._find_rows(theta).transpose(1, 0, 2)).transpose(2, 0, 1)
        rest = self.offset + np.linalg.slogdet(self.back)[1] + (theta - self.anchor) @ self.drift
        return rows, rest

    def stand(self, likelihood: CalibrationLikelihood, theta: Array, white: Whitening) -> PoseEstimate:
        """Return machines (B, D) where they explain the readings best, by a step from the poses that stay."""
        assert likelihood.expansion is not None
        error = np.empty((len(theta), *likelihood.data.sd.shape))
        error[..., self.bound.places] = self._compare(self.bound.read(theta)).transpose(2, 1, 0)
        error[..., self.others] = self.left
        slope = white.rows(likelihood.expansion.predict(theta)[1])
        step, left = find_step(slope, white.vector(error))
        return PoseEstimate(likelihood.start + step, left, slope)

    def read(self, likelihood: CalibrationLikelihood, theta: Array, pose: Array) -> Array:
        """Return the readings (B, P, K) of machines (B, D) at poses (B, P, q) close to those that stay."""
        step = np.broadcast_to(pose, (len(theta), *likelihood.start.shape)) - likelihood.start
        moved = self.bound.read(theta) + self.bound.follow(np.ascontiguousarray(step.transpose(2, 1, 0)))
        read = np.empty((len(theta), *likelihood.data.sd.shape))
        read[..., self.bound.places] = moved.transpose(2, 1, 0)
        read[..., self.others] = self.unlike + (self.by_pose @ step[..., None])[..., 0]
        return read

    def density_by_row(self, likelihood: CalibrationLikelihood, theta: Array, errors: ErrorModel, zeta: Array) -> Array:
        """Return the log-likelihood of each pose's readings, (B, P); -inf where there is no machine."""
        with np.errstate(all="ignore"):
            rest, square = self.evaluate(likelihood, theta, errors, zeta)
            found = errors.tails(zeta).weigh(square, likelihood.n_spare) + rest
        return np.where(np.isfinite(found), found, -np.inf)

    def _find_rows(self, theta: Array) -> Array:
        """Return rows, shape (m, P, B)."""
        error = self._compare(self.bound.read(theta))  # (C, P, B)
        step = self.follow @ error.transpose(1, 0, 2) + self.step[..., None]
        moved = error - self.bound.follow(np.ascontiguousarray(step.transpose(1, 0, 2)))
        rows = self.turn @ moved.transpose(1, 0, 2) - self.loss @ step + self.rest[..., None]
        return np.ascontiguousarray(rows.transpose(1, 0, 2))

    def _compare(self, read: Array) -> Array:
        """Return measured minus read, (C, P, B)."""
        return compare(self.comparison, self.values, read)


def compare(comparison: Comparison, values: Array, read: Array) -> Array:
    """Return measured values (C, P, 1) minus what is read, (C, P, B); zero where nothing was measured."""
    if comparison.is_plain:
        error = values - read
    else:
        error = comparison.subtract(values.T, read.transpose(2, 1, 0)).transpose(2, 1, 0)
    missing = np.isnan(values[..., 0])
    if missing.any():
        error[missing] = 0.0
    return np.asarray(error)


@dataclass(frozen=True, eq=False)
class FollowedBound(BoundReadings):
    """Readings followed to the pose that a machine takes, there compared by the slopes of the anchor.

    Where errors and slopes have another scale than the anchor's, as closures of stiffness models have with another
    stiffness, that pose does not know of it.
    """

    bound: BoundReadings
    comparison: Comparison
    values: Array  # (C, P, 1)
    slope: Array  # (P, C, q): of the anchor
    gain: Array  # (P, q, C): its inverse

    @property
    def places(self) -> np.ndarray:  # type: ignore[override]
        """Those of the readings that are followed."""
        return self.bound.places

    def read(self, theta: Array) -> Array:
        """Return the readings, (C, P, B); see `BoundReadings.read`."""
        rest = error = compare(self.comparison, self.values, self.bound.read(theta))
        placed = np.zeros((self.gain.shape[1], *error.shape[1:]))
        for _ in range(ROUNDS):  # each as far as it leaves least: slopes of another scale are no matter
            step = np.ascontiguousarray((self.gain @ rest.transpose(1, 0, 2)).transpose(1, 0, 2))
            moved = self.bound.follow(step)
            square, along = (np.einsum("cpb,cpb->pb", moved, one) for one in (moved, rest))
            length = np.divide(along, square, out=np.zeros_like(square), where=square > 0)
            placed, rest = placed + length * step, rest - length * moved
        return np.asarray(self.values - rest - self.follow(placed))

    def differentiate(self, theta: Array) -> tuple[Array, Array]:
        """Return the anchor's slopes, and those by the parameters; see `BoundReadings.differentiate`."""
        by_pose, by_parameters = self.bound.differentiate(theta)
        placed = np.linalg.pinv(np.nan_to_num(by_pose)) @ by_parameters
        return self.slope, by_parameters + (self.slope - by_pose) @ placed

    def follow(self, step: Array) -> Array:
        """Return what steps (q, P, B) make of the readings, (C, P, B), at the anchor."""
        return np.asarray((self.slope @ step.transpose(1, 0, 2)).transpose(1, 0, 2))
