"""What a posterior with a structured model error predicts: the error at a pose is interpolated from the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.density.batches import batches
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.prediction import Replicates
from bayescal.density.structured import StructuredLikelihood
from bayescal.numerics.geometry import Array

BATCH_OF_DRAWS = 64


@dataclass(frozen=True, eq=False)
class StructuredError:
    """The structured error g of every leg at P poses, in the unit of the actuators, mm.

    Attributes
    ----------
    mean, low, high : ndarray, shape (P, N)
        Posterior mean and 90 % interval.
    size : ndarray, shape (S, N)
        Root mean square over the poses, draw by draw.
    slopes : ndarray, shape (S, N, N)
        Linear part, draw by draw: error of each leg per actuator at the end of its range.
    """

    mean: Array
    low: Array
    high: Array
    size: Array
    slopes: Array


def predict_structured(
    likelihood: StructuredLikelihood,
    poses: PoseLikelihood,
    theta: Array,
    model_error: Array,
    rng: np.random.Generator,
) -> tuple[Replicates, StructuredError]:
    """Return what is predicted at P poses by S draws, θ (S, D) and model errors (S, 2 N), and the error g.

    The poses that calibrate are predicted as if they were measured once more.
    """
    gain, n = poses.gain, likelihood.n_legs
    errors, noise, means, draws = [], [], [], []
    for start in range(0, len(theta), BATCH_OF_DRAWS):
        part = slice(start, start + BATCH_OF_DRAWS)
        mean, covariance = likelihood.condition(poses, theta[part], model_error[part])
        root = _factor(covariance)
        drawn = np.einsum("bpij,bpj->bpi", root, rng.standard_normal(mean.shape))
        own = np.linalg.cholesky(poses.pose_covariance(model_error[part, :n]))
        errors.append(np.einsum("pij,bpj->bpi", gain, poses.errors(theta[part]) - mean))
        noise.append(np.einsum("bpij,bpj->bpi", own, rng.standard_normal(errors[-1].shape)))
        noise[-1] += np.einsum("pij,bpj->bpi", gain, drawn)
        means.append(mean)
        draws.append(mean + drawn)
    per_actuator = likelihood.per_actuator
    drawn = np.concatenate(draws) / per_actuator
    low, high = np.quantile(drawn, [0.05, 0.95], axis=0)
    mean, size = np.concatenate(means).mean(axis=0) / per_actuator, np.sqrt(np.mean(drawn**2, axis=1))
    linear = np.linalg.pinv(likelihood.inputs_of(poses))
    error = StructuredError(mean, low, high, size, np.einsum("jp,spi->sij", linear, drawn))
    return Replicates(np.concatenate(errors), np.concatenate(noise)), error


def _factor(covariance: Array) -> Array:
    """Return a square root of covariances (..., N, N) that may be singular: without a structured error they vanish."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])


def pointwise_given(
    likelihood: StructuredLikelihood, poses: PoseLikelihood, theta: Array, model_error: Array
) -> tuple[Array, Array]:
    """Return the log-density of each held-back pose by itself, (S, Q), and of all together, (S,), given calibration."""
    single, together, n = [], [], likelihood.n_legs
    for part in batches(len(theta)):
        mean, covariance = likelihood.condition(poses, theta[part], model_error[part])
        tau = poses.actuator_weight * model_error[part, None, :n] ** 2
        total = covariance + poses.legs_known + np.eye(n) * tau[..., None, :]
        factor = np.linalg.cholesky(total)
        white = np.linalg.solve(factor, (poses.errors(theta[part]) - mean)[..., None])[..., 0]
        half_log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
        single.append(poses.log_constant - half_log_det - 0.5 * np.sum(white**2, axis=-1))
        together.append(likelihood.joint(poses, theta[part], model_error[part]))
    return np.concatenate(single), np.concatenate(together)
