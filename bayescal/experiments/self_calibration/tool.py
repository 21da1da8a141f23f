"""Where the tool's centre is after a calibration, and how well that is known.

What internal sensors never see is the tool's place on the platform. A variant without an instrument beside the machine
tells where that point of the platform is at which the tool stands nominally, and it is compared with this point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import CommonDraws, Errors
from bayescal.errors import NumericalError
from bayescal.experiments.self_calibration.fit import VariantFit
from bayescal.experiments.self_calibration.inputs import ReadingInputs, Variant
from bayescal.experiments.shared.reading_machine import free_parameters
from bayescal.experiments.shared.sensor_sets import ToolSensitivity, compute_tool_sensitivity, locate_tool
from bayescal.numerics.geometry import Array

INTERVAL = 0.9
TOOL = ("xi_V", "eta_V")


@dataclass(frozen=True, eq=False)
class ToolPrediction:
    """The tool's centre at V verification poses, base frame, mm.

    Attributes
    ----------
    mean : ndarray, shape (V, 2)
    low, high : ndarray, shape (V, 2)
        90 % intervals of each coordinate, the noise of the readings included.
    sd : ndarray, shape (V,)
        Root mean square distance from the mean.
    true : ndarray, shape (V, 2)
        NaN where it is not known.
    """

    mean: Array
    low: Array
    high: Array
    sd: Array
    true: Array

    @property
    def error(self) -> Array:
        """Distance between mean and truth, shape (V,), mm."""
        return np.linalg.norm(self.mean - self.true, axis=-1)

    @property
    def inside(self) -> np.ndarray:
        """Which true coordinates lie inside their intervals, shape (V, 2)."""
        return (self.low <= self.true) & (self.true <= self.high)


@dataclass(frozen=True)
class ToolAccuracy:
    """Root mean square errors of the tool's centre over the workspace, mm.

    Attributes
    ----------
    before, after : float
        Predicted, by what is unknown of the parameters: tolerances, then the posterior.
    noise : float
        By the noise of one pose's readings.
    nominal_error, calibrated_error : float
        Of the true machine taken for the nominal one, and for that of the posterior mean; NaN where it is not known.
    """

    before: float
    after: float
    noise: float
    nominal_error: float
    calibrated_error: float


def true_machine(inputs: ReadingInputs, variant: Variant) -> Array | None:
    """Return the true parameters, with the tool where a variant takes it to be; None where they are not known."""
    if inputs.truth is None:
        return None
    theta, layout = inputs.truth.theta.copy(), inputs.model.layout
    for symbol in TOOL:
        if symbol not in variant.free_names:
            theta[layout.index[symbol]] = layout.nominal[layout.index[symbol]]
    return theta


def predict_tool(inputs: ReadingInputs, variant: Variant, fit: VariantFit, rng: np.random.Generator) -> ToolPrediction:
    """Return the tool's centre at the verification poses, from the machine's own sensors and draws of its parameters.

    Given a machine, the pose that readings tell of is normal about the best one with (HᵀΣ⁻¹H)⁻¹ to first order.
    """
    sensors, held = variant.internal, inputs.table.verification
    measured, start = _correct(inputs.measured(variant.sensors, True), variant, fit), variant.pose[held]
    place = locate_tool(sensors, fit.theta, measured, start)
    if not place.converged.all():
        raise NumericalError(f"variant {variant.name!r}: found no pose at which to locate the tool")
    by_noise = compute_tool_sensitivity(sensors, fit.theta.mean(axis=0), start).by_noise
    draws = place.position + np.einsum(
        "vmk,svk->svm", by_noise, rng.standard_normal((*place.position.shape[:2], len(sensors.chosen)))
    )
    low, high = np.quantile(draws, [0.5 - INTERVAL / 2, 0.5 + INTERVAL / 2], axis=0)
    mean = place.position.mean(axis=0)
    sd = np.sqrt(draws.var(axis=0).sum(axis=-1))
    theta = true_machine(inputs, variant)
    true = np.full(mean.shape, np.nan)
    if theta is not None and inputs.truth is not None:
        true = inputs.model.tool(theta, inputs.truth.pose[held])[0]
    return ToolPrediction(mean, low, high, sd, true)


def _correct(readings: Array, variant: Variant, fit: VariantFit) -> Array:
    """Return readings (V, K) of the machine's own sensors less draws of their functions, (V, k) or (T, V, k)."""
    if variant.functions is None:
        return readings[:, variant.kept]
    names = tuple(map(str, range(len(readings))))
    rows = Measurements(names, readings, np.broadcast_to(variant.sensors.noise, readings.shape))
    return np.asarray((readings - CommonDraws(Errors((variant.functions,)), fit.common).at(rows))[..., variant.kept])


def assess_tool(inputs: ReadingInputs, variant: Variant, fit: VariantFit) -> ToolAccuracy:
    """Return how far the tool's centre is off over the workspace, before and after the calibration.

    Before are all parameters within their tolerances that the sensors see, those that a variant fixes too. What a
    machine errs by in truth is that of its parameters; with sensors whose own error nobody wrote down it is not known.
    """
    sensors, pose, layout = variant.internal, inputs.workspace, inputs.model.layout
    mean = fit.theta.mean(axis=0)
    plain = free_parameters(inputs.model, variant.sensors.names, inputs.config.tolerances)
    nominal = compute_tool_sensitivity(sensors, layout.nominal, pose)
    calibrated = compute_tool_sensitivity(sensors, mean, pose)
    every = np.arange(layout.size)
    errors = [float("nan")] * 2
    theta = true_machine(inputs, variant)
    if theta is not None:
        errors = [_true_error(inputs, variant, theta, machine) for machine in (layout.nominal, mean)]
        errors[1] = errors[1] if variant.functions is None else float("nan")
    return ToolAccuracy(
        _rms(nominal.covariance(plain.places, np.diag(plain.scale**2))),
        _rms(calibrated.covariance(every, np.cov(fit.theta, rowvar=False)))
        if variant.functions is None
        else _spread_of_draws(variant, fit, calibrated, pose),
        _rms(calibrated.noise_covariance),
        *errors,
    )


def _spread_of_draws(variant: Variant, fit: VariantFit, tool: ToolSensitivity, pose: Array) -> float:
    """Return the rms error of the tool's centre at poses (W, q) over draws of parameters and functions together, mm."""
    sensors = variant.internal
    readings = variant.sensors.read(fit.theta.mean(axis=0), pose)
    corrected = _correct(readings, variant, fit) / sensors.noise
    moved = np.einsum("wmd,td->twm", tool.by_parameters, fit.theta - fit.theta.mean(axis=0))
    moved += np.einsum("wmk,twk->twm", tool.by_noise, corrected - corrected.mean(axis=0))
    return float(np.sqrt((moved**2).sum(axis=-1).mean()))


def _rms(covariance: Array) -> float:
    return float(np.sqrt(np.trace(covariance, axis1=-2, axis2=-1).mean()))


def _true_error(inputs: ReadingInputs, variant: Variant, truth: Array, machine: Array) -> float:
    """Return by how much a machine errs of where the true one's tool is, its readings without noise, rms, mm."""
    sensors, pose = variant.internal, inputs.workspace
    found = locate_tool(sensors, machine[None], sensors.read(truth, pose), pose)
    distance = np.linalg.norm(found.position[0] - inputs.model.tool(truth, pose)[0], axis=-1)
    return float(np.sqrt(np.mean(distance[found.converged[0]] ** 2)))
