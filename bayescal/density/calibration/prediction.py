"""Readings predicted from others of the same pose, and how they are held back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.poses import CONSTANT_H_STEP, PoseEstimate
from bayescal.density.elimination import Whitening, factorise, find_step, solve_step, subtract_step
from bayescal.density.prediction import Prediction, summarise_errors
from bayescal.numerics.geometry import Array

INTERVAL = 0.9
PER_PARAMETER, RANK = 4, 1e-10  # draws for each parameter that regression on these takes; of singular values
STRAIGHT, TRIED, CHORDS = 1e-3, 16, 4
"""Deviations of a reading that a second step may move by where H is the same all the way, machines that show it, and
steps by one H before each pose has its own."""
NOT_DETERMINED = "other readings do not determine the pose"
"""Why a reading has no prediction: they are degenerate there, or a draw's machine does not get there."""


@dataclass(frozen=True, eq=False)
class ReadingPredictions:
    """Readings, each predicted from the pose's other readings.

    ``lost`` are those without a prediction: pose, channel, and why in words.
    """

    pose: np.ndarray  # (n,): which reading of which pose
    channel: np.ndarray  # (n,)
    # (n,): in the channels' units; the 90 % interval holds the reading's noise. On a circle, and as a part of a
    # rotation, what is predicted is counted from the reading, the short way round
    measured: Array
    mean: Array  # (n,)
    sd: Array  # (n,)
    low: Array  # (n,)
    high: Array  # (n,)
    lost: tuple[tuple[int, int, str], ...] = ()

    @property
    def inside(self) -> np.ndarray:
        """Which readings lie in their intervals, shape (n,)."""
        return (self.low <= self.measured) & (self.measured <= self.high)


def predict_readings(
    posterior: CalibrationPosterior,
    held: CalibrationLikelihood,
    y: Array,
    rng: np.random.Generator,
    by: np.ndarray | None = None,
) -> ReadingPredictions:
    """Return what draws of a posterior predict for each reading of held-back poses from the other readings there.

    Given a machine, the pose that the other readings tell is normal about the best one, to first order; where noise is
    correlated, theirs tells some of the reading's own. The components of a rotation are predicted without one another.
    A reading without which the pose is not determined has no prediction and is named as lost.

    Parameters
    ----------
    posterior : CalibrationPosterior
        Of other poses.
    held : CalibrationLikelihood
        Of the held-back ones.
    y : ndarray, shape (T, n)
        Draws.
    rng : Generator
    by : ndarray of bool, shape (K,), optional
        Channels by which all others are predicted, instead of each by the others.
    """
    return predict_readings_by(posterior, held, y, rng, [by])[0]


def predict_readings_by(
    posterior: CalibrationPosterior,
    held: CalibrationLikelihood,
    y: Array,
    rng: np.random.Generator,
    choices: Sequence[np.ndarray | None],
) -> list[ReadingPredictions]:
    """Return what `predict_readings` does by each choice of channels, from the same places and common errors."""
    groups = [_list_groups(held, len(y), by) for by in choices]
    every, common = [one for own in groups for one in own], np.zeros((len(y), *held.data.sd.shape))
    if every and posterior.errors.has_columns:
        common = posterior.likelihood.draw_common(*posterior.at(y), rng).at(held.data, held.error_gain)
    for part in held.batches(len(y)) if every else ():
        standing = _Standing.find(posterior, held, y[part])
        for one in every:
            one.predict(part, posterior, standing, common[part], rng)
    return [_collect(held, own) for own in groups]


