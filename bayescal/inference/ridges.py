"""Curved ridges followed to their ends: what makes up for a coordinate, wherever that goes.

A quadratic holds near a mode. Farther out the coordinates that make up for one are traced: step by step along it, each
time to where the density is largest over those that follow, as in a profile likelihood. The ridge is then a spline and
the shear along it has unit volume. Modes that lie along one coordinate share one spline: it leads from ridge to ridge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from bayescal.inference.mode import Mode
from bayescal.inference.straightening import Ridge, Straightening
from bayescal.inference.target import Target
from bayescal.numerics.geometry import Array

STEP = 0.4  # posterior sds at the mode
MOST_STEPS = 24  # to either side
DROP = 8.0  # nats below the mode, where a ridge has ended
CORRECTIONS = 6  # Newton steps of the coordinates that follow
SETTLED = 1e-2  # nats that another one would gain
ON_RIDGE = 3.0  # conditional sds within which a mode lies on a ridge that was traced from another


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of a ridge: the coordinate along it (m,), ascending, and those that follow (m, k)."""

    along: Array
    following: Array

    def spans(self, u: float) -> bool:
        """Whether a value lies between the ends."""
        return bool(self.along[0] <= u <= self.along[-1])

    def overlaps(self, other: _Points) -> bool:
        """Whether two ridges share values of the coordinate along them."""
        return bool(self.along[0] <= other.along[-1] and other.along[0] <= self.along[-1])


def trace_ridges(straight: Straightening, modes: Sequence[Mode]) -> Straightening:
    """Return the straightening with every curved ridge traced from the modes, best first.

    A coordinate along which modes lie beside each other, not one after the other, keeps the curve that it has.
    """
    posterior, curves = straight.posterior, {curve.base: curve for curve in straight.curves}
    for base, others in posterior.curved_ridges():
        points = _join(posterior, modes, base, others)
        if points is not None:
            curves[base] = _fit(points, modes[0], base, others)
    return replace(straight, curves=tuple(curves.values()))


def _join(posterior: Target, modes: Sequence[Mode], base: int, others: np.ndarray) -> _Points | None:
    """Return the points of all ridges along a coordinate; None where they lie beside each other or lead nowhere."""
    found: list[_Points] = []
    for mode in modes:
        known = [one for one in found if one.spans(mode.y[base])]
        if known and _lies_on(known[0], mode, base, others):
            continue
        traced = _trace(posterior, mode, base, others)
        if traced is None or any(one.overlaps(traced) for one in found):
            return None
        found.append(traced)
    found.sort(key=lambda one: float(one.along[0]))
    return _Points(np.concatenate([one.along for one in found]), np.concatenate([one.following for one in found]))


def _lies_on(points: _Points, mode: Mode, base: int, others: np.ndarray) -> bool:
    off = mode.y[others] - CubicSpline(points.along, points.following)(mode.y[base])
    precision = np.linalg.inv(mode.covariance)[np.ix_(others, others)]
    return bool(off @ precision @ off < ON_RIDGE**2)


def _trace(posterior: Target, mode: Mode, base: int, others: np.ndarray) -> _Points | None:
    """Return the points of a ridge on both sides of a mode; None where one side has none."""
    down, up = (_follow(posterior, mode, base, others, side) for side in (-1.0, 1.0))
    if not down or not up:
        return None
    points = np.stack([*down[::-1], mode.y, *up])
    return _Points(points[:, base], points[:, others])


def _follow(posterior: Target, mode: Mode, base: int, others: np.ndarray, side: float) -> list[Array]:
    """Return points (n,) of the ridge from a mode to where the density has dropped, by prediction and correction."""
    width = np.sqrt(mode.covariance[base, base])
    slope, step = mode.covariance[others, base] / width**2, side * STEP * width
    y, points = mode.y, []
    for _ in range(MOST_STEPS):
        following = y.copy()
        following[base] += step
        following[others] += slope * step
        found = _correct(posterior, following, others)
        if found is None:
            break
        slope = (found[others] - y[others]) / step
        y = found
        points.append(y)
        if posterior.log_density(y[None])[0] < mode.log_density - DROP:
            break
    return points


def _correct(posterior: Target, y: Array, others: np.ndarray) -> Array | None:
    """Return y with the best of the coordinates that follow; None where the density has no such place nearby."""
    y, block = y.copy(), np.ix_(others, others)
    for _ in range(CORRECTIONS):
        if not np.isfinite(posterior.log_density(y[None])[0]):
            return None
        gradient, curvature = posterior.gradient(y)
        try:
            step = np.linalg.solve(-curvature[block], gradient[others])
        except np.linalg.LinAlgError:
            return None
        y[others] += step
        if abs(gradient[others] @ step) < SETTLED:
            return y if np.isfinite(posterior.log_density(y[None])[0]) else None
    return None


def _fit(points: _Points, mode: Mode, base: int, others: np.ndarray) -> Ridge:
    """Return the shear through points, less its value and slope at the first mode, where the coordinates stay."""
    through, u = CubicSpline(points.along, points.following), mode.y[base]
    straight = through(u) + (points.along - u)[:, None] * through(u, 1)
    ends = float(points.along[0]), float(points.along[-1])
    return Ridge(base, others, ends, CubicSpline(points.along, points.following - straight))
