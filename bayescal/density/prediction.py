"""What a posterior predicts for measured poses, and how far the measurements lie from it (RR-8096 figures 15 to 17).

Where errors are functions of the pose the error at a pose is interpolated from those at the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayescal.density.functions import FunctionLikelihood, LegRows
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.legs import Likelihood, batches
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


@dataclass(frozen=True, eq=False)
class Replicates:
    """What posterior draws predict for P measured poses, measurement errors included."""

    errors: Array  # (S, P, 6): measured minus predicted pose of each draw (mm, rad; base frame)
    noise: Array  # (S, P, 6): errors of the measurement that were drawn with each draw's covariance

    @property
    def misfit(self) -> Array:
        """Measured minus replicated pose, shape (S, P, 6): the same for every model, whatever it predicts."""
        return self.errors - self.noise

    def summarise(self) -> Prediction:
        """Return mean, intervals and bounds."""
        return _summarise(self.errors.mean(axis=0), self.errors, self.noise)


def replicate(likelihood: Likelihood, theta: Array, model_error: Array, rng: np.random.Generator) -> Replicates:
    """Return replicates of the measured poses.

    Parameters
    ----------
    likelihood : Likelihood
        Bound to the poses to predict.
    theta : ndarray, shape (S, D)
        Posterior draws.
    model_error : ndarray, shape (S, K) or (K,)
        Their model errors, mm; functions of the pose are drawn with these scales, whatever the data say of them.
    rng : Generator
        For the noise of the predicted measurements.
    """
    errors = likelihood.pose_errors(theta)
    noise = _draw_noise(likelihood, model_error, rng.standard_normal(errors.shape))
    if isinstance(likelihood, FunctionLikelihood):
        base, scales = likelihood.base, np.broadcast_to(model_error, (len(theta), model_error.shape[-1]))
        drawn = np.asarray(sum(likelihood.draw_sorts(likelihood.place, scales, rng)))
        shown = base.gain @ base.rows_of_legs * np.sqrt(base.actuator_weight)[:, None, :]
        noise += np.einsum("pij,spj->spi", shown, drawn)
    return Replicates(errors, noise)


def summarise_misfit(mean: Array, misfit: Array) -> Prediction:
    """Return the predictive summary of a mean prediction's error (P, 6) and of measured minus replicated (S, P, 6)."""
    return _summarise(mean, misfit, np.zeros_like(misfit))


def _summarise(mean: Array, errors: Array, noise: Array) -> Prediction:
    parts = list[tuple[Array, ...]]()
    for some in (slice(k, k + POSES) for k in range(0, len(mean), POSES)):
        # measured minus mean prediction, had the draw been the truth
        spread = noise[:, some] - (errors[:, some] - mean[some])
        low, high = np.quantile(spread, [0.5 - INTERVAL / 2, 0.5 + INTERVAL / 2], axis=0)
        bounds = (np.quantile(measure_length(spread[..., k : k + 3]), BOUND, axis=0) for k in (0, 3))
        parts.append((low, high, *bounds))
    return Prediction(mean, *(np.concatenate(one) for one in zip(*parts, strict=True)))


def _draw_noise(likelihood: Likelihood, model_error: Array, normal: Array) -> Array:
    """Return standard normal numbers (S, P, 6) with the covariance of the measured poses given τ, (S, N) or (N,)."""
    noise = np.empty_like(normal)
    for part in batches(len(normal), normal.shape[1]):
        tau = model_error if model_error.ndim == 1 else model_error[part]
        factor = np.linalg.cholesky(likelihood.pose_covariance(tau))
        noise[part] = (factor @ normal[part][..., None])[..., 0]
    return noise


def compute_elpd(pointwise: Array) -> float:
    """Return the expected log predictive density of poses that did not enter the posterior, draws (S, P).

    Each pose counts by itself: the sum over poses of the logarithm of its mean density.
    """
    return float(np.sum(logsumexp(pointwise, axis=0) - np.log(len(pointwise))))


def compute_joint_elpd(pointwise: Array) -> tuple[float, float]:
    """Return the log predictive density of all poses together, from draws (S, P), and its Monte Carlo standard error.

    What one such pose tells of the machine counts for the next: log of the mean over draws of the product over poses.
    """
    joint = pointwise.sum(axis=1)
    value = logsumexp(joint) - np.log(len(joint))
    return float(value), float(np.std(np.exp(joint - value), ddof=1) / np.sqrt(len(joint)))


# --- functions of several sorts --------------------------------------------------------------------------------------

