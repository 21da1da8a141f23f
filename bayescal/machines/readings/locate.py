"""Where a machine stands whose commanded channels read given values, and where its tool is at a given place.

Both are the solution v of g(v) = y near home: Gauss and Newton's steps, followed along the straight way from g(home)
to y, so that of several assembly branches home's is kept. A step into a place where g has no value is halved.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
ARRIVED = 1e-11  # of a coordinate's scale, below which a step has arrived


type Function = Callable[[Array, np.ndarray], tuple[Array, Array]]
"""From poses (n, q) of some rows (n,) to what is still wanted of g, y - g (n, m), and its slopes ∂g/∂v (n, m, q)."""


def solve(function: Callable[[float], Function], start: Array, scale: Array, follow: bool) -> tuple[Array, np.ndarray]:
    """Return v (n, q) with g(v) = y in the sense of least squares, and which rows have arrived.

    Parameters
    ----------
    function : callable
        From the share t of the way to the function of the goal g(start) + t (y - g(start)).
    start : ndarray, shape (n, q)
    scale : ndarray, shape (q,)
        Of the coordinates.
    follow : bool
        Whether the way from the start is followed; otherwise it is near.
    """
    v, found = start.copy(), np.zeros(len(start), dtype=bool)
    for n_steps in WAYS if follow else (1,):
        rows = np.flatnonzero(~found)
        if not len(rows):
            break
        some, arrived = start[rows].copy(), np.zeros(len(rows), dtype=bool)
        for k in range(1, n_steps):
            some, _ = _iterate(function(k / n_steps), some, rows, scale, ON_THE_WAY)
        some, arrived = _iterate(function(1.0), some, rows, scale, MOST)
        v[rows], found[rows] = some, arrived
    return v, found


def _iterate(wanted: Function, v: Array, rows: np.ndarray, scale: Array, most: int) -> tuple[Array, np.ndarray]:
    """Return poses after at most so many steps, and which have arrived."""
    arrived, going = np.zeros(len(v), dtype=bool), np.ones(len(v), dtype=bool)
    error, slope = wanted(v, rows)
    for _ in range(most):
        going &= np.isfinite(error).all(axis=1) & np.isfinite(slope).all(axis=(1, 2)) & ~arrived
        if not going.any():
            break
        where = np.flatnonzero(going)
        step = scale * np.einsum("nij,nj->ni", np.linalg.pinv(slope[where] * scale), error[where])
        reached = v[where] + step
        new = wanted(reached, rows[where])
        for _ in range(HALVINGS):
            lost = ~np.isfinite(new[0]).all(axis=1)
            if not lost.any():
                break
            step[lost] *= 0.5
            reached[lost] = v[where][lost] + step[lost]
            for whole, part in zip(new, wanted(reached[lost], rows[where][lost]), strict=True):
                whole[lost] = part
        v[where], error[where], slope[where] = reached, *new
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
    first = model.read(flat_theta, begin, at)[:, places]

    def wanted_after(share: float) -> Function:
        def wanted(pose: Array, rows: np.ndarray) -> tuple[Array, Array]:
            some = {name: value[rows] for name, value in at.items()}
            here = model.linearise(flat_theta[rows], pose, False, some)
            error = _wrap(goal[rows] - here.values[:, places], periods)
            left = (1.0 - share) * _wrap(goal[rows] - first[rows], periods)
            return weight * (error - left), weight[:, None] * here.by_pose[:, places]

        return wanted

    pose, found = solve(wanted_after, begin, model.pose_scale, start is None)
    pose[~found] = np.nan
    return pose.reshape(*shape, q), found.reshape(shape)


def _flatten(values: Array, shape: tuple[int, ...]) -> Array:
    return np.broadcast_to(values, (*shape, values.shape[-1])).reshape(-1, values.shape[-1])


def _wrap(error: Array, periods: Array) -> Array:
    """Return errors (n, C) of channels on a circle the short way round."""
    circle = np.isfinite(periods)
    if circle.any():
        error[:, circle] -= periods[circle] * np.round(error[:, circle] / periods[circle])
    return error
