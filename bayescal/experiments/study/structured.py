"""Structured model errors of a study: what is kept of their posteriors, and what the summary says of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.density.likelihood import Likelihood, PoseLikelihood, batches
from bayescal.density.structured import StructuredLikelihood
from bayescal.density.structured_posterior import StructuredPosterior
from bayescal.density.structured_prediction import pointwise_given, predict_structured
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from bayescal.experiments.study.inputs import StudyInputs

KEPT_FOR_G = 500  # draws for the error g: its mean and interval need no more


def evaluate_structured(
    posterior: StructuredPosterior,
    poses: Likelihood,
    theta: Array,
    errors: Array,
    chosen: np.ndarray,
    verification: bool,
    rng: np.random.Generator,
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return densities, predictions and the structured error at the poses of one use, by pose, and what is of all.

    The density of a calibration pose is that given all other poses; that of a verification pose given the calibration.
    """
    likelihood = posterior.likelihood
    assert isinstance(likelihood, StructuredLikelihood)
    assert isinstance(poses, PoseLikelihood)
    made, error = predict_structured(likelihood, poses, theta[chosen], errors[chosen], rng)
    more: dict[str, Array] = {}
    if verification:
        pointwise, more["joint_density"] = pointwise_given(likelihood, poses, theta, errors)
    else:
        parts = [likelihood.pointwise(theta[part], errors[part]) for part in batches(len(theta))]
        pointwise = np.concatenate(parts)
        more["calibration_density"] = likelihood(theta, errors)
        more["structured_size"] = error.size
        more["structured_slopes"] = error.slopes
        more["structured_present"] = (errors[:, likelihood.n_legs :] > 0.0).mean(axis=0)
    by_pose = {f"structured_{name}": getattr(error, name) for name in ("mean", "low", "high")}
    misfit = made.misfit.astype(np.float32).swapaxes(0, 1)
    return {"log_likelihood": pointwise.T, "misfit": misfit, **vars(made.summarise()), **by_pose}, more


def describe_structured(inputs: StudyInputs, name: str, arrays: dict[str, Array]) -> dict[str, Any]:
    """Return how large the structured error of a variant is, along which motion, and what explains it; µm."""
    used = ~inputs.verification
    size = 1e3 * arrays["structured_size"]
    mean = arrays["structured_mean"][used]
    travel, slopes = inputs.displacement[used] / inputs.mechanism.actuator_range, fit_slopes(inputs, arrays)
    legs, actuators = np.unravel_index(np.argmax(np.abs(slopes)), slopes.shape)
    return {
        "kernel": inputs.kernel_name(inputs.variant(name)),
        "present": arrays["structured_present"].tolist(),
        "rms_um": {
            "mean": size.mean(axis=0).tolist(),
            "q05": np.quantile(size, 0.05, axis=0).tolist(),
            "q95": np.quantile(size, 0.95, axis=0).tolist(),
        },
        "slope_um": (1e3 * slopes).tolist(),
        "linear_share": _share(mean, travel @ slopes.T),
        "largest": {"leg": int(legs) + 1, "actuator": int(actuators) + 1, "um": float(1e3 * slopes[legs, actuators])},
        "explained": explain(inputs, arrays),
    }


def fit_slopes(inputs: StudyInputs, arrays: dict[str, Array]) -> Array:
    """Return by how much each leg errs per actuator at the end of its range, (leg, actuator), mm: the linear part."""
    used = ~inputs.verification
    travel = inputs.displacement[used] / inputs.mechanism.actuator_range
    return np.asarray(np.linalg.lstsq(travel, arrays["structured_mean"][used], rcond=None)[0].T)


def find_telling_actuators(inputs: StudyInputs, arrays: dict[str, Array]) -> np.ndarray:
    """Return the actuator whose motion tells most of each leg's error, counted from zero, shape (N,)."""
    return np.asarray(np.argmax(np.abs(fit_slopes(inputs, arrays)), axis=1))


def _share(values: Array, explained: Array) -> float:
    """Return the share of the sum of squares that is explained, between 0 and 1; 0 where there is nothing."""
    total = float(np.sum(values**2))
    return 0.0 if total == 0.0 else max(0.0, 1.0 - float(np.sum((values - explained) ** 2)) / total)


def explain(inputs: StudyInputs, arrays: dict[str, Array]) -> dict[str, float]:
    """Return the share of the structured error that each known deformation explains, of what is known of it.

    Compared are the linear parts, N² slopes, in the metric of their posterior: directions that the geometry imitates
    are hardly known and count little. The linear deformation has a coefficient for every leg, the matrix, as it was
    measured or stated, one in all. Without a structured error there is nothing to explain.
    """
    draws = arrays["structured_slopes"].reshape(len(arrays["structured_slopes"]), -1)
    n_legs = inputs.mechanism.n_legs
    covariance = np.cov(draws, rowvar=False)
    if not np.trace(covariance) > 0.0:
        return {}
    values, vectors = np.linalg.eigh(covariance)
    whitening = vectors / np.sqrt(np.maximum(values, 1e-9 * values[-1]))
    own = np.zeros((n_legs**2, n_legs))
    own[np.arange(n_legs) * (n_legs + 1), np.arange(n_legs)] = 1.0
    known = {"linear": own}
    if inputs.measured_matrix is not None or not inputs.matrix_from_targets:
        known["matrix"] = inputs.matrix.reshape(-1, 1)
    return {name: _explain_by(draws.mean(axis=0) @ whitening, whitening.T @ one) for name, one in known.items()}


def _explain_by(values: Array, design: Array) -> float:
    """Return the share of the sum of squares of values (K,) that a design (K, m) explains."""
    return _share(values, design @ np.linalg.lstsq(design, values, rcond=None)[0])
