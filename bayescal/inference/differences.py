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
    _, gradient, hessian = difference_many(log_density, centre[None], factor[None], step)
    return gradient[0], hessian[0]


def difference_many(log_density: LogDensity, centres: Array, factors: Array, step: float) -> tuple[Array, Array, Array]:
    """Return value (L,), gradient (L, k) and Hessian (L, k, k) at L centres (L, n), each along its own k columns.

    Derivatives are by w of x = centre + factor w, with factors (L, n, k), and NaN where the density is not finite at
    every point.
    """
    n_centres, _, k = factors.shape
    first, second = np.triu_indices(k, 1)
    n_points = 1 + 2 * k + 2 * len(first)
    values, at_once = np.empty((n_centres, n_points)), max(1, AT_ONCE // n_centres)
    for start in range(0, n_points, at_once):
        points = _list_points(k, step, first, second, slice(start, min(start + at_once, n_points)))
        x = centres[:, None] + points @ np.swapaxes(factors, 1, 2)
        found = evaluate_in_batches(log_density, x.reshape(-1, x.shape[-1]))
        values[:, start : start + at_once] = found.reshape(n_centres, -1)
    values[~np.isfinite(values).all(axis=1), 1:] = np.nan
    parts = np.split(values, np.cumsum([1, k, k, len(first)]), axis=1)
    middle, up, down, both_up, both_down = parts
    gradient, hessian = (up - down) / (2 * step), np.zeros((n_centres, k, k))
    off = both_up + both_down - (up + down)[:, first] - (up + down)[:, second] + 2 * middle
    hessian[:, first, second] = hessian[:, second, first] = off / (2 * step**2)
    hessian[:, np.arange(k), np.arange(k)] = (up + down - 2 * middle) / step**2
    return middle[:, 0], gradient, hessian


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