@dataclass(eq=False)
class _Group:
    """C channels of held-back poses that the same others predict."""

    held: CalibrationLikelihood
    channels: list[int]
    others: np.ndarray  # (K,)
    mean: Array  # with the spread, (T, P, C)
    spread: Array
    going: np.ndarray  # (P,): where no machine has failed so far

    def predict(
        self,
        part: slice,
        posterior: CalibrationPosterior,
        standing: _Standing,
        common: Array,
        rng: np.random.Generator,
    ) -> None:
        """Predict by some of the draws; common errors by draws (T, P, K)."""
        where = np.flatnonzero(self.going)
        if not len(where):
            return
        mean, spread = _predict(posterior, standing.pick(where), self.channels, self.others, common[:, where], rng)
        self.mean[part, where], self.spread[part, where] = mean, spread
        # a reading that one machine does not predict is lost: no other needs to try
        self.going[where] = np.isfinite(spread).any(axis=2).all(axis=0)

    def list_parts(self) -> list[tuple[np.ndarray, int, Array, Array]]:
        """Return of each channel at which poses (n,) it is predicted, with means and noisy values (T, n)."""
        found = []
        for k, channel in enumerate(self.channels):
            where = np.flatnonzero(self.held.data.present[:, channel] & self._is_known(k))
            if len(where):
                found.append((where, channel, self.mean[:, where, k], self.spread[:, where, k]))
        return found

    def list_lost(self) -> list[tuple[int, int, str]]:
        """Return pose, channel and reason of each reading that is not predicted."""
        there, q = self.held.data.present[:, self.others].sum(axis=1), len(self.held.model.coordinates)
        lost = []
        for k, channel in enumerate(self.channels):
            for pose in np.flatnonzero(self.held.data.present[:, channel] & ~self._is_known(k)):
                few = there[pose] < q
                reason = f"{there[pose]} other readings for {q} coordinates" if few else NOT_DETERMINED
                lost.append((int(pose), channel, reason))
        return lost

    def _is_known(self, k: int) -> np.ndarray:
        """Return at which poses every draw predicts the k-th channel, shape (P,)."""
        return np.asarray(np.isfinite(self.mean[..., k] + self.spread[..., k]).all(axis=0))


def _list_groups(held: CalibrationLikelihood, n_draws: int, by: np.ndarray | None) -> list[_Group]:
    """Return the channels that are predicted, each by all others or by a mask (K,), for so many draws."""
    predicted = held.data.present.any(axis=0) & (True if by is None else ~by)
    channels: dict[bytes, list[int]] = {}
    for place in np.flatnonzero(predicted):
        others = _apart(held, int(place)) & (True if by is None else by)
        channels.setdefault(others.tobytes(), []).append(int(place))
    groups = []
    for key, own in channels.items():
        others, shape = np.frombuffer(key, dtype=bool), (n_draws, held.data.n_poses, len(own))
        mean, spread = np.full((2, *shape), np.nan)
        groups.append(_Group(held, own, others, mean, spread, _is_predicted(held, own, others)))
    return groups


def _is_predicted(held: CalibrationLikelihood, channels: Sequence[int], others: np.ndarray) -> np.ndarray:
    """Return at which poses (P,) some of the channels were read, and enough others to tell the pose."""
    determined = held.data.present[:, others].sum(axis=1) >= len(held.model.coordinates)
    return np.asarray(held.data.present[:, channels].any(axis=1) & determined)


@dataclass(frozen=True, eq=False)
class _Standing:
    """T machines at held-back poses, where all readings there put them."""

    held: CalibrationLikelihood
    y: Array  # (T, n)
    theta: Array  # (T, D)
    own: Array  # with tau, the noise's deviations, (T, P, K)
    tau: Array
    near: tuple[Array, Array, Array]  # poses (T, P, q), with `PoseElimination.linearise_raw` there

    @classmethod
    def find(cls, posterior: CalibrationPosterior, held: CalibrationLikelihood, y: Array) -> _Standing:
        """Return where draws (T, n) of a posterior stand."""
        theta, (own, tau) = posterior.theta(y), held.noise(posterior.errors, posterior.zeta(y))
        white = held.whiten(own, tau)
        pose = held.stand(theta, white, held.approach_poses(theta, white)).pose
        error, slope, _ = held.linearise_raw(theta, pose)
        own, tau = (np.broadcast_to(one, error.shape) for one in (own, tau))
        return cls(held, y, theta, own, tau, (pose, error, slope))

    def pick(self, where: np.ndarray) -> _Standing:
        """Return them at some of the poses."""
        pose, error, slope = (one[:, where] for one in self.near)
        own, tau = self.own[:, where], self.tau[:, where]
        return _Standing(self.held.pick(where), self.y, self.theta, own, tau, (pose, error, slope))


