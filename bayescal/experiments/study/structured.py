"""Structured model errors of a study: what is kept of their posteriors, and what the summary says of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayescal.density.legs import batches
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.prediction import pointwise_given, predict_structured
from bayescal.density.priors import LENGTH, LENGTHY, SCALE, is_model_error
from bayescal.density.structured import StructuredLikelihood
from bayescal.experiments.shared.estimate import Fit
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE

if TYPE_CHECKING:
    from bayescal.experiments.shared.study_inputs import Task
    from bayescal.experiments.study.inputs import StudyInputs

FEWEST_DRAWS = 20  # with an error, that its scale is told


def evaluate_structured(
    likelihood: StructuredLikelihood,
    poses: PoseLikelihood,
    theta: Array,
    errors: Array,
    chosen: np.ndarray,
    verification: bool,
    rng: np.random.Generator,
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return densities, predictions and the structured error at the poses of one use, by pose, and what is of all.

    The density of a calibration pose is that given all other poses; that of a verification pose given the calibration.
    """
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
        scales = slice(likelihood.n_legs, 2 * likelihood.n_legs)
        more["structured_present"] = (errors[:, scales] > 0.0).mean(axis=0)
    by_pose = {f"structured_{name}": getattr(error, name) for name in ("mean", "low", "high")}
    misfit = made.misfit.astype(np.float32).swapaxes(0, 1)
    return {"log_likelihood": pointwise.T, "misfit": misfit, **vars(made.summarise()), **by_pose}, more


def describe_structured(inputs: StudyInputs, variant: str, fit: Fit) -> dict[str, Any]:
    """Return how large the structured error of a variant is, along which motion, and what explains it; µm."""
    used, arrays = ~inputs.verification, fit.evaluated
    size = 1e3 * arrays["structured_size"]
    mean = arrays["structured_mean"][used]
    travel, slopes = inputs.displacement[used] / inputs.mechanism.actuator_range, fit_slopes(inputs, arrays)
    sd = arrays["structured_slopes"].std(axis=0)
    return {
        "kernel": _name_kernel(inputs, variant),
        "present": arrays["structured_present"].tolist(),
        "rms_um": {
            "mean": size.mean(axis=0).tolist(),
            "q05": np.quantile(size, 0.05, axis=0).tolist(),
            "q95": np.quantile(size, 0.95, axis=0).tolist(),
        },
        "scale": _describe_scales(inputs, fit.names, fit.draws),
        **_describe_length(inputs, variant, fit.names, fit.draws),
        "slope_um": (1e3 * slopes).tolist(),
        "slope_sd_um": (1e3 * sd).tolist(),
        "linear_share": _share(mean, travel @ slopes.T),
        "surest": _find_surest(slopes, arrays["structured_slopes"]),
        "explained": explain(inputs, arrays),
    }


def _name_kernel(inputs: StudyInputs, variant: str) -> str:
    """Return a variant's kernel with its length, if it has one."""
    config = inputs.variant(variant)
    name = inputs.name_kernel(config)
    if name not in LENGTHY:
        return name
    error = inputs.config.leg_error
    length = "free" if error.lengths_for(config) else f"{error.length_for(config):g}"
    return f"{name}, length {length}"


def _describe_length(inputs: StudyInputs, variant: str, names: Sequence[str], draws: Array) -> dict[str, Any]:
    """Return a length that is free, in ranges of the actuators, as `_describe_scales` has the scales."""
    prior = inputs.config.leg_error.lengths_for(inputs.variant(variant))
    scale, length = (draws[..., [k for k, name in enumerate(names) if name.startswith(one)]] for one in (SCALE, LENGTH))
    there = length[..., 0][(scale > 0.0).any(axis=-1)] if prior else np.empty(0)
    if prior is None or len(there) < FEWEST_DRAWS:
        return {}
    low, middle, high = (float(x) for x in np.quantile(there, [0.05, 0.5, 0.95]))
    left = float(np.log(there).std() / prior.spread)
    return {"length": {"median": middle, "q05": low, "q95": high, "prior_sd_left": left}}


def _describe_scales(inputs: StudyInputs, names: Sequence[str], draws: Array) -> list[dict[str, float]]:
    """Return each scale where there is an error, µm, and the sd of its logarithm over that of the prior.

    Where hardly less is left of the prior's sd the scale is what was stated, not what was measured.
    """
    found = []
    for k in (k for k, name in enumerate(names) if is_model_error(name) and name.startswith(SCALE)):
        there = draws[..., k][draws[..., k] > 0.0]
        if len(there) < FEWEST_DRAWS:
            continue
        low, middle, high = (1e3 * float(x) for x in np.quantile(there, [0.05, 0.5, 0.95]))
        left = float(np.log(there).std() / inputs.config.leg_error.kernel_spread)
        found.append({"median_um": middle, "q05_um": low, "q95_um": high, "prior_sd_left": left})
    return found


def _find_surest(slopes: Array, draws: Array) -> dict[str, float]:
    """Return the leg and actuator whose slope is most of its posterior sd, with its 90 % interval, µm."""
    sd = draws.std(axis=0)
    sure = np.abs(slopes) / np.where(sd > 0.0, sd, np.inf)
    leg, actuator = np.unravel_index(np.argmax(sure), slopes.shape)
    low, high = (1e3 * float(x) for x in np.quantile(draws[:, leg, actuator], [0.05, 0.95]))
    mean = 1e3 * float(slopes[leg, actuator])
    return {"leg": int(leg) + 1, "actuator": int(actuator) + 1, "um": mean, "q05_um": low, "q95_um": high}


def fit_slopes(inputs: StudyInputs, arrays: dict[str, Array]) -> Array:
    """Return by how much each leg errs per actuator at the end of its range, (leg, actuator), mm: the linear part."""
    used = ~inputs.verification
    travel = inputs.displacement[used] / inputs.mechanism.actuator_range
    return np.asarray(np.linalg.lstsq(travel, arrays["structured_mean"][used], rcond=None)[0].T)


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


def tabulate_structured(inputs: StudyInputs, fits: Mapping[Task, Fit]) -> pd.DataFrame:
    """Return the error of every leg at every pose, with its 90 % interval, along the actuator that tells most of it."""
    n_poses, n_legs = inputs.displacement.shape
    use = np.where(inputs.verification, "verification", "calibration")
    frames = []
    for task, fit in fits.items():
        arrays = fit.evaluated
        if "structured_mean" not in arrays:
            continue
        actuators = np.argmax(np.abs(fit_slopes(inputs, arrays)), axis=1)  # whose motion says most of each leg's error
        frames.append(
            pd.DataFrame(
                {
                    "variant": task.variant,
                    "pose": np.repeat(inputs.names, n_legs),
                    "use": np.repeat(use, n_legs),
                    "leg": np.tile(np.arange(1, n_legs + 1), n_poses),
                    "actuator": np.tile(actuators + 1, n_poses),
                    "travel_mm": inputs.displacement[:, actuators].ravel(),
                    **{f"{k}_um": (arrays[f"structured_{k}"] / MICROMETRE).ravel() for k in ("mean", "low", "high")},
                }
            )
        )
    return pd.concat(frames, ignore_index=True)
