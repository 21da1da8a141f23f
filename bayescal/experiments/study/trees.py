"""A study's posteriors as ArviZ trees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayescal.experiments.shared.estimate import Fit
from bayescal.experiments.shared.trees import Draws, Group, Readings, build_tree, choose_draws, spread
from bayescal.experiments.study.fit import Legs, Task
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.numerics.geometry import (
    Array,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    rotation_vector_of_turn,
)

if TYPE_CHECKING:
    import xarray as xr

CHANNELS, UNITS = ("x", "y", "z", "rx", "ry", "rz"), ("mm",) * 3 + ("rad",) * 3
MEANING = "measured pose, base frame: position and rotation vector"
NAT = "nat"


def build_study_tree(inputs: StudyInputs, task: Task, fit: Fit) -> xr.DataTree:
    """Return one posterior with draws of its prior, what both predict, and the data."""
    priors, arrays = Legs(inputs, task).posterior.all_priors().values(), fit.evaluated
    (n_chains, n_draws), n_kept = fit.draws.shape[:2], arrays["misfit"].shape[1]
    chosen = choose_draws(n_chains, n_draws, n_kept)
    draws, log_density, log_likelihood = (
        _take(one, chosen) for one in (fit.draws, fit.log_density, arrays["log_likelihood"])
    )
    held, readings = inputs.verification, _read_poses(inputs)
    made = _replicate(readings, _take_replicates(arrays["misfit"], n_chains * n_draws, chosen))
    log_prior = np.stack([prior.log_density(draws[..., k]) for k, prior in enumerate(priors)], axis=-1)
    names = np.array(inputs.names)
    return build_tree(
        Draws(fit.names, fit.units, draws, log_density, log_prior, arrays["prior"]),
        Readings(
            [str(name) for name in names[~held]],
            CHANNELS,
            UNITS,
            readings[~held],
            made[..., ~held, :],
            _replicate(readings[~held], arrays["prior_misfit"]),
            log_likelihood[..., ~held],
            MEANING,
        ),
        _list_groups(inputs, readings, made, log_likelihood),
        variant=task.variant,
        model_error="free" if task.with_model_error else "zero",
        length_unit="mm",
    )


def _take(values: Array, chosen: Array) -> Array:
    """Return some draws of values (E, S, ...), by their places (E, S') in chains laid end to end."""
    return values.reshape(-1, *values.shape[2:])[chosen]


def _take_replicates(misfit: Array, n_draws: int, chosen: Array) -> Array:
    """Return the replicates (P, T, 6) of the chosen draws, shape (E, S', P, 6); they were made of the same draws."""
    made = np.searchsorted(spread(n_draws, misfit.shape[1]), chosen)
    return misfit.swapaxes(0, 1)[made]


def _read_poses(inputs: StudyInputs) -> Array:
    """Return the poses as measured, shape (P, 6); NaN where a coordinate is not."""
    poses = inputs.measured.poses
    known = np.isfinite(poses.rotation).all(axis=(1, 2))[:, None]
    turn = rotation_vector_from_matrix(np.where(known[..., None], poses.rotation, np.eye(3)))
    return np.concatenate([poses.position, np.where(known, turn, np.nan)], axis=-1)


def _replicate(measured: Array, misfit: Array) -> Array:
    """Return replicated poses (..., P, 6) from the measured ones (P, 6) and measured minus replicated (..., P, 6)."""
    rotation = matrix_from_rotation_vector(np.nan_to_num(measured[:, 3:]))
    turn = rotation_vector_of_turn(matrix_from_rotation_vector(-np.nan_to_num(misfit[..., 3:])) @ rotation)
    turn = np.where(np.isfinite(measured[:, 3:] - misfit[..., 3:]), turn, np.nan)
    return np.concatenate([measured[:, :3] - misfit[..., :3], turn], axis=-1).astype(np.float32)


def _list_groups(inputs: StudyInputs, readings: Array, made: Array, log_likelihood: Array) -> dict[str, Group]:
    """Return what is known of the poses besides, and what is predicted of those for verification."""
    poses, held = inputs.measured.poses, inputs.verification
    names = [str(name) for name in inputs.names]
    constant = {
        "rotation": (("pose", "axis", "platform_axis"), poses.rotation, "1", "measured rotation matrix, base frame"),
        "covariance": (("pose", "component", "other_component"), poses.covariance, "mm, rad", "of the measured pose"),
        "actuators": (("pose", "leg"), poses.actuators, "mm", "actuator positions"),
    }
    groups = {"constant_data": Group(constant, {"pose": names, "axis": list("xyz"), "platform_axis": list("xyz")})}
    if held.any():
        own = {"row": [name for name, one in zip(names, held, strict=True) if one], "channel": list(CHANNELS)}
        both, unit, over = ("row", "channel"), "mm, rad", ("chain", "draw")
        predicted = {
            "readings": ((*over, *both), made[..., held, :], unit, "readings that would be measured"),
            "log_density": ((*over, "row"), log_likelihood[..., held], NAT, "log-density of each row"),
        }
        groups["predictions"] = Group(predicted, own)
        groups["predictions_constant_data"] = Group({"readings": (both, readings[held], unit, MEANING)}, own)
    return groups
