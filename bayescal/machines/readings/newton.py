"""Poses of a machine from what its channels read.

Where a machine stands whose commanded channels read given values is the solution v of g(v) = y near home: Gauss and
Newton's steps, followed along the straight way from g(home) to y, so that of several assembly branches home's is kept.
A step into a place where g has no value is halved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from bayescal.machines.readings.base import Given, ReadingModel

WAYS = (4, 32)
"""Steps of the way from home: what fails with few is tried with many."""
ON_THE_WAY = 3  # Newton steps at each of them
MOST = 40  # Newton steps at its end
HALVINGS = 6
TOUCHING = 1e-6  # mm, within which a reading of a contact is zero
ARRIVED = 1e-11  # of a coordinate's scale, below which a step has arrived


type Function = Callable[[Array, np.ndarray], tuple[Array, Array]]
"""From poses (n, q) of some rows (n,) to what is still wanted of g, y - g (n, m), and its slopes ∂g/∂v (n, m, q)."""


def solve(
    miss: Function, first: Array, start: Array, scale: Array, follow: bool, ways: Sequence[int] = WAYS
) -> tuple[Array, np.ndarray]:
    """Return v (P, q) with g(v) = y in the sense of least squares, and which rows have arrived.

    Parameters
    ----------
    miss : callable
    first : ndarray, shape (P, m)
        y - g at the start.
    start : ndarray, shape (P, q)
    scale : ndarray, shape (q,)
        Of the coordinates.
    follow : bool
        Whether the way from the start is followed, to goals y - (1 - t) (y - g(start)); otherwise the start is near.
    ways : sequence of int
        Steps of the way, tried in turn.
    """
    v, found = start.copy(), np.zeros(len(start), dtype=bool)
    for n_steps in ways if follow else (1,):
        rows = np.flatnonzero(~found)
        if not len(rows):
            break
        some = start[rows]
        for k in range(1, n_steps):
            some, _ = _iterate(miss, (1.0 - k / n_steps) * first[rows], some, rows, scale, ON_THE_WAY)
        v[rows], found[rows] = _iterate(miss, np.zeros_like(first[rows]), some, rows, scale, MOST)
    return v, found


def _iterate(
    miss: Function, left: Array, start: Array, rows: np.ndarray, scale: Array, most: int
) -> tuple[Array, np.ndarray]:
    """Return poses after at most so many steps towards goals that leave something (n, m), and which have arrived."""
    v, arrived, going = start.copy(), np.zeros(len(start), dtype=bool), np.ones(len(start), dtype=bool)
    error, slope = miss(v, rows)
    error = error - left
    for _ in range(most):
        going &= np.isfinite(error).all(axis=1) & np.isfinite(slope).all(axis=(1, 2)) & ~arrived
        if not going.any():
            break
        where = np.flatnonzero(going)
        step = scale * np.einsum("nij,nj->ni", np.linalg.pinv(slope[where] * scale), error[where])
        reached = v[where] + step
        new_error, new_slope = miss(reached, rows[where])
        for _ in range(HALVINGS):
            lost = ~np.isfinite(new_error).all(axis=1)
            if not lost.any():
                break
            step[lost] *= 0.5
            reached[lost] = v[where][lost] + step[lost]
            new_error[lost], new_slope[lost] = miss(reached[lost], rows[where][lost])
        v[where], error[where], slope[where] = reached, new_error - left[where], new_slope
        arrived[where] = (np.abs(step) <= ARRIVED * (scale + np.abs(reached))).all(axis=1)
    return v, arrived & np.isfinite(error).all(axis=1)


def locate_pose(
    model: ReadingModel, theta: Array, commands: Array, given: Given, start: Array | None, weights: Array | None
) -> tuple[Array, np.ndarray]:
    """Return the poses of commands; see `ReadingModel.locate`."""
    places, q = model.select(model.commanded), len(model.coordinates)
    known = [] if start is None else [start.shape[:-1]]
    shape = np.broadcast_shapes(theta.shape[:-1], commands.shape[:-1], *known, *(one.shape for one in given.values()))
    flat_theta, goal = _flatten(theta, shape), _flatten(commands, shape)
    at: Mapping[str, Array] = {name: np.broadcast_to(value, shape).ravel() for name, value in given.items()}
    begin = np.tile(model.home_pose, (len(goal), 1)) if start is None else _flatten(start, shape).copy()
    periods = np.array([model.channels[k].period or np.inf for k in places])
    weight = np.ones(len(places)) if weights is None else weights
    first = weight * _wrap(goal - model.read(flat_theta, begin, at)[:, places], periods)

    def miss(pose: Array, rows: np.ndarray) -> tuple[Array, Array]:
        here = model.linearise(flat_theta[rows], pose, False, {name: value[rows] for name, value in at.items()})
        error = _wrap(goal[rows] - here.values[:, places], periods)
        return weight * error, weight[:, None] * here.by_pose[:, places]

    pose, found = solve(miss, first, begin, model.pose_scale, start is None)
    pose[~found] = np.nan
    return pose.reshape(*shape, q), found.reshape(shape)


def share_contacts(model: ReadingModel, n: int) -> np.ndarray:
    """Return which channels are read in each of n rows, bool (n, K): of instruments that touch one in each, in turn."""
    read = np.ones((n, len(model.channels)), dtype=bool)
    for k, name in enumerate(model.contacts):
        read[np.ix_(np.arange(n) % len(model.contacts) != k, model.instrument_places[name])] = False
    return read


def touch(
    model: ReadingModel, theta: Array, start: Array, read: np.ndarray, error: Array, given: Given
) -> tuple[Array, np.ndarray]:
    """Return poses (P, q) near a start at which instruments touch, and which were found.

    Parameters
    ----------
    theta, start : ndarray, shapes (D,) and (P, q)
    read : ndarray of bool, shape (P, K)
        Which channels are read in each row.
    error : ndarray, shape (P, K)
        Errors of the readings: a channel of an instrument that touches is to read zero with them.
    """
    places = np.concatenate([model.instrument_places[name] for name in model.contacts])
    there = read[:, places]

    def miss(pose: Array, rows: np.ndarray) -> tuple[Array, Array]:
        here = model.linearise(theta, pose, False, {name: value[rows] for name, value in given.items()})
        left = np.where(there[rows], -error[rows][:, places] - here.values[:, places], 0.0)
        return left, here.by_pose[:, places] * there[rows][..., None]

    first, _ = miss(start, np.arange(len(start)))
    pose, found = solve(miss, first, start, model.pose_scale, True, WAYS[:1])  # what fails begins elsewhere
    left, _ = miss(pose, np.arange(len(pose)))
    return pose, found & (np.abs(left) < TOUCHING).all(axis=1)


def _flatten(values: Array, shape: tuple[int, ...]) -> Array:
    return np.broadcast_to(values, (*shape, values.shape[-1])).reshape(math.prod(shape), values.shape[-1])


def _wrap(error: Array, periods: Array) -> Array:
    """Return errors (n, C) of channels on a circle the short way round."""
    circle = np.isfinite(periods)
    if circle.any():
        error[:, circle] -= periods[circle] * np.round(error[:, circle] / periods[circle])
    return error
