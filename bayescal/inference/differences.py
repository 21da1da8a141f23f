"""Gradient and Hessian of a density by differences, all points in one batch: cheaper than as many exact gradients."""

from __future__ import annotations

import numpy as np

from bayescal.inference.importance import LogDensity, evaluate_in_batches
from bayescal.numerics.geometry import Array


def difference_twice(log_density: LogDensity, centre: Array, factor: Array, step: float) -> tuple[Array, Array]:
    """Return gradient (n,) and Hessian (n, n) in whitened coordinates w, x = centre + factor w, by central differences.

    Both are NaN where the density is not finite at every point.
    """
    n = len(centre)
    unit = step * np.eye(n)
    first, second = np.triu_indices(n, 1)
    pairs = unit[first] + unit[second]
    points = np.concatenate([np.zeros((1, n)), unit, -unit, pairs, -pairs])
    values = evaluate_in_batches(log_density, centre + points @ factor.T)
    if not np.isfinite(values).all():
        return np.full(n, np.nan), np.full((n, n), np.nan)
    middle, up, down, both_up, both_down = np.split(values, np.cumsum([1, n, n, len(pairs)]))
    gradient, hessian = (up - down) / (2 * step), np.zeros((n, n))
    off = both_up + both_down - (up + down)[first] - (up + down)[second] + 2 * middle
    hessian[first, second] = hessian[second, first] = off / (2 * step**2)
    hessian[np.diag_indices(n)] = (up + down - 2 * middle) / step**2
    return gradient, hessian
