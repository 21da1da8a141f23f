"""Gradient and Hessian of a density by differences, all points in one batch: cheaper than as many exact gradients."""

from __future__ import annotations

import numpy as np

from bayescal.inference.importance import LogDensity, evaluate_in_batches
from bayescal.numerics.geometry import Array

AT_ONCE = 2**14  # points, a multiple of a batch: all those of hundreds of coordinates would take gigabytes


def difference_twice(log_density: LogDensity, centre: Array, factor: Array, step: float) -> tuple[Array, Array]:
    """Return gradient (n,) and Hessian (n, n) in whitened coordinates w, x = centre + factor w, by central differences.

    Both are NaN where the density is not finite at every point.
    """
    n = len(centre)
    first, second = np.triu_indices(n, 1)
    n_points = 1 + 2 * n + 2 * len(first)
    values = np.empty(n_points)
    for k in range(0, n_points, AT_ONCE):
        points = _list_points(n, step, first, second, slice(k, min(k + AT_ONCE, n_points)))
        values[k : k + AT_ONCE] = evaluate_in_batches(log_density, centre + points @ factor.T)
    if not np.isfinite(values).all():
        return np.full(n, np.nan), np.full((n, n), np.nan)
    middle, up, down, both_up, both_down = np.split(values, np.cumsum([1, n, n, len(first)]))
    gradient, hessian = (up - down) / (2 * step), np.zeros((n, n))
    off = both_up + both_down - (up + down)[first] - (up + down)[second] + 2 * middle
    hessian[first, second] = hessian[second, first] = off / (2 * step**2)
    hessian[np.diag_indices(n)] = (up + down - 2 * middle) / step**2
    return gradient, hessian


def _list_points(n: int, step: float, first: np.ndarray, second: np.ndarray, part: slice) -> Array:
    """Return some of the points: the centre, steps up and down along each coordinate, then along each pair of them."""
    single, none = np.arange(n), np.full(n, -1)
    one = np.concatenate([[-1], single, single, first, first])[part]
    other = np.concatenate([[-1], none, none, second, second])[part]
    sign = np.repeat([1.0, 1.0, -1.0, 1.0, -1.0], [1, n, n, len(first), len(first)])[part]
    points = np.zeros((len(one), n))
    for which in (one, other):
        rows = np.flatnonzero(which >= 0)
        points[rows, which[rows]] = step * sign[rows]
    return points
