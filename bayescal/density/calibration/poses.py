"""The density of readings, some of them not taken, the poses at which they were taken unknown and eliminated.

With a pose that may lie anywhere in a workspace of volume V, n readings of covariance Σ have to first order about the
pose v̂ that explains them best the density

    p(s | d) = (2π)^(-m/2) |Σ|^(-1/2) |HᵀΣ⁻¹H|^(-1/2) exp(-½ r²) / V,   r² = r̂ᵀ Σ⁻¹ r̂,   r̂ = s - h(v̂, d),

with m = n - q, and where single rows may be wrong that of `outliers.Outliers` instead of the normal one of r̂.

Where the data say which channels c the machine was commanded by, the pose is uniformly distributed in these and not in
its coordinates: |∂h_c/∂v| takes the place of 1/V, sqrt |JᵀJ| with J = ∂h_c/∂v where they are more than the
coordinates. That is p(s | d) over the density of the commanded positions, which is uniform then: p(other readings |
commanded positions, d), in which no workspace appears.

A posterior's machines differ by so little that H = ∂h/∂v along the poses that explain the readings is linear in the
parameters to a part in millions. H then costs one product of matrices instead of q directional derivatives of the
readings, and a pose that has it is found in one or two steps. How far this holds is measured, not assumed: the error of
the log-density is quadratic in the change M = H⁺ dH of the slopes, with a factor that trial machines give.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np

from bayescal.density.calibration.measurements import CONSTRAINT, Comparison, Measurements
from bayescal.density.elimination import (
    Whitening,
    factorise,
    find_step,
    half_log_volume,
    invert,
    log_root,
    solve_step,
    subtract_step,
    whiten_covariance,
)
from bayescal.machines.readings import Given, ReadingModel
from bayescal.numerics.geometry import Array

LARGEST = 2**24  # entries of the derivatives of H, 128 MB


@dataclass(frozen=True, eq=False)
class PoseExpansion:
    """Poses and H of machines near an anchor of D parameters, at P poses of q coordinates with K readings."""

    anchor: Array  # (D,)
    pose: Array  # (P, q): where the anchor explains the readings
    slope: Array  # (q, P, K): H there, not white
    moves: Array  # (D, P, q): how poses follow the parameters
    close: float  # white readings that a pose may move by in a step that is taken to first order
    free: np.ndarray  # (F,): which parameters may differ from the anchor's
    bends: Array | None  # (F, q, P, K): how H follows them; None where that is not known
    # (F, F): the square of M, summed over poses and coordinates, as a quadratic form of the parameters' change
    metric: Array
    limit: float  # its value up to which H is good enough

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

    def pick(self, which: np.ndarray) -> PoseExpansion:
        """Return that of some of the poses; of fewer ones it is as good."""
        bends = None if self.bends is None else self.bends[:, :, which]
        return replace(self, pose=self.pose[which], slope=self.slope[:, which], moves=self.moves[:, which], bends=bends)


ROWS, MANY_ROWS = 4096, 2**14  # poses of machines that are looked at together; without a derivative of the readings
FIRST_ORDER_STEP = (
    0.03  # deviations of a reading, below which a step is taken to first order: what that leaves enters squared
)
CONSTANT_H_STEP = 0.3  # deviations of a reading, within which H is taken for constant
LAST_CHORD, MAX_CHORD = (
    0.1,
    1.0,
)  # length of white readings that a chord moves by, where chords end and where they are lost
MAX_FIRST_ORDER_ERROR = 1e-5  # deviations of a reading that a step taken to first order may leave out
DERIVATIVE_STEP = (
    0.01  # of what a parameter's machines deviate, for the derivative of H: it has to hold where many compensate
)
NATS, LARGEST_CHANGE = 3e-3, 0.1  # of the log-density that an expansion may be wrong by; square of the change of H
TRIALS = 4  # directions in which poses are moved to see how straight the readings are
MAX_STEPS, MAX_CHORDS, MAX_SEARCH, PATIENCE = 30, 8, 60, 4
MAX_STALE, SMALLER = 6, 0.7  # steps in turn after which a pose whose step is not smaller by that factor has no end
JOINED = 1e-3  # of the spread of the starts, within which two ways are one


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """C machines where they explain the readings best."""

    pose: Array  # (C, P, q)
    error: Array  # (C, P, K): what is left, white
    slope: Array  # (C, P, K, q): H, white
    known_volume: Array | None = None  # (C, P): ½ log |HᵀΣ⁻¹H| where it has been computed
    known_prior: Array | None = None  # (C, P): Log-density of the poses before anything is read, the same

    @property
    def square(self) -> Array:
        """r², shape (C, P)."""
        return np.einsum("...k,...k->...", self.error, self.error)

    @property
    def volume(self) -> Array:
        """½ log |HᵀΣ⁻¹H|, shape (C, P)."""
        return half_log_volume(self.slope) if self.known_volume is None else self.known_volume


@dataclass(frozen=True, eq=False)
class PoseElimination:
    """Readings of P poses for batches of machines and of deviations: white rows free of the poses, volumes."""

    model: ReadingModel
    data: Measurements
    volume: float  # V, in the units of the coordinates
    start: Array  # (P, q): poses from which the best ones are looked for
    # about a machine near those that are asked for, which explains the readings at ``start``
    expansion: PoseExpansion | None = None

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
        theta, there = self.model.layout.nominal, self.data.present
        theta = theta if self.expansion is None else self.expansion.anchor
        gain = self.model.error_gain(theta, self.start, self.data.given)
        if gain is None:
            return None
        known = np.isfinite(gain).all(axis=(-1, -2), keepdims=True) & there[:, :, None] & there[:, None, :]
        return np.where(known, gain, np.eye(gain.shape[-1]))

    @cached_property
    def _near(self) -> ReadingModel:
        """The machine that looks for its readings near these."""
        return self.model.near(self.data.values)

    @cached_property
    def _given(self) -> Given:
        return {name: value[None] for name, value in self.data.given.items()}

    def pick(self, which: np.ndarray) -> Self:
        """Return the density of the readings of some poses."""
        near = None if self.expansion is None else self.expansion.pick(which)
        return replace(self, data=self.data.pick(which), start=self.start[which], expansion=near)

    def anchored_at(
        self, pose: Array, theta: Array, spread: Array | None = None, reference: Whitening | None = None
    ) -> Self:
        """Return the same density that starts at those poses (P, q) which a machine (D,) explains readings with.

        With others (n, D) H is expanded for machines like these, whatever their change, at a noise (1, P) or as stated.
        """
        moved = replace(self, start=pose, expansion=None)
        return replace(moved, expansion=moved._expand(theta, spread, reference) if pose.shape[-1] else None)

    # --- poses ---------------------------------------------------------------------------------------------------

    @cached_property
    def _correlated(self) -> np.ndarray:
        """Where the channels stand whose noise, or model error, shows in that of others, too."""
        n = len(self.model.channels)
        apart, gain = ~np.eye(n, dtype=bool), self.error_gain
        seen = (
            (self.correlation != 0.0).any(axis=0)
            if gain is None
            else ((self.correlation != 0.0) | (gain != 0.0)).any(axis=0)
        )
        return np.flatnonzero(((seen | seen.T) & apart).any(axis=0))

    def whiten(self, own: Array, tau: Array) -> Whitening:
        """Return the whitening for deviations s σ (C, P, K) and τ (C, 1 or P, K)."""
        there, places = self.data.present, self._correlated
        weight = np.where(there, 1.0 / np.sqrt(own**2 + tau**2), 0.0)
        log_weight = np.log(np.where(there, weight, 1.0))
        if not len(places):
            return Whitening(weight, None, places, log_weight.sum(axis=-1))
        # noise of readings that depend on each other is often the same for all machines
        own, tau = np.where(there, own, 1.0)[..., places], np.where(there, tau, 0.0)[..., places]
        if (own == own[:1]).all() and (tau == tau[:1]).all():
            own, tau = own[:1], tau[:1]
        block = np.ix_(range(len(there)), places, places)
        covariance = (
            own[..., :, None] * np.broadcast_to(self.correlation, (len(there), *self.correlation.shape[1:]))[block]
        )
        covariance = covariance * own[..., None, :]
        spread = tau[..., None, :] * (np.eye(len(places)) if self.error_gain is None else self.error_gain[block])
        matrix, log_det = whiten_covariance(covariance + spread @ np.swapaxes(spread, -1, -2))
        weight[..., places] = log_weight[..., places] = 0.0
        return Whitening(weight, matrix, places, log_weight.sum(axis=-1) + log_det)

    def linearise(
        self, theta: Array, pose: Array, white: Whitening, with_parameters: bool = False
    ) -> tuple[Array, Array, Array]:
        """Return white errors (C, P, K), H (C, P, K, q) and A (C, P, K, D) of machines (C, D) at poses (C, P, q)."""
        error, by_pose, by_parameters = self.linearise_raw(theta, pose, with_parameters)
        return white.vector(error), white.rows(by_pose), white.rows(by_parameters) if with_parameters else by_parameters

    def linearise_raw(self, theta: Array, pose: Array, with_parameters: bool = False) -> tuple[Array, Array, Array]:
        """Return the same as they are, not white; zero for readings that were not taken."""
        here = self._near.linearise(theta[:, None], pose, with_parameters, self._given)
        error = self.comparison.subtract(self.data.values, here.values)
        slopes = [here.by_pose, here.by_parameters][: 1 + with_parameters]
        by_pose, *more = (self._pull_back(error, here.values, one) for one in slopes)
        return np.where(self.data.present, error, 0.0), by_pose, more[0] if more else here.by_parameters

    def _pull_back(self, error: Array, values: Array, slope: Array) -> Array:
        result = np.array(self.comparison.pull_back(error, values, slope))
        result[:, ~self.data.present] = 0.0
        return result

    def stand(self, theta: Array, white: Whitening, start: Array | None = None) -> PoseEstimate:
        """Return machines (C, D) where they explain the readings best, by Gauss and Newton's method.

        Where the density is anchored it starts with chords, whose H is that of `PoseExpansion`, without a derivative;
        where the expansion is good enough it ends there. The last step is taken to first order.
        """
        pose = np.broadcast_to(self.start if start is None else start, (len(theta), *self.start.shape)).copy()
        if not pose.shape[-1]:
            error, slope, _ = self.linearise(theta, pose, white)
            return PoseEstimate(pose, error, slope)
        shape, n, q = pose.shape[:2], len(self.model.channels), pose.shape[-1]
        found = PoseEstimate(pose, *(np.empty((*shape, *own)) for own in ((n,), (n, q), (), ())))
        going = np.arange(len(theta))
        if start is None and self.expansion is not None:
            going = self._follow_chords(found, theta, white, self.expansion)
        least, stale = np.full(len(theta), np.inf), np.zeros(len(theta), dtype=int)
        for step in range(1, MAX_STEPS + 1):
            if not len(going):
                break
            size = self._improve(found, going, theta, white)
            far = size > CONSTANT_H_STEP  # where it is not a number the machine cannot stand
            largest = np.nanmax(size, axis=1, initial=0.0)
            gains = largest < SMALLER * least[going]
            stale[going] = np.where(gains, 0, stale[going] + 1)
            least[going] = np.where(gains, largest, least[going])
            still = far.any(axis=1)
            lost = still & ((stale[going] >= MAX_STALE) | (step == MAX_STEPS))  # wandering: no pose
            found.error[going[lost]] = np.where(far[lost, :, None], np.nan, found.error[going[lost]])
            going = going[still & ~lost]
        return found

    def approach_poses(self, theta: Array, white: Whitening) -> Array:
        """Return where machines (C, D) that are much alike explain the readings, (C, P, q), by their mean's slopes."""
        middle, own = theta.mean(axis=0, keepdims=True), white.pick(slice(1))
        at = self.stand(middle, own)
        _, slope, by_parameters = self.linearise(middle, at.pose, own, with_parameters=True)
        moves = -invert(slope[0], 0.0) @ np.nan_to_num(by_parameters[0])
        pose, known = at.pose + np.moveaxis(moves @ (theta - middle).T, -1, 0), np.isfinite(at.error).all(axis=-1)
        return np.where(known[..., None], pose, self.start)

    def _improve(self, found: PoseEstimate, going: np.ndarray, theta: Array, white: Whitening) -> Array:
        """Move some of the machines by a step, or two where H is as good as that of the next pose; return the sizes."""
        theta, white = theta[going], white.pick(going)
        error, raw, _ = self.linearise_raw(theta, found.pose[going])
        error, slope = white.vector(error), white.rows(raw)
        with np.errstate(all="ignore"):
            factor = factorise(slope)
            step, _ = solve_step(slope, factor, error)
            left = subtract_step(slope, step, error)
        assert found.known_volume is not None
        assert found.known_prior is not None
        found.known_volume[going], found.known_prior[going] = log_root(factor), self._weigh_poses(raw)
        pose, size = found.pose[going] + step, np.abs(error - left).max(axis=-1)
        largest = np.nanmax(size, axis=1, initial=0.0)
        near = np.flatnonzero((largest > FIRST_ORDER_STEP) & (largest <= CONSTANT_H_STEP))
        if len(near):
            again = self._errors(theta[near], pose[near], white.pick(near))
            step, left[near] = find_step(slope[near], again)
            pose[near] += step
        found.pose[going], found.error[going], found.slope[going] = pose, left, slope
        return np.asarray(size)

    def subtract_read(self, theta: Array, pose: Array) -> Array:
        """Return readings less those of machines (C, D) at poses (C, P, q), (C, P, K); zero for those not taken."""
        read = self._near.read(theta[:, None], pose, self._given)
        return np.where(self.data.present, self.comparison.subtract(self.data.values, read), 0.0)

    def _errors(self, theta: Array, pose: Array, white: Whitening) -> Array:
        """Return the same white."""
        return white.vector(self.subtract_read(theta, pose))

    def _follow_chords(self, found: PoseEstimate, theta: Array, white: Whitening, near: PoseExpansion) -> np.ndarray:
        """Move machines by chords, each by itself; return which of them have no H that is good enough.

        Where chords go astray a machine stays where it starts.
        """
        good = near.measure(theta) <= near.limit
        close = np.where(good, near.close, LAST_CHORD)
        pose, raw = near.predict(theta)
        slope = white.rows(raw)
        size, going = np.full(pose.shape[:2], np.inf), np.arange(len(theta))
        with np.errstate(all="ignore"):
            factor = factorise(slope)
            for _ in range(MAX_CHORDS):
                every = len(going) == len(theta)
                own = (theta, pose, white) if every else (theta[going], pose[going], white.pick(going))
                part = (slope, factor) if every else (slope[going], [[one[going] for one in row] for row in factor])
                error = self._errors(*own)
                step, size[going] = solve_step(*part, error)
                pose[going] += step
                ended = np.all(size[going] <= close[going, None], axis=1)
                found.error[going] = subtract_step(part[0], step, error)
                going = going[~ended]
                if not len(going):
                    break
            good[going] = False
            assert found.known_volume is not None
            assert found.known_prior is not None
            found.known_volume[:], found.known_prior[:] = log_root(factor), self._weigh_poses(raw)
        astray = ~(np.isfinite(pose).all(axis=-1) & (size < MAX_CHORD))[..., None]
        np.copyto(found.pose, pose, where=~astray)
        found.slope[:] = slope
        return np.flatnonzero(~good)

    def _expand(self, anchor: Array, spread: Array | None, reference: Whitening | None) -> PoseExpansion:
        """Return what machines near an anchor (D,) at the start have in common."""
        white = reference or self.whiten(self.sd[None], np.zeros((1, 1, len(self.model.channels))))
        with np.errstate(all="ignore"):
            _, slope, by_parameters = self.linearise_raw(anchor[None], self.start[None], with_parameters=True)
            inverse = invert(white.rows(slope)[0], 0.0)
            moves = -inverse @ white.rows(by_parameters)[0]
            first = PoseExpansion(
                anchor,
                self.start,
                np.moveaxis(slope[0], -1, 0),
                np.moveaxis(moves, -1, 0),
                self._measure_straightness(anchor, white, slope),
                np.arange(len(anchor)),
                None,
                np.zeros((len(anchor),) * 2),
                -np.inf,
            )
            return first if spread is None else self._bend(first, spread)

    def _measure_straightness(self, anchor: Array, white: Whitening, slope: Array) -> float:
        """Return how many white readings a pose may move by, to first order, by the readings' curvature there."""
        rng, rows = np.random.default_rng(1907), white.rows(slope)
        wanted = rng.standard_normal((TRIALS, *rows.shape[1:3]))
        step, _ = find_step(rows, wanted)
        size = np.linalg.norm(subtract_step(rows, step, np.zeros_like(wanted)), axis=-1, keepdims=True)
        step /= size
        theta = np.broadcast_to(anchor, (TRIALS, len(anchor)))
        up, down, here = (self._errors(theta, self.start + sign * step, white) for sign in (1.0, -1.0, 0.0))
        curvature = 0.5 * np.nan_to_num(np.abs(up + down - 2.0 * here)).max(initial=0.0)
        return float(
            np.clip(np.sqrt(MAX_FIRST_ORDER_ERROR / max(curvature, MAX_FIRST_ORDER_ERROR)), FIRST_ORDER_STEP, 1.0)
        )

    def _bend(self, first: PoseExpansion, spread: Array) -> PoseExpansion:
        """Return an expansion with derivatives of H by what differs among machines (n, D)."""
        free = np.flatnonzero((spread != spread[:1]).any(axis=0))
        if not len(free) or len(free) * first.slope.size > LARGEST:
            return first
        change = np.zeros((len(free), len(first.anchor)))
        change[np.arange(len(free)), free] = DERIVATIVE_STEP * spread[:, free].std(axis=0)
        pose = np.tensordot(change, first.moves, 1)
        bends = np.empty((len(free), *first.slope.shape))
        for part in self.batches(len(free)):
            up, down = (
                self.linearise_raw(first.anchor + sign * change[part], first.pose + sign * pose[part])[1]
                for sign in (1.0, -1.0)
            )
            width = 2.0 * change[part].sum(axis=1)
            bends[part] = np.moveaxis(up - down, -1, 1) / width[:, None, None, None]
        bent = replace(first, free=free, bends=bends, limit=np.inf)
        # constraints as readings of their unit's usual noise: beside their own all else would be no change
        loose = np.where(self.data.present & (self.data.sd == 0.0), self.sd / CONSTRAINT, self.sd)
        white = self.whiten(loose[None], np.zeros((1, 1, loose.shape[-1])))
        inverse = invert(white.rows(np.moveaxis(first.slope, 0, -1)[None])[0], 0.0)
        rows, metric = white.rows(bent.by_parameter), np.zeros((len(free), len(free)))
        for p in range(self.data.n_poses):
            turned = (rows[:, p] @ inverse[p]).reshape(len(free), -1)
            metric += turned @ turned.T
        return replace(bent, metric=metric) if np.isfinite(metric).all() else first

    def limited(self, theta: Array, error: Array) -> Self:
        """Return the same density that uses its expansion as far as it is good enough.

        The error of the log-density grows with the square of the change of H.
        """
        if self.expansion is None or self.expansion.bends is None:
            return self
        square, known, limit = self.expansion.measure(theta), np.isfinite(error), -np.inf
        if known.any():
            per_change = np.divide(np.abs(error), square, out=np.zeros_like(square), where=known & (square > 0.0))
            limit = NATS / max(float(per_change.max()), NATS / LARGEST_CHANGE)
        return replace(self, expansion=replace(self.expansion, limit=limit))

    def is_near(self, theta: Array) -> np.ndarray:
        """Return of which machines (C, D) the density takes H from the expansion, shape (C,)."""
        near = self.expansion
        return np.zeros(len(theta), dtype=bool) if near is None else near.measure(theta) <= near.limit

    def differentiate_volume(self, theta: Array, white: Whitening, slope: Array) -> Array | None:
        """Return the derivative of Σ `log_volume` by the parameters, (D,), for a machine (D,) of white H (P, K, q).

        None where H is not taken from the expansion.
        """
        near = self.expansion
        if not self.start.shape[-1]:
            return np.zeros(len(theta))
        if near is None or not self.is_near(theta[None]).all():
            return None
        result = np.zeros(len(theta))
        result[near.free] = self.differentiate_volumes(theta, white, slope).sum(axis=1)
        return result

    def differentiate_volumes(self, theta: Array, white: Whitening, slope: Array) -> Array:
        """Return the derivatives of each pose's `log_volume` by what the F machines of the expansion differ in, (F, P).

        Arguments as of `differentiate_volume`.
        """
        near, commanded = self.expansion, self.data.commanded
        assert near is not None
        bends = near.by_parameter
        result = -np.einsum("pik,fpki->fp", invert(slope, 0.0), white.rows(bends), optimize=True)
        if commanded is not None:
            own = np.where(commanded[..., None], near.predict(theta[None])[1][0], 0.0)
            result += np.einsum("pik,fpki->fp", invert(own, 0.0), bends, optimize=True)
        return result

    # --- density -------------------------------------------------------------------------------------------------

    def batches(self, n: int, rows: int = ROWS) -> Iterator[slice]:
        """Yield slices of n machines that are looked at together, at so many poses of all of them."""
        count = -(-n // max(1, rows // self.data.n_poses))
        ends = np.arange(count + 1) * n // max(1, count)
        yield from (slice(int(one), int(other)) for one, other in pairwise(ends))

    def offset(self, white: Whitening, at: PoseEstimate) -> Array:
        """Return what the log-density of each pose has beside that of the white residual, (C, P)."""
        return np.asarray(white.log_det + self.log_volume(at, white))

    def log_volume(self, at: PoseEstimate, white: Whitening) -> Array:
        """Return the log of what white readings leave of the pose's volume, times its prior density there, (C, P)."""
        prior = self._weigh_poses(at.slope, white) if at.known_prior is None else at.known_prior
        return np.asarray(prior - at.volume)

    def _weigh_poses(self, slope: Array, white: Whitening | None = None) -> Array:
        """Return the log-density of poses before anything is read, (C, P), from H (C, P, K, q), white by ``white``."""
        commanded = self.data.commanded
        if commanded is None or not slope.shape[-1]:
            return np.full(slope.shape[:2], -np.log(self.volume))
        if white is not None:
            slope = np.stack([white.colour(slope[..., i]) for i in range(slope.shape[-1])], axis=-1)
        some = commanded.any(axis=0)
        measure = half_log_volume(np.where(commanded[:, some, None], slope[:, :, some], 0.0))
        return np.where(commanded.any(axis=1), measure, -np.log(self.volume))


def search_poses(likelihood: PoseElimination, theta: Array, white: Whitening, start: Array) -> tuple[Array, Array]:
    """Return poses (C, P, q) that explain readings of a machine (D,) better, and what they leave, r² (C, P).

    By damped steps: slower than `PoseElimination.stand`, they find the way from C starts (C, P, q) that are far off.
    The way of a start ends where it joins that of a better one of the same pose.

    Parameters
    ----------
    likelihood : PoseElimination
    theta : ndarray, shape (D,)
    white : Whitening
        Of one machine, (1, P, K).
    start : ndarray, shape (C, P, q)
    """
    bare, (n_starts, n, _) = replace(likelihood, expansion=None), start.shape
    at_once = max(1, ROWS // n_starts)
    parts = [slice(k, k + at_once) for k in range(0, n, at_once)]
    found = [_search(bare, theta, white, start[:, part], np.arange(n)[part]) for part in parts]
    return np.concatenate([one for one, _ in found], axis=1), np.concatenate([one for _, one in found], axis=1)


def _search(
    likelihood: PoseElimination, theta: Array, white: Whitening, start: Array, rows: np.ndarray
) -> tuple[Array, Array]:
    """Return the same of some poses, by their places (P,); only starts that are still on their way are looked at."""
    shape, every, q = start.shape[:2], np.tile(rows, len(start)), start.shape[2]

    def look(which: np.ndarray, pose: Array) -> tuple[Array, Array, Array]:
        own = every[which]
        error, slope, _ = likelihood.pick(own).linearise(theta[None], pose[None], white.at_poses(own))
        return error[0], slope[0], np.einsum("pk,pk->p", error[0], error[0])

    pose, joined = start.reshape(len(every), q).copy(), np.tile(JOINED * np.ptp(start, axis=0), (len(start), 1))
    damping, idle, way = np.full(len(pose), 1e-3), np.zeros(len(pose), dtype=int), np.arange(len(pose))
    error, slope, square = look(way, pose)
    for _ in range(MAX_SEARCH):
        # damping as further readings, of each coordinate by itself, that say it stays
        size = np.sqrt(damping[way])[:, None] * np.linalg.norm(slope[way], axis=-2)
        longer = np.concatenate([slope[way], size[..., None] * np.eye(q)], axis=-2)
        step, _ = find_step(longer[None], np.concatenate([error[way], np.zeros_like(size)], axis=-1)[None])
        moved = np.where(np.isfinite(step[0]), pose[way] + step[0], pose[way])
        other, there, found = look(way, moved)
        better = (found < square[way]) | (np.isnan(square[way]) & np.isfinite(found))
        idle[way] = np.where(better & ~(square[way] - found < 1e-4 * square[way]), 0, idle[way] + 1)
        damping[way] *= np.where(better, 0.1, 10.0)
        gone = way[better]
        pose[gone], error[gone], slope[gone], square[gone] = moved[better], other[better], there[better], found[better]
        best = np.where(np.isfinite(square), square, np.inf).reshape(shape).argmin(axis=0)
        ahead = np.tile(best * shape[1] + np.arange(shape[1]), shape[0])
        behind = (np.abs(pose - pose[ahead]) <= joined).all(axis=1) & (ahead != np.arange(len(pose)))
        way = way[(idle[way] < PATIENCE) & ~behind[way]]
        if not len(way):
            break
    return pose.reshape(start.shape), square.reshape(shape)
