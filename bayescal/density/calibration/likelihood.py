"""The density of readings, some of them not taken, the poses at which they were taken unknown and eliminated.

With a pose that may lie anywhere in a workspace of volume V, n readings of covariance Σ have to first order about the
pose v̂ that explains them best the density

    p(s | d) = (2π)^(-m/2) |Σ|^(-1/2) |HᵀΣ⁻¹H|^(-1/2) exp(-½ r²) / V,   r² = r̂ᵀ Σ⁻¹ r̂,   r̂ = s - h(v̂, d),

with m = n - q, and where single rows may be wrong that of `outliers.Outliers` in place of the normal one of r̂.

Where the data say which channels c the machine was commanded by, the pose is uniformly distributed in these and not in
its coordinates: |∂h_c/∂v| takes the place of 1/V, sqrt |JᵀJ| with J = ∂h_c/∂v where they are more than the
coordinates. That is p(s | d) over the density of the commanded positions, which is uniform then: p(other readings |
commanded positions, d), in which no workspace appears.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.density.calibration.measurements import Comparison, Measurements
from bayescal.density.calibration.outliers import NORMAL, Outliers
from bayescal.density.calibration.whitening import Whitening
from bayescal.density.elimination import factorise, find_step, half_log_volume, invert, solve_step
from bayescal.machines.readings import Given, ReadingModel
from bayescal.numerics.geometry import Array

ROWS = 4096  # poses of machines that are looked at together
CLOSE = 0.03  # deviations of a reading, below which a step is taken to first order: what that leaves enters squared
NEAR = 0.3  # deviations of a reading, within which H is taken for constant
CHORD, ASTRAY = 0.1, 1.0  # length of white readings that a chord moves by, where chords end and where they are lost
MAX_STEPS, MAX_CHORDS, MAX_SEARCH, PATIENCE = 30, 8, 60, 4


@dataclass(frozen=True, eq=False)
class Stand:
    """C machines where they explain the readings best.

    Attributes
    ----------
    pose : ndarray, shape (C, P, q)
    error : ndarray, shape (C, P, K)
        What is left, white.
    slope : ndarray, shape (C, P, K, q)
        H, white.
    """

    pose: Array
    error: Array
    slope: Array

    @property
    def square(self) -> Array:
        """r², shape (C, P)."""
        return np.einsum("...k,...k->...", self.error, self.error)


@dataclass(frozen=True, eq=False)
class CalibrationLikelihood:
    """Log-density of the readings of P poses for batches of machines and of deviations.

    Attributes
    ----------
    model : ReadingModel
    data : Measurements
    volume : float
        V, in the units of the coordinates.
    start : ndarray, shape (P, q)
        Poses from which the best ones are looked for.
    anchor : ndarray, shape (D,), or None
        A machine near those that are asked for, which explains the readings at ``start``.
    """

    model: ReadingModel
    data: Measurements
    volume: float
    start: Array
    anchor: Array | None = None

    @cached_property
    def n_readings(self) -> np.ndarray:
        """Number n of readings at each pose, shape (P,)."""
        return np.asarray(self.data.present.sum(axis=1))

    @property
    def n_spare(self) -> np.ndarray:
        """How many of them m are more than the pose has coordinates, shape (P,)."""
        return self.n_readings - len(self.model.coordinates)

    @cached_property
    def comparison(self) -> Comparison:
        """How readings are compared."""
        return Comparison(self.model.channels)

    @cached_property
    def _known(self) -> Measurements:
        return self.data.with_constraints(tuple(one.unit for one in self.model.channels))

    @cached_property
    def sd(self) -> Array:
        """Stated deviations, shape (P, K), a constraint's being tiny, those of no reading one."""
        return np.where(self.data.present, self._known.sd, 1.0)

    @cached_property
    def correlation(self) -> Array:
        """Of the noise, (P, K, K) or (1, K, K), readings not taken being nobody's."""
        n, there = len(self.model.channels), self.data.present
        if self.data.correlation is None:
            return np.eye(n)[None]
        both = there[:, :, None] & there[:, None, :]
        return np.where(both, self.data.correlation, np.eye(n))

    @cached_property
    def error_gain(self) -> Array | None:
        """How model errors show in the readings, (P, K, K); None where each shows in its own channel alone.

        That of one machine where it starts: the gain hardly changes with the machine.
        """
        theta, there = self.model.layout.nominal if self.anchor is None else self.anchor, self.data.present
        gain = self.model.error_gain(theta, self.start, self.data.given)
        if gain is None:
            return None
        known = np.isfinite(gain).all(axis=(-1, -2), keepdims=True) & there[:, :, None] & there[:, None, :]
        return np.where(known, gain, np.eye(gain.shape[-1]))

    @cached_property
    def _given(self) -> Given:
        return {name: value[None] for name, value in self.data.given.items()}

    def pick(self, which: np.ndarray) -> CalibrationLikelihood:
        """Return the density of the readings of some poses."""
        return replace(self, data=self.data.pick(which), start=self.start[which])

    def anchored(self, pose: Array, theta: Array) -> CalibrationLikelihood:
        """Return the same density that starts at those poses (P, q) which a machine (D,) explains readings with."""
        return replace(self, start=pose, anchor=theta)

    # --- poses ---------------------------------------------------------------------------------------------------

    def whiten(self, own: Array, tau: Array) -> Whitening:
        """Return the whitening for deviations s σ (C, P, K) and τ (C, 1, K)."""
        there = self.data.present
        if self.data.correlation is None and self.error_gain is None:
            weight = np.where(there, 1.0 / np.sqrt(own**2 + tau**2), 0.0)
            return Whitening(weight, None, np.log(np.where(there, weight, 1.0)).sum(axis=-1))
        own, tau = np.where(there, own, 1.0), np.where(there, tau, 0.0)
        covariance = own[..., :, None] * self.correlation * own[..., None, :]
        spread = tau[..., None, :] * (np.eye(own.shape[-1]) if self.error_gain is None else self.error_gain)
        factor = np.linalg.cholesky(covariance + spread @ np.swapaxes(spread, -1, -2))
        log_det = -np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
        return Whitening(None, np.linalg.inv(factor), log_det)

    def linearise(
        self, theta: Array, pose: Array, white: Whitening, with_parameters: bool = False
    ) -> tuple[Array, Array, Array]:
        """Return white errors (C, P, K), H (C, P, K, q) and A (C, P, K, D) of machines (C, D) at poses (C, P, q)."""
        here = self.model.linearise(theta[:, None], pose, with_parameters, self._given)
        error = self.comparison.subtract(self.data.values, here.values)
        there = self.data.present
        by_pose = self._pull_back(error, here.values, here.by_pose)
        rows = white.rows(by_pose)
        left = white.vector(np.where(there, error, 0.0))
        if not with_parameters:
            return left, rows, here.by_parameters
        return left, rows, white.rows(self._pull_back(error, here.values, here.by_parameters))

    def _pull_back(self, error: Array, values: Array, slope: Array) -> Array:
        result = np.array(self.comparison.pull_back(error, values, slope))
        result[:, ~self.data.present] = 0.0
        return result

    def stand(self, theta: Array, white: Whitening, start: Array | None = None) -> Stand:
        """Return machines (C, D) where they explain the readings best, by Gauss and Newton's method.

        It starts with chords where the density is anchored: H changes so little from machine to machine that a fixed
        inverse gains two digits a step, without any derivative. The last step is taken to first order.
        """
        pose = np.broadcast_to(self.start if start is None else start, (len(theta), *self.start.shape)).copy()
        if not pose.shape[-1]:
            error, slope, _ = self.linearise(theta, pose, white)
            return Stand(pose, error, slope)
        if self.anchor is not None and start is None:
            pose = self._follow_chords(theta, pose, white)
        found = Stand(pose, *(np.empty((*pose.shape[:2], *shape)) for shape in self._shapes))
        going = np.arange(len(theta))
        for _ in range(MAX_STEPS):
            size = self._improve(found, going, theta, white)
            still = np.any(size > NEAR, axis=1)  # where it is not a number the machine cannot stand
            if not still.any():
                return found
            going, size = going[still], size[still]
        found.error[going] = np.where((size > NEAR)[..., None], np.nan, found.error[going])  # wandering: no pose
        return found

    @property
    def _shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        n, q = len(self.model.channels), len(self.model.coordinates)
        return (n,), (n, q)

    def _improve(self, found: Stand, going: np.ndarray, theta: Array, white: Whitening) -> Array:
        """Move some of the machines by a step, or two where H is as good as that of the next pose; return the sizes."""
        theta, white = theta[going], white.pick(going)
        error, slope, _ = self.linearise(theta, found.pose[going], white)
        step, left = find_step(slope, error)
        pose, size = found.pose[going] + step, np.abs(error - left).max(axis=-1)
        largest = np.nanmax(size, axis=1, initial=0.0)
        near = np.flatnonzero((largest > CLOSE) & (largest <= NEAR))
        if len(near):
            again = self._errors(theta[near], pose[near], white.pick(near))
            step, left[near] = find_step(slope[near], again)
            pose[near] += step
        found.pose[going], found.error[going], found.slope[going] = pose, left, slope
        return np.asarray(size)

    def _errors(self, theta: Array, pose: Array, white: Whitening) -> Array:
        """Return white errors (C, P, K) of machines (C, D) at poses (C, P, q)."""
        read = self.model.read(theta[:, None], pose, self._given)
        error = self.comparison.subtract(self.data.values, read)
        return white.vector(np.where(self.data.present, error, 0.0))

    def _follow_chords(self, theta: Array, pose: Array, white: Whitening) -> Array:
        """Return poses (C, P, q) close to where machines explain the readings; where they start if chords go astray."""
        slope, first = white.rows(self._anchored_slope), pose
        assert self.anchor is not None
        pose = pose + ((theta - self.anchor) @ self._anchored_moves).reshape(pose.shape)
        going = np.arange(len(theta))
        size = np.full(pose.shape[:2], np.inf)
        with np.errstate(all="ignore"):
            factor = factorise(slope)
        for _ in range(MAX_CHORDS):  # each machine by itself, so that it stands where it would alone
            every = len(going) == len(theta)
            own = (theta, pose, white) if every else (theta[going], pose[going], white.pick(going))
            part = (slope, factor) if every else (slope[going], [[one[going] for one in row] for row in factor])
            step, size[going] = solve_step(*part, self._errors(*own))
            pose[going] += step
            going = going[np.any(size[going] > CHORD, axis=1)]
            if not len(going):
                break
        astray = ~(np.isfinite(pose).all(axis=-1) & (size < ASTRAY))[..., None]
        return np.where(astray, first, pose)

    @cached_property
    def _anchored_slope(self) -> Array:
        """H at the anchor, of raw readings, (1, P, K, q)."""
        assert self.anchor is not None
        here = self.model.linearise(self.anchor[None, None], self.start[None], False, self._given)
        error = self.comparison.subtract(self.data.values, here.values)
        return self._pull_back(error, here.values, here.by_pose)

    @cached_property
    def _anchored_moves(self) -> Array:
        """How poses follow the parameters at the anchor, to first order, (D, P q)."""
        assert self.anchor is not None
        white = self.whiten(self.sd[None], np.zeros((1, 1, len(self.model.channels))))
        _, slope, by_parameters = self.linearise(self.anchor[None], self.start[None], white, with_parameters=True)
        moves = -invert(slope[0], 0.0) @ by_parameters[0]
        return np.asarray(np.moveaxis(moves, -1, 0).reshape(moves.shape[-1], -1))

    # --- density -------------------------------------------------------------------------------------------------

    def batches(self, n: int) -> Iterator[slice]:
        """Yield slices of n machines that are looked at together."""
        size = max(1, ROWS // self.data.n_poses)
        yield from (slice(k, k + size) for k in range(0, n, size))

    def pointwise(self, theta: Array, own: Array, tau: Array, outliers: Outliers = NORMAL) -> Array:
        """Return the log-density of each pose's readings, (C, P), -inf where a machine cannot stand.

        Parameters
        ----------
        theta : ndarray, shape (C, D)
        own : ndarray, shape (C, P, K)
            s σ.
        tau : ndarray, shape (C, 1, K)
        outliers : Outliers, optional
        """
        result = np.empty((len(theta), self.data.n_poses))
        for part in self.batches(len(theta)):
            white = self.whiten(own[part], tau[part])
            at = self.stand(theta[part], white)
            result[part] = outliers.weigh(at.square, self.n_spare) + self.offset(white, at)
        result[~np.isfinite(result)] = -np.inf
        return result

    def offset(self, white: Whitening, at: Stand) -> Array:
        """Return what the log-density of each pose has beside that of the white residual, (C, P)."""
        return np.asarray(white.log_det + self.log_volume(at.slope, white))

    def log_volume(self, slope: Array, white: Whitening) -> Array:
        """Return the log of what white readings leave of the pose's volume, times its prior density there, (C, P).

        Parameters
        ----------
        slope : ndarray, shape (C, P, K, q)
            H, white.
        white : Whitening
        """
        left, commanded = -half_log_volume(slope), self.data.commanded
        if commanded is None or not slope.shape[-1]:
            return np.asarray(left - np.log(self.volume))
        own = np.stack([white.colour(slope[..., i]) for i in range(slope.shape[-1])], axis=-1)
        measure = half_log_volume(np.where(commanded[..., None], own, 0.0))
        return np.asarray(left + np.where(commanded.any(axis=1), measure, -np.log(self.volume)))


def search_poses(
    likelihood: CalibrationLikelihood, theta: Array, white: Whitening, start: Array
) -> tuple[Array, Array]:
    """Return poses (C, P, q) that explain readings better, and what they leave, r² (C, P), by damped steps.

    Slower than `CalibrationLikelihood.stand`, it finds the way from starts (C, P, q) that are far off.
    """
    pose, damping, idle = start.copy(), np.full(start.shape[:2], 1e-3), 0
    error, slope, _ = likelihood.linearise(theta, pose, white)
    square = np.einsum("cpk,cpk->cp", error, error)
    for _ in range(MAX_SEARCH):
        # damping as further readings, of each coordinate by itself, that say it stays
        size = np.sqrt(damping)[..., None] * np.linalg.norm(slope, axis=-2)
        rows = np.concatenate([slope, size[..., None] * np.eye(slope.shape[-1])], axis=-2)
        step, _ = find_step(rows, np.concatenate([error, np.zeros_like(size)], axis=-1))
        moved = np.where(np.isfinite(step), pose + step, pose)
        other, there, _ = likelihood.linearise(theta, moved, white)
        found = np.einsum("cpk,cpk->cp", other, other)
        better = (found < square) | (np.isnan(square) & np.isfinite(found))
        idle = 0 if np.any(better & ~(square - found < 1e-4 * square)) else idle + 1
        damping = np.where(better, damping / 10.0, damping * 10.0)
        pose, error = (np.where(better[..., None], new, old) for new, old in ((moved, pose), (other, error)))
        slope, square = np.where(better[..., None, None], there, slope), np.where(better, found, square)
        if idle == PATIENCE:
            break
    return pose, square
