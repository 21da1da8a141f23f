"""Readings predicted from others of the same pose, and how they are held back."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationLikelihood
from bayescal.density.calibration.posterior import CalibrationPosterior
from bayescal.numerics.geometry import Array

INTERVAL = 0.9


@dataclass(frozen=True, eq=False)
class ReadingPredictions:
    """Readings, each predicted from the pose's other readings.

    Attributes
    ----------
    pose, channel : ndarray of int, shape (n,)
        Which reading of which pose.
    measured, mean, sd, low, high : ndarray, shape (n,)
        In the channels' units; the 90 % interval holds the reading's noise.
    """

    pose: np.ndarray
    channel: np.ndarray
    measured: Array
    mean: Array
    sd: Array
    low: Array
    high: Array

    @property
    def inside(self) -> np.ndarray:
        """Which readings lie in their intervals, shape (n,)."""
        return (self.low <= self.measured) & (self.measured <= self.high)


def predict_readings(
    posterior: CalibrationPosterior, held: CalibrationLikelihood, y: Array, rng: np.random.Generator
) -> ReadingPredictions:
    """Return what draws of a posterior predict for each reading of held-back poses from the other readings there.

    Given a machine, the pose that the other readings tell is normal about the best one, to first order. A reading
    without which the pose is not told is left out.

    Parameters
    ----------
    posterior : CalibrationPosterior
        Of other poses.
    held : CalibrationLikelihood
        Of the held-back ones.
    y : ndarray, shape (T, n)
        Draws.
    rng : Generator
    """
    q, parts = len(held.model.coordinates), []
    for channel in np.flatnonzero(held.data.present.any(axis=0)):
        others = np.arange(len(held.model.channels)) != channel
        enough = held.data.present[:, channel] & (held.data.present[:, others].sum(axis=1) >= q)
        if enough.any():
            where = np.flatnonzero(enough)
            mean, spread = _predict(posterior, held.pick(where), int(channel), y, rng)
            told = np.isfinite(mean).all(axis=0) & np.isfinite(spread).all(axis=0)
            if told.any():
                parts.append((where[told], int(channel), mean[:, told], spread[:, told]))
    return _collect(held, parts)


def _predict(
    posterior: CalibrationPosterior, held: CalibrationLikelihood, channel: int, y: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return predicted means and noisy values of a channel, both (T, P)."""
    others = np.arange(len(held.model.channels)) != channel
    rest = replace(held, data=held.data.only(others), anchor=None)
    theta = posterior.theta(y)
    own, tau = posterior.noise.deviations(y[:, posterior.n_geometry :], held.sd)
    mean, spread = (np.empty((len(y), held.data.n_poses)) for _ in range(2))
    given = {name: value[None] for name, value in held.data.given.items()}
    for part in rest.batches(len(y)):
        white = rest.whiten(own[part], tau[part])
        at = rest.stand(theta[part], white)
        here = held.model.linearise(theta[part][:, None], at.pose, False, given)
        slope = here.by_pose[..., channel, :]
        across = np.swapaxes(at.slope, -1, -2) @ at.slope
        told = np.isfinite(at.error).all(axis=-1) & (np.linalg.det(np.nan_to_num(across)) > 0.0)
        inner = np.linalg.inv(np.where(told[..., None, None], across, np.eye(across.shape[-1])))
        variance = np.where(told, np.einsum("tpi,tpij,tpj->tp", slope, inner, slope), np.nan)
        variance = variance + own[part][..., channel] ** 2 + tau[part][..., channel] ** 2
        mean[part] = here.values[..., channel]
        spread[part] = np.sqrt(variance * _widen(rest, at.square, rng))
    return mean, mean + spread * rng.standard_normal(mean.shape)


def _widen(rest: CalibrationLikelihood, square: Array, rng: np.random.Generator) -> Array:
    """Return draws of 1/w, the factor on a pose's variances given what is left of its other readings."""
    if not np.isfinite(rest.freedom):
        return np.ones_like(square)
    m = rest.n_readings - len(rest.model.coordinates)
    shape = np.broadcast_to(0.5 * (rest.freedom + m), square.shape)
    return np.asarray(0.5 * (rest.freedom + square) / rng.standard_gamma(shape))


def _collect(held: CalibrationLikelihood, parts: list[tuple[np.ndarray, int, Array, Array]]) -> ReadingPredictions:
    if not parts:
        none, nothing = np.empty(0, dtype=int), np.empty(0)
        return ReadingPredictions(none, none, nothing, nothing, nothing, nothing, nothing)
    pose = np.concatenate([where for where, *_ in parts])
    channel = np.concatenate([np.full(len(where), k) for where, k, *_ in parts])
    draws = np.concatenate([spread for *_, spread in parts], axis=1)
    low, high = np.quantile(draws, [0.5 - INTERVAL / 2, 0.5 + INTERVAL / 2], axis=0)
    measured = held.data.values[pose, channel]
    centre = np.concatenate([mean.mean(axis=0) for _, _, mean, _ in parts])
    # on a circle, and as a part of a rotation, the reading is the one of its turns that is near the prediction
    turns = np.array([held.model.channels[k].period or np.inf for k in channel])
    shift = np.where(np.isfinite(turns), turns * np.round((measured - centre) / turns), 0.0)
    return ReadingPredictions(pose, channel, measured - np.nan_to_num(shift), centre, draws.std(axis=0), low, high)
