"""A study's posteriors as ArviZ trees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayescal.density.legs import LegPosterior
from bayescal.experiments.shared.trees import Draws, Group, Replicated, build_tree, choose_draws, spread
from bayescal.experiments.study.fit import Arrays, Task
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.replicates import measure_deviation
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    import xarray as xr

VARIABLE = "measured_pose"
MEANING = (
    "how far the measured pose lies from the one of the machine as expected, in standard deviations of the stated noise"
)
NAT = "nat"


def build_study_tree(inputs: StudyInputs, task: Task, arrays: Arrays) -> xr.DataTree:
    """Return one posterior with draws of its prior, what both predict, and the data."""
    posterior = inputs.posterior(inputs.variant(task.variant), task.with_model_error)
    (n_chains, n_draws), n_kept = arrays["draws"].shape[:2], arrays["misfit"].shape[1]
    chosen = choose_draws(n_chains, n_draws, n_kept)
    thin = {name: _take(arrays[name], chosen) for name in ("draws", "log_density", "log_likelihood")}
    misfit = _take_replicates(arrays["misfit"], arrays["draws"], chosen)
    held, names = inputs.verification, np.array(inputs.names)
    return build_tree(
        Draws(
            posterior.names,
            _list_units(posterior),
            thin["draws"],
            thin["log_density"],
            _evaluate_priors(posterior, thin["draws"]),
            arrays["prior"],
        ),
        Replicated(
            VARIABLE,
            "1",
            MEANING,
            measure_deviation(arrays["start_error"], arrays["whitening"]),
            _deviate(arrays, misfit[..., ~held, :]),
            _deviate(arrays, arrays["prior_misfit"]),
            thin["log_likelihood"][..., ~held],
        ),
        [str(name) for name in names[~held]],
        _list_groups(inputs, arrays["start_error"], misfit, thin["log_likelihood"]),
        variant=task.variant,
        model_error="free" if task.with_model_error else "zero",
        length_unit="mm",
    )


def _take(values: Array, chosen: Array) -> Array:
    """Return some draws of values (E, S, ...), by their places (E, S') in chains laid end to end."""
    return values.reshape(-1, *values.shape[2:])[chosen]


def _take_replicates(misfit: Array, draws: Array, chosen: Array) -> Array:
    """Return the replicates (P, T, 6) of the chosen draws, shape (E, S', P, 6); they were made of the same draws."""
    made = np.searchsorted(spread(draws.shape[0] * draws.shape[1], misfit.shape[1]), chosen)
    return misfit.swapaxes(0, 1)[made]


def _deviate(arrays: Arrays, misfit: Array) -> Array:
    """Return how far replicated calibration poses lie from the expected machine's, in units of the noise."""
    return measure_deviation(arrays["start_error"] - misfit, arrays["whitening"]).astype(np.float32)


def _list_units(posterior: LegPosterior) -> list[str]:
    layout = posterior.likelihood.layout
    units = dict(zip(layout.names, layout.units, strict=True))
    return [units.get(name, "mm") for name in posterior.names]


def _evaluate_priors(posterior: LegPosterior, draws: Array) -> Array:
    priors = posterior.all_priors().values()
    return np.stack([prior.log_density(draws[..., k]) for k, prior in enumerate(priors)], axis=-1)


def _list_groups(inputs: StudyInputs, start: Array, misfit: Array, log_likelihood: Array) -> dict[str, Group]:
    """Return the poses as they were measured, and what is predicted of their components."""
    poses, held = inputs.measured.poses, inputs.verification
    names = [str(name) for name in inputs.names]
    own = {
        use: [name for name, one in zip(names, held, strict=True) if one == (use == "verification_pose")]
        for use in ("calibration_pose", "verification_pose")
    }
    axes, over = {"axis": list("xyz")}, ("chain", "draw")
    calibration = {"calibration_pose": own["calibration_pose"], **axes}
    constant = {
        "position": (("pose", "axis"), poses.position, "mm", "measured position, base frame"),
        "rotation": (("pose", "axis", "platform_axis"), poses.rotation, "1", "measured rotation matrix, base frame"),
        "covariance": (("pose", "component", "other_component"), poses.covariance, "mm, rad", "of the measured pose"),
        "actuators": (("pose", "leg"), poses.actuators, "mm", "actuator positions"),
    }
    groups = {
        "constant_data": Group(constant, {"pose": names, **axes, "platform_axis": list("xyz")}),
        "components/observed_data": Group(_name_parts("calibration_pose", (), start, "expected"), calibration),
        "components/posterior_predictive": Group(
            _name_parts("calibration_pose", over, (start - misfit[..., ~held, :]).astype(np.float32), "expected"),
            calibration,
        ),
    }
    if held.any():
        density = ((*over, "verification_pose"), log_likelihood[..., held], NAT, "log-density of each pose")
        parts = _name_parts("verification_pose", over, misfit[..., held, :], "replicated")
        groups["predictions"] = Group(
            {"verification_log_density": density, **{f"verification_{k}_error": v for k, v in parts.items()}},
            {"verification_pose": own["verification_pose"], **axes},
        )
    return groups


def _name_parts(
    dim: str, over: tuple[str, ...], values: Array, other: str
) -> dict[str, tuple[tuple[str, ...], Array, str, str]]:
    """Return pose errors (..., P, 6) as a position and an orientation."""
    text = f"measured minus {other} {{}}, base frame"
    return {
        "position": ((*over, dim, "axis"), values[..., :3], "mm", text.format("position")),
        "orientation": ((*over, dim, "axis"), values[..., 3:], "rad", text.format("orientation, a rotation vector")),
    }