def predict_poses(
    posterior: CalibrationPosterior,
    held: CalibrationLikelihood,
    y: Array,
    rng: np.random.Generator,
    by: np.ndarray,
    seen: Sequence[int | None],
    every: Array | None = None,
) -> Prediction:
    """Return how far poses that an instrument saw lie from where draws of a posterior expect them by other channels.

    Parameters
    ----------
    posterior : CalibrationPosterior
    held : CalibrationLikelihood
        Of P poses.
    y : ndarray, shape (T, n)
        Draws.
    rng : Generator
    by : ndarray of bool, shape (K,)
        Channels that tell the pose.
    seen : sequence of int or None, length 6
        Channels that read position and rotation; None where there is none.
    every : ndarray, shape (S, n), optional
        All draws that these were taken from: errors are those of their mean prediction.
    """
    known = [k for k, place in enumerate(seen) if place is not None]
    places = [place for place in seen if place is not None]
    rest = replace(held, data=held.data.only(by), expansion=None)
    theta, (own, tau) = posterior.theta(y), held.noise(posterior.errors, posterior.zeta(y))
    error, noise = np.full((2, len(y), held.data.n_poses, len(seen)), np.nan)
    common = np.zeros((len(y), *held.data.sd.shape))
    if posterior.errors.has_columns:
        common = posterior.likelihood.draw_common(*posterior.at(y), rng).at(held.data, held.error_gain)
    given = {name: value[None] for name, value in held.data.given.items()}
    related = np.broadcast_to(held.correlation, (held.data.n_poses, *held.correlation.shape[1:]))
    factor = np.linalg.cholesky(related[:, places][:, :, places])
    for part in rest.batches(len(y)):
        white = rest.whiten(own[part], tau[part])
        at = rest.stand(theta[part], white, rest.approach_poses(theta[part], white))
        here = held.model.near(held.data.values).linearise(theta[part][:, None], at.pose, False, given)
        left = held.comparison.subtract(held.data.values, here.values)
        slope = held.comparison.pull_back(left, here.values, here.by_pose)[..., places, :]
        moved = _draw_poses(at.slope, rng)
        if posterior.errors.has_columns:  # what errors common to all rows make of the pose, to first order
            moved -= find_step(at.slope, white.vector(np.where(rest.data.present, common[part], 0.0)))[0]
        drawn = own[part][..., places] * (factor @ rng.standard_normal((*left.shape[:2], len(places), 1)))[..., 0]
        error[part][..., known] = left[..., places]
        noise[part][..., known] = drawn + (slope @ moved[..., None])[..., 0]
    found = summarise_errors(error, noise)
    return found if every is None else replace(found, error=found.error + _move_mean(error, theta, posterior, every))


def _move_mean(error: Array, theta: Array, posterior: CalibrationPosterior, every: Array) -> Array:
    """Return by what the mean error (P, 6) of all draws differs from that of T of them, errors (T, P, 6).

    Errors are nearly linear in the parameters, whose mean over all draws is known: by regression on these hardly any
    chance is left of which draws were taken. With few draws for each parameter they stay as they are.
    """
    whole = posterior.theta(every)
    centre, scale = whole.mean(axis=0), whole.std(axis=0)
    free = scale > 0.0
    if len(theta) < PER_PARAMETER * np.count_nonzero(free):
        return np.zeros(error.shape[1:])
    moved = (theta[:, free] - centre[free]) / scale[free]
    off = moved.mean(axis=0)
    slope = np.linalg.pinv(moved - off, rcond=RANK) @ (error - error.mean(axis=0)).reshape(len(error), -1)
    return np.asarray(-(off @ slope)).reshape(error.shape[1:])


