"""What a posterior predicts for measured poses, and how far the measurements lie from it (RR-8096 figures 15 to 17)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayescal.density.likelihood import Likelihood, batches
from bayescal.numerics.geometry import Array

INTERVAL = 0.90
BOUND = 0.95


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predictive summary at P poses; a pose error is measured minus predicted, base frame, mm and rad.

    Coordinates that were not measured are NaN; distances and angles are those along what was, NaN where nothing was.

    Attributes
    ----------
    error : ndarray, shape (P, 6)
        Error of the posterior mean prediction.
    low, high : ndarray, shape (P, 6)
        90 % predictive interval of that error, noise of the measurement included.
    position_bound, orientation_bound : ndarray, shape (P,)
        95 % predictive bound of the distance (mm) and of the angle (rad).
    """

    error: Array
    low: Array
    high: Array
    position_bound: Array
    orientation_bound: Array

    def select(self, chosen: np.ndarray) -> Prediction:
        """Return the prediction at some of the poses."""
        return Prediction(**{name: values[chosen] for name, values in vars(self).items()})

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


def predict(likelihood: Likelihood, theta: Array, model_error: Array, rng: np.random.Generator) -> Prediction:
    """Return the predictive summary of posterior draws.

    Parameters
    ----------
    likelihood : Likelihood
        Bound to the poses to predict.
    theta : ndarray, shape (S, D)
        Posterior draws.
    model_error : ndarray, shape (S, N) or (N,)
        Their model errors, mm.
    rng : Generator
        For the noise of the predicted measurements.
    """
    errors = likelihood.pose_errors(theta)
    return summarise_draws(errors, _draw_noise(likelihood, model_error, rng.standard_normal(errors.shape)))


def summarise_draws(errors: Array, noise: Array) -> Prediction:
    """Return the predictive summary of draws (S, P, 6) of pose errors, measured minus predicted, and of their noise."""
    mean = errors.mean(axis=0)
    spread = noise - (errors - mean)  # measured minus mean prediction, had the draw been the truth
    low, high = np.quantile(spread, [0.5 - INTERVAL / 2, 0.5 + INTERVAL / 2], axis=0)
    distance = measure_length(spread[..., :3])
    angle = measure_length(spread[..., 3:])
    return Prediction(mean, low, high, np.quantile(distance, BOUND, axis=0), np.quantile(angle, BOUND, axis=0))


def _draw_noise(likelihood: Likelihood, model_error: Array, normal: Array) -> Array:
    """Return standard normal numbers (S, P, 6) with the covariance of the measured poses given τ, (S, N) or (N,)."""
    noise = np.empty_like(normal)
    for part in batches(len(normal)):
        tau = model_error if model_error.ndim == 1 else model_error[part]
        factor = np.linalg.cholesky(likelihood.pose_covariance(tau))
        noise[part] = (factor @ normal[part][..., None])[..., 0]
    return noise


def compute_elpd(pointwise: Array) -> float:
    """Return the expected log predictive density of poses that did not enter the posterior, draws (S, P)."""
    return float(np.sum(logsumexp(pointwise, axis=0) - np.log(len(pointwise))))
