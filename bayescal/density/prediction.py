"""What a posterior predicts for measured poses, and how far the measurements lie from it (RR-8096 figures 15 to 17)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayescal.numerics.geometry import Array

INTERVAL = 0.90
BOUND = 0.95
POSES = 512  # that are summarised together


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predictive summary at P poses; a pose error is measured minus predicted, base frame, mm and rad.

    Coordinates that were not measured are NaN; distances and angles are those along what was, NaN where nothing was.
    """

    error: Array  # (P, 6): error of the posterior mean prediction
    low: Array  # (P, 6): 90 % predictive interval of that error, noise of the measurement included
    high: Array  # (P, 6)
    position_bound: Array  # (P,): 95 % predictive bound of the distance (mm) and of the angle (rad)
    orientation_bound: Array  # (P,)

    def select(self, chosen: np.ndarray) -> Prediction:
        """Return the prediction at some of the poses."""
        return Prediction(**{name: values[chosen] for name, values in vars(self).items()})

    def fill(self, other: Prediction, where: np.ndarray) -> Prediction:
        """Return the prediction with that of others at some of the poses, (P,)."""
        parts = {name: values.copy() for name, values in vars(self).items()}
        for name, values in parts.items():
            values[where] = getattr(other, name)[where]
        return Prediction(**parts)

    @property
    def position_error(self) -> Array:
        """Distance between measured and predicted position, shape (P,), mm."""
        return measure_length(self.error[:, :3])

    @property
    def orientation_error(self) -> Array:
        """Angle of the rotation between measured and predicted orientation, shape (P,), rad."""
        return measure_length(self.error[:, 3:])

    @property
    def coverage(self) -> float:
        """Share of the measured components inside their 90 % interval."""
        return float(self.inside[np.isfinite(self.error)].mean())

    @property
    def inside(self) -> np.ndarray:
        """Which components lie inside their 90 % interval, shape (P, 6); none that was not measured."""
        return (self.low <= self.error) & (self.error <= self.high)


def measure_length(vector: Array) -> Array:
    """Return the lengths of vectors (..., 3) along what is no NaN, NaN where everything is."""
    known = np.isfinite(vector)
    return np.where(known.any(axis=-1), np.linalg.norm(np.where(known, vector, 0.0), axis=-1), np.nan)


def summarise_errors(error: Array, noise: Array) -> Prediction:
    """Return the predictive summary of errors by draws (S, P, 6), measured minus predicted, and of their noise."""
    mean, parts = error.mean(axis=0), list[tuple[Array, ...]]()
    for some in (slice(k, k + POSES) for k in range(0, len(mean), POSES)):
        # measured minus mean prediction, had the draw been the truth
        spread = noise[:, some] - (error[:, some] - mean[some])
        low, high = np.quantile(spread, [0.5 - INTERVAL / 2, 0.5 + INTERVAL / 2], axis=0)
        bounds = (np.quantile(measure_length(spread[..., k : k + 3]), BOUND, axis=0) for k in (0, 3))
        parts.append((low, high, *bounds))
    return Prediction(mean, *(np.concatenate(one) for one in zip(*parts, strict=True)))


def compute_elpd(pointwise: Array) -> float:
    """Return the expected log predictive density of poses that did not enter the posterior, draws (S, P).

    Each pose counts by itself: the sum over poses of the logarithm of its mean density.
    """
    return float(np.sum(logsumexp(pointwise, axis=0) - np.log(len(pointwise))))