def replicate_readings(
    posterior: CalibrationPosterior, y: Array, rng: np.random.Generator, pose: Array | None = None
) -> Array:
    """Return readings of all rows had draws (B, n) been the truth, shape (B, P, K); NaN where none was taken.

    Nobody knows the poses: they are drawn given the readings, to first order, and so are errors common to all rows.
    Where poses are given, (P, q), they are those, alike for all draws, and common errors are drawn from their prior.
    """
    likelihood, errors, data = posterior.likelihood, posterior.errors, posterior.likelihood.data
    given = {name: value[None] for name, value in data.given.items()}
    made = np.full((len(y), *data.values.shape), np.nan)
    for part in likelihood.batches(len(y)):
        theta, own, common = posterior.theta(y[part]), y[part], np.zeros((1, 1, 1))
        white = likelihood.whiten(*posterior.likelihood.noise(posterior.errors, posterior.zeta(own)))
        wider = np.sqrt(errors.tails(posterior.zeta(own)).draw_wide((len(theta), data.n_poses, 1), rng))
        if pose is None:
            at = likelihood.stand(theta, white)
            places = at.pose + wider * _draw_poses(at.slope, rng)
            if errors.has_columns:
                drawn = likelihood.draw_common(*posterior.at(own), rng, (white, at))
                common = drawn.at(data, likelihood.error_gain)
                places -= find_step(at.slope, white.vector(np.where(data.present, common, 0.0)))[0]
        else:
            places = np.broadcast_to(pose, (len(theta), *pose.shape))
            if errors.has_columns:
                common = errors.draw_prior(posterior.zeta(own), data, rng).at(data, likelihood.error_gain)
        read = (
            likelihood.model.read(theta[:, None], places, given) if pose is not None else likelihood.read(theta, places)
        )
        noise = wider * rng.standard_normal((len(theta), *data.values.shape))
        error = white.colour(np.where(data.present, noise, 0.0)) + common
        made[part] = np.where(data.present, likelihood.comparison.add(read, error), np.nan)
    return made


def _draw_poses(slope: Array, rng: np.random.Generator) -> Array:
    """Return draws about zero with the covariance (HᵀH)⁻¹, (B, P, q), for white slopes H (B, P, K, q)."""
    triangle = np.linalg.qr(slope, mode="r")
    normal = rng.standard_normal((*slope.shape[:2], slope.shape[-1], 1))
    return np.asarray(np.linalg.solve(triangle, normal)[..., 0])


def _apart(held: CalibrationLikelihood, channel: int) -> np.ndarray:
    """Return the channels that a channel is predicted from, a mask (K,): all but it and the rest of its rotation."""
    names = np.array([one.rotation for one in held.model.channels])
    return (np.arange(len(names)) != channel) & ((names != names[channel]) | (names == ""))