FUNCTION_DRAWS = 150
"""Of the posterior, for which the functions are drawn."""


@dataclass(frozen=True, eq=False)
class FunctionDraws:
    """The errors of N legs that are functions of the pose, of C sorts, as T draws have them, mm along the actuators."""

    mean: Array  # (P, N): at all poses, of all sorts together, posterior mean and 90 % interval
    low: Array  # (P, N)
    high: Array  # (P, N)
    size: Array  # (T, C): root mean square over calibration poses and legs of each sort
    by_leg: Array  # (T, N): root mean square over calibration poses, of all sorts together
    mean_by_leg: Array  # (C, N): root mean square over calibration poses of the posterior mean of each sort


def draw_functions(
    likelihood: FunctionLikelihood, others: LegRows | None, theta: Array, model_error: Array, rng: np.random.Generator
) -> FunctionDraws:
    """Return the functions at the calibration poses and at others behind them, of draws (T, D) and (T, N + C)."""
    own, totals, sizes, expected = slice(0, likelihood.n_poses), list[Array](), list[Array](), list[Array]()
    for part in likelihood.batches(len(theta)):
        mean, drawn = likelihood.draw(others, theta[part], model_error[part], rng)
        expected.append(mean.sum(axis=0))
        totals.append(drawn.sum(axis=1))
        sizes.append(np.sqrt(np.mean(drawn[:, :, own] ** 2, axis=(2, 3))))
    total, mean = np.concatenate(totals), np.sum(expected, axis=0) / len(theta)
    low, high = np.quantile(total, [0.5 - INTERVAL / 2, 0.5 + INTERVAL / 2], axis=0)
    return FunctionDraws(
        mean.sum(axis=0),
        low,
        high,
        np.concatenate(sizes),
        np.sqrt(np.mean(total[:, own] ** 2, axis=1)),
        np.sqrt(np.mean(mean[:, own] ** 2, axis=1)),
    )


@dataclass(frozen=True, eq=False)
class Given:
    """Poses as draws predict them from the errors at the calibration poses, a calibration pose from all others."""

    pointwise: Array  # (S, Q): log-density of each
    together: Array | None  # (S,): of all of them; of the calibration poses there is none
    replicates: Replicates  # of the chosen draws


def predict_given(
    likelihood: FunctionLikelihood,
    others: LegRows | None,
    theta: Array,
    model_error: Array,
    chosen: np.ndarray,
    rng: np.random.Generator,
) -> Given:
    """Return what draws predict of other poses, or, where there are none, of each calibration pose without itself.

    Parameters
    ----------
    likelihood : FunctionLikelihood
        Of the calibration poses.
    others : PoseLikelihood, InstrumentLikelihood or None
    theta : ndarray, shape (S, D)
    model_error : ndarray, shape (S, N + C)
    chosen : ndarray of int, shape (T,)
        Draws whose replicates are wanted, in ascending order.
    rng : Generator
    """
    poses, together = others or likelihood.base, list[Array]()
    single = np.empty((len(theta), poses.n_poses))
    errors, noise = (np.empty((len(chosen), *poses.gain.shape[:2])) for _ in range(2))
    for part in likelihood.batches(len(theta), 0 if others is None else others.n_poses):
        if others is None:
            rows, own = likelihood.leave_out(theta[part], model_error[part])
        else:
            rows, own, of_all = likelihood.predict(others, theta[part], model_error[part])
            together.append(of_all)
        factor = np.linalg.cholesky(own)
        single[part] = _weigh(rows, factor) + poses.log_constant
        there = (chosen >= part.start) & (chosen < part.stop)
        mine = chosen[there] - part.start
        normal = rng.standard_normal((len(mine), *rows.shape[1:], 1))
        errors[there] = (poses.gain @ rows[mine][..., None])[..., 0]
        noise[there] = (poses.gain @ (factor[mine] @ normal))[..., 0]
    total = np.concatenate(together) + poses.log_constant.sum() if together else None
    if isinstance(poses, InstrumentLikelihood):
        errors[:, ~poses.instrument.rows.measured] = np.nan
    return Given(single, total, Replicates(errors, noise))


def _weigh(rows: Array, factor: Array) -> Array:
    """Return normal log-densities of rows (..., M) but for 2 π, with Cholesky factors (..., M, M)."""
    white = np.linalg.solve(factor, rows[..., None])[..., 0]
    half_log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
    return np.asarray(-half_log_det - 0.5 * np.sum(white**2, axis=-1))
