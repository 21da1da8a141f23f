"""Many calibrations of simulated machines, by the paper's procedure and by the Bayesian one.

Machines, readings and their noise are drawn once and shared by all sets of sensors and both procedures, so that what
differs between these is what they make of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.errors import InputError, NumericalError
from bayescal.numerics.geometry import Array
from bayescal.reproductions.sika2008.calibrate import Calibrations, calibrate, unweighted
from bayescal.reproductions.sika2008.sensor_sets import SensorSet, compute_tool_sensitivity, locate_tool
from bayescal.reproductions.sika2008.setup import Plan, Plans

PAPER, BAYESIAN = "paper", "bayesian"
PROCEDURES = (PAPER, BAYESIAN)


@dataclass(frozen=True, eq=False)
class Measured:
    """What all sensors together say of C machines.

    Attributes
    ----------
    theta : ndarray, shape (C, D)
        The machines as they are.
    readings : ndarray, shape (C, P, K)
        At the measured poses, with noise, mm and rad.
    at_targets, noisy_at_targets : ndarray, shapes (C, V, K)
        At the poses where the tool's centre is judged, as they are and as the sensors read them.
    """

    theta: Array
    readings: Array
    at_targets: Array
    noisy_at_targets: Array


@dataclass(frozen=True, eq=False)
class Simulated:
    """Calibrations with one set of sensors by one procedure; NaN throughout where one did not converge.

    Attributes
    ----------
    plan : Plan
    procedure : str
    found : Calibrations
    error : ndarray, shape (C, n)
        Of the parameters, calibrated minus true, mm and rad.
    tool : ndarray, shape (C, V, m)
        Error of the tool's centre located from readings without noise: what the calibration is to blame for, mm.
    noisy_tool : ndarray, shape (C, V, m)
        The same located from readings with their noise.
    """

    plan: Plan
    procedure: str
    found: Calibrations
    error: Array
    tool: Array
    noisy_tool: Array

    @cached_property
    def good(self) -> np.ndarray:
        """Which calibrations count, shape (C,)."""
        result: np.ndarray = np.isfinite(self.error).all(axis=1) & np.isfinite(self.tool).all(axis=(1, 2))
        return result

    @property
    def tool_squares(self) -> Array:
        """Mean square of the tool's distance from where it is, of each calibration, shape (C,), mm²."""
        return np.asarray(np.mean(np.sum(self.tool**2, axis=-1), axis=-1))

    @property
    def noisy_tool_squares(self) -> Array:
        """The same with the noise of the readings in use."""
        return np.asarray(np.mean(np.sum(self.noisy_tool**2, axis=-1), axis=-1))

    def squares(self, names: set[str]) -> Array:
        """Return the mean square error of some parameters of each calibration, shape (C,), mm² or rad²; NaN of none."""
        where = [k for k, name in enumerate(self.plan.parameters) if name in names]
        if not where:
            return np.full(len(self.error), np.nan)
        return np.asarray(np.mean(self.error[:, where] ** 2, axis=1))


def measure(plans: Plans, pose: Array, targets: Array, n: int, rng: np.random.Generator) -> Measured:
    """Return what n machines within the tolerances give at poses (P, q) and (V, q).

    Raises
    ------
    InputError
        Where one of them cannot take a pose.
    """
    sensors = plans.every.sensors
    theta = plans.every.free.draw(rng, n)
    readings, at_targets = (sensors.read(theta[:, None], where) for where in (pose, targets))
    reached = np.isfinite(readings).all(axis=(1, 2)) & np.isfinite(at_targets).all(axis=(1, 2))
    if not reached.all():
        raise InputError(
            f"tolerances: found machine {int(np.argmin(reached)) + 1} of {n} unable to take a pose, "
            "expected smaller ones or poses further from the reach of the legs"
        )
    noise = (sensors.noise * rng.standard_normal(values.shape) for values in (readings, at_targets))
    return Measured(theta, readings + next(noise), at_targets, at_targets + next(noise))


def weigh(plan: Plan, procedure: str) -> SensorSet:
    """Return a plan's sensors as a procedure weighs them."""
    return unweighted(plan.sensors) if procedure == PAPER else plan.sensors


def simulate(plans: Plans, plan: Plan, procedure: str, measured: Measured, pose: Array, targets: Array) -> Simulated:
    """Return the calibrations of machines by one set of sensors."""
    columns, sensors = plans.columns(plan), weigh(plan, procedure)
    found = calibrate(sensors, plan.free, measured.readings[..., columns], pose, procedure == BAYESIAN)
    if not found.converged.any():
        raise NumericalError(
            f"set {plan.name!r}, {procedure} procedure: none of {len(found.converged)} calibrations converged, "
            "expected sensors and poses that determine the parameters"
        )
    good = found.converged[:, None]
    error = np.where(good, (found.theta - measured.theta)[:, plan.free.places], np.nan)
    tools = [
        _judge_tool(sensors, found, measured.theta, readings[..., columns], targets)
        for readings in (measured.at_targets, measured.noisy_at_targets)
    ]
    return Simulated(plan, procedure, found, error, *tools)


def _judge_tool(sensors: SensorSet, found: Calibrations, truth: Array, readings: Array, targets: Array) -> Array:
    """Return how far the tool's centre is located from where it is, (C, V, m), NaN where it is not."""
    located = locate_tool(sensors, found.theta, readings, targets)
    position, _, _ = sensors.model.tool(truth[:, None], targets)
    good = located.converged & found.converged[:, None]
    return np.where(good[..., None], located.position - position, np.nan)


@dataclass(frozen=True, eq=False)
class Spread:
    """Standard deviations that the Bayesian procedure states.

    Attributes
    ----------
    parameters : ndarray, shape (C, n)
        mm and rad.
    tool, noisy_tool : ndarray, shapes (C, V, m)
        Of the tool's centre for the calibration alone, and with the noise of the readings in use, mm.
    """

    parameters: Array
    tool: Array
    noisy_tool: Array


def state_spread(simulated: Simulated, targets: Array) -> Spread:
    """Return what a calibration says of its own errors: to first order, at the calibrated machine."""
    found, sensors = simulated.found, simulated.plan.sensors
    pose = np.broadcast_to(targets, (len(found.theta), *targets.shape))
    sensitivity = compute_tool_sensitivity(sensors, found.theta[:, None], pose)
    tool = sensitivity.covariance(simulated.plan.free.places, found.covariance[:, None])
    variances = [np.diagonal(c, axis1=-2, axis2=-1) for c in (found.covariance, tool, sensitivity.noise_covariance)]
    return Spread(np.sqrt(variances[0]), np.sqrt(variances[1]), np.sqrt(variances[1] + variances[2]))