def _predict(
    posterior: CalibrationPosterior,
    standing: _Standing,
    channels: Sequence[int],
    others: np.ndarray,
    common: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Return means and noisy values (T, P, C) of C channels by the others; common errors by draws (T, P, K)."""
    held, own, tau = standing.held, standing.own, standing.tau
    tails = posterior.errors.tails(posterior.zeta(standing.y))
    rest = replace(held, data=held.data.only(others), expansion=None)
    white = rest.whiten(own, tau)
    at, error, slopes = _stand_by(rest, standing, white)
    error_left, moved = at.error, np.zeros(at.pose.shape)
    if posterior.errors.has_columns:  # what errors common to all rows make of the pose, to first order
        moved, left = find_step(at.slope, white.vector(np.where(rest.data.present, common, 0.0)))
        error_left = at.error - left
    square = np.einsum("tpk,tpk->tp", error_left, error_left)
    mean, spread = np.empty((2, *at.pose.shape[:2], len(channels)))
    for k, channel in enumerate(channels):
        slope = slopes[..., channel, :]
        shift = common[..., channel] - np.einsum("tpq,tpq->tp", slope, moved)
        # what the others' noise tells of this reading's, as in Gaussian regression
        covariance = held.correlation[:, channel] * own * own[..., channel, None]
        told_by = white.vector(np.where(rest.data.present, covariance, 0.0))
        slope = slope - np.einsum("tpk,tpkq->tpq", told_by, at.slope)
        own_noise = own[..., channel] ** 2 + tau[..., channel] ** 2 - (told_by**2).sum(axis=-1)
        variance = _spread_of_pose(slope, at) + own_noise
        predicted = held.data.values[:, channel] - error[..., channel] + shift
        mean[..., k] = predicted + np.einsum("tpk,tpk->tp", told_by, error_left)
        spread[..., k] = np.sqrt(variance * tails.draw_widening(square, rest.n_spare, rng))
    return mean, mean + spread * rng.standard_normal(mean.shape)


def _stand_by(rest: CalibrationLikelihood, standing: _Standing, white: Whitening) -> tuple[PoseEstimate, Array, Array]:
    """Return where some of the readings put the machines, with the errors (T, P, K) of all readings and H there.

    All readings put them close to it: one step does, to first order, at rows where some of the machines show that H is
    the same all the way; elsewhere steps by that H, then by Gauss and Newton's method where these do not end.
    """
    held, theta, (pose, error, raw) = standing.held, standing.theta, standing.near
    there, some = rest.data.present, np.unique(np.linspace(0, len(theta) - 1, TRIED).astype(int))
    slope = white.rows(np.where(there[..., None], raw, 0.0))
    with np.errstate(all="ignore"):
        factor = factorise(slope)
        step, _ = solve_step(slope, factor, white.vector(np.where(there, error, 0.0)))
        moved = pose + step
        again = white.pick(some).vector(np.where(there, held.subtract_read(theta[some], moved[some]), 0.0))
        _, size = solve_step(slope[some], [[one[some] for one in row] for row in factor], again)
    error = subtract_step(raw, step, error)
    bent = np.flatnonzero(~(size <= STRAIGHT).all(axis=0))
    if len(bent):
        raw = raw.copy()
        chords = slope[:, bent], [[one[:, bent] for one in row] for row in factor]
        own = rest.pick(bent), held.pick(bent), white.at_poses(bent)
        moved[:, bent], error[:, bent], raw[:, bent] = _follow_bent(*own, theta, moved[:, bent], *chords)
        slope[:, bent] = own[2].rows(np.where(there[bent][..., None], raw[:, bent], 0.0))
    return PoseEstimate(moved, white.vector(np.where(there, error, 0.0)), slope), error, raw


def _follow_bent(
    rest: CalibrationLikelihood,
    held: CalibrationLikelihood,
    white: Whitening,
    theta: Array,
    pose: Array,
    slope: Array,
    factor: list[list[Array]],
) -> tuple[Array, Array, Array]:
    """Return poses of machines (T, D) by some of the readings, with the errors of all and H there, as they are.

    Steps from poses (T, P, q) by a white H (T, P, K, q) and the factor of HᵀH; by those of each pose where they do not
    end.
    """
    there = rest.data.present
    for _ in range(CHORDS):
        error = white.vector(np.where(there, held.subtract_read(theta, pose), 0.0))
        step, size = solve_step(slope, factor, error)
        pose = pose + step
        ends = (size <= STRAIGHT).all(axis=0)
        if ends.all() or not (size <= CONSTANT_H_STEP).all(axis=0).any():
            break
    lost = np.flatnonzero(~ends)
    if len(lost):
        start = np.where(np.isfinite(pose), pose, held.start)[:, lost]
        at = rest.pick(lost).stand(theta, white.at_poses(lost), start)
        pose[:, lost] = np.where(np.isfinite(at.error).all(axis=-1)[..., None], at.pose, np.nan)
    return pose, *held.linearise_raw(theta, pose)[:2]


def _spread_of_pose(slope: Array, at: PoseEstimate) -> Array:
    """Return the variance by that of the pose, for slopes (T, P, q), NaN where the pose is not told, (T, P)."""
    across = np.swapaxes(at.slope, -1, -2) @ at.slope
    told = np.isfinite(at.error).all(axis=-1) & (np.linalg.det(np.nan_to_num(across)) > 0.0)
    inner = np.linalg.inv(np.where(told[..., None, None], across, np.eye(across.shape[-1])))
    return np.where(told, np.einsum("tpi,tpij,tpj->tp", slope, inner, slope), np.nan)


def _collect(held: CalibrationLikelihood, groups: Sequence[_Group]) -> ReadingPredictions:
    lost = tuple(one for group in groups for one in group.list_lost())
    parts = [part for group in groups for part in group.list_parts()]
    if not parts:
        none, nothing = np.empty(0, dtype=int), np.empty(0)
        return ReadingPredictions(none, none, nothing, nothing, nothing, nothing, nothing, lost)
    pose = np.concatenate([where for where, *_ in parts])
    channel = np.concatenate([np.full(len(where), k) for where, k, *_ in parts])
    draws = np.concatenate([spread for *_, spread in parts], axis=1)
    low, high = np.quantile(draws, [0.5 - INTERVAL / 2, 0.5 + INTERVAL / 2], axis=0)
    centre = np.concatenate([mean.mean(axis=0) for _, _, mean, _ in parts])
    measured = held.data.values[pose, channel]
    return ReadingPredictions(pose, channel, measured, centre, draws.std(axis=0), low, high, lost)


# --- simulated readings ------------------------------------------------------------------------------------------


def draw_readings(
    posterior: CalibrationPosterior, y: Array, pose: Array, rng: np.random.Generator, common: Array | None = None
) -> Array:
    """Return readings (P, K) of a machine at poses (P, q), with the noise of the density, NaN where none is taken.

    Parameters
    ----------
    posterior : CalibrationPosterior
        Of P poses: which readings are taken, what is known besides, stated deviations and their correlation.
    y : ndarray, shape (n,)
        The machine and its noise; NaN are readings that it does not have.
    pose : ndarray, shape (P, q)
    rng : Generator
    common : ndarray, shape (P, K), optional
        Errors common to all rows, as they show in the readings; drawn from their prior where they are not given.
    """
    likelihood = posterior.likelihood
    own, tau = (one[0] for one in posterior.likelihood.noise(posterior.errors, posterior.zeta(y[None])))
    exact = likelihood.model.read(posterior.theta(y[None])[0], pose, likelihood.data.given)
    factor = np.linalg.cholesky(np.broadcast_to(likelihood.correlation, (len(pose), *own.shape[-1:] * 2)))
    noise = own * (factor @ rng.standard_normal((*own.shape, 1)))[..., 0]
    beside, gain = tau * rng.standard_normal(own.shape), likelihood.error_gain
    noise += beside if gain is None else (gain @ beside[..., None])[..., 0]
    noise *= np.sqrt(posterior.errors.tails(posterior.zeta(y[None])).draw_wide((1, len(noise), 1), rng)[0])
    if common is None and posterior.errors.has_columns:
        drawn = posterior.errors.draw_prior(posterior.zeta(y[None]), likelihood.data, rng)
        common = drawn.at(likelihood.data, likelihood.error_gain)[0]
    error = noise if common is None else noise + common
    return np.where(likelihood.data.present, likelihood.comparison.add(exact, error), np.nan)
