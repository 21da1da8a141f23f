"""Many calibrations of simulated machines, by the paper's procedure and by the Bayesian one.

Gauss and Newton's method on many machines at once, the poses eliminated in every step. The procedure of Šika et al.
(2008, eqs. 3 to 5) is the one without priors, all residuals weighted alike in metres and radians; with the sensors'
noise and the tolerances as priors it finds the posterior's mode, and its last step the covariance there.

What the paper's procedure leaves of errors is also predicted, to first order and without simulation: its estimate of
the parameters is G Zᵀe, with G the pseudo-inverse of the rows ZᵀA that are free of the poses and e the noise of the
readings, in the units that the procedure weighs them in; its covariance is G ZᵀΣZ Gᵀ.

Machines, readings and their noise are drawn once and shared by all sets of sensors and both procedures, so that what
differs between these is what they make of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.errors import InputError, NumericalError
from bayescal.machines.readings import Readings
from bayescal.numerics.geometry import Array
from sika2008.sensors import (
    MM_PER_METRE,
    FreeParameters,
    SensorSet,
    compute_tool_sensitivity,
    in_units,
    locate_tool,
    null_basis,
    solve_least_squares,
)
from sika2008.setup import Plan, Plans

PAPER, BAYESIAN = "paper", "bayesian"
PROCEDURES = (PAPER, BAYESIAN)
BATCH = 16
STEP_TOLERANCE = 1e-7  # of a parameter's scale
REGULAR = 1e-13  # of the largest pivot, below which a system has no solution


@dataclass(frozen=True, eq=False)
class Calibrations:
    """C machines as calibrated.

    Attributes
    ----------
    theta : ndarray, shape (C, D)
    covariance : ndarray, shape (C, n, n)
        Of the free parameters, mm and rad, to first order; meaningful where the residuals had the unit of their noise.
    square : ndarray, shape (C,)
        Sum of squares of what is left.
    converged : ndarray of bool, shape (C,)
    n_iterations : ndarray of int, shape (C,)
    """

    theta: Array
    covariance: Array
    square: Array
    converged: np.ndarray
    n_iterations: np.ndarray


def unweighted(sensors: SensorSet) -> SensorSet:
    """Return the sensors as the paper weights them: a metre as much as a radian."""
    return in_units(sensors, MM_PER_METRE, 1.0)


def calibrate(
    sensors: SensorSet,
    free: FreeParameters,
    measured: Array,
    start: Array,
    with_priors: bool,
    max_iterations: int = 50,
) -> Calibrations:
    """Return machines that explain their readings best.

    Parameters
    ----------
    sensors : SensorSet
        Its noise weights the readings; see `unweighted`.
    free : FreeParameters
    measured : ndarray, shape (C, P, K)
        Readings of C machines at P poses, mm and rad.
    start : ndarray, shape (P, q)
        Commanded poses.
    with_priors : bool
        Whether tolerances count as readings of the parameters.
    max_iterations : int
    """
    parts = [
        _calibrate(sensors, free, measured[k : k + BATCH], start, with_priors, max_iterations)
        for k in range(0, len(measured), BATCH)
    ]
    fields = ("theta", "covariance", "square", "converged", "n_iterations")
    return Calibrations(*(np.concatenate([getattr(part, name) for part in parts]) for name in fields))


def _calibrate(
    sensors: SensorSet, free: FreeParameters, measured: Array, start: Array, with_priors: bool, max_iterations: int
) -> Calibrations:
    n_machines = len(measured)
    state = _State(np.tile(free.centre, (n_machines, 1)), np.tile(start, (n_machines, 1, 1)))
    converged, count = np.zeros(n_machines, dtype=bool), np.zeros(n_machines, dtype=int)
    for _ in range(max_iterations):
        system = _System.at(sensors, free, state, measured, with_priors)
        step = system.solve()
        going = ~converged & np.isfinite(step).all(axis=1)
        state = system.move(state, free, np.where(going[:, None], step, 0.0))
        count += going
        with np.errstate(invalid="ignore"):
            converged |= np.abs(step).max(axis=1) < STEP_TOLERANCE
        if not (going & ~converged).any():
            break
    system = _System.at(sensors, free, state, measured, with_priors)
    covariance = free.scale[:, None] * system.covariance() * free.scale
    return Calibrations(state.theta, covariance, np.einsum("cm,cm->c", system.right, system.right), converged, count)


@dataclass(frozen=True, eq=False)
class _State:
    """Machines (C, D) and their poses (C, P, q)."""

    theta: Array
    pose: Array


@dataclass(frozen=True, eq=False)
class _System:
    """The linear least squares of one step: ``left`` (C, m, n) in units of the tolerances, ``right`` (C, m)."""

    here: Readings
    error: Array
    left: Array
    right: Array

    @classmethod
    def at(cls, sensors: SensorSet, free: FreeParameters, state: _State, measured: Array, with_priors: bool) -> _System:
        here = sensors.linearise(state.theta[:, None], state.pose)
        error = measured / sensors.noise - here.values
        basis = null_basis(here.by_pose)
        left = basis @ (here.by_parameters[..., free.places] * free.scale)
        right = np.einsum("cpzk,cpk->cpz", basis, error)
        left, right = left.reshape(len(error), -1, len(free.places)), right.reshape(len(error), -1)
        if with_priors:
            off = (free.centre - state.theta)[:, free.places] / free.scale
            identity = np.broadcast_to(np.eye(len(free.places)), (len(error), len(free.places), len(free.places)))
            left, right = np.concatenate([left, identity], axis=1), np.concatenate([right, off], axis=1)
        return cls(here, error, left, right)

    def _triangle(self) -> tuple[Array, Array, np.ndarray]:
        """Return Q, R and which machines have a regular R."""
        n_rows, n = self.left.shape[1:]
        missing = max(0, n - n_rows)  # fewer equations than parameters have no solution, which is no fault of the code
        orthogonal, triangle = np.linalg.qr(np.pad(np.nan_to_num(self.left), ((0, 0), (0, missing), (0, 0))))
        orthogonal = orthogonal[:, :n_rows]
        diagonal = np.abs(np.diagonal(triangle, axis1=-2, axis2=-1))
        good = (diagonal.min(axis=-1) > REGULAR * diagonal.max(axis=-1)) & np.isfinite(self.right).all(axis=-1)
        return orthogonal, np.where(good[:, None, None], triangle, np.eye(triangle.shape[-1])), good

    def solve(self) -> Array:
        """Return the step (C, n) in units of the tolerances, NaN for a machine without one."""
        orthogonal, triangle, good = self._triangle()
        side = np.einsum("cmn,cm->cn", orthogonal, np.nan_to_num(self.right))
        return np.where(good[:, None], np.linalg.solve(triangle, side[..., None])[..., 0], np.nan)

    def covariance(self) -> Array:
        """Return (JᵀJ)⁻¹ in units of the tolerances, (C, n, n), NaN where it is none."""
        _, triangle, good = self._triangle()
        inverse = np.linalg.inv(triangle)
        return np.where(good[:, None, None], inverse @ np.swapaxes(inverse, -1, -2), np.nan)

    def move(self, state: _State, free: FreeParameters, step: Array) -> _State:
        """Return machines after a step, their poses following."""
        change = np.zeros_like(state.theta)
        change[:, free.places] = step * free.scale
        seen = self.error - np.einsum("cpkd,cd->cpk", self.here.by_parameters, change)
        moved = np.any(step != 0.0, axis=1)[:, None, None]
        follow = np.nan_to_num(solve_least_squares(self.here.by_pose, seen))
        return _State(state.theta + change, state.pose + np.where(moved, follow, 0.0))


# --- predicted to first order ----------------------------------------------------------------------------------------


def predict_covariance(plan: Plan, pose: Array) -> Array:
    """Return the covariance (n, n) of the parameters calibrated at poses (P, q), mm and rad."""
    sensors, free = unweighted(plan.sensors), plan.free
    here = sensors.linearise(free.centre, pose)
    basis = null_basis(here.by_pose)
    rows = basis @ (here.by_parameters[..., free.places] * free.scale)
    whitened = basis * (plan.sensors.noise / sensors.noise)
    gain = np.linalg.pinv(rows.reshape(-1, len(free.places)))
    gain = gain.reshape(len(free.places), len(pose), -1)
    spread = np.einsum("npz,pzk->npk", gain, whitened).reshape(len(free.places), -1) * free.scale[:, None]
    return np.asarray(spread @ spread.T)


def predict_tool(plan: Plan, covariance: Array, targets: Array) -> float:
    """Return the root mean square error of the tool's centre over poses (V, q), readings without noise, mm."""
    sensitivity = compute_tool_sensitivity(unweighted(plan.sensors), plan.free.centre, targets)
    parts = sensitivity.covariance(plan.free.places, covariance)
    return float(np.sqrt(np.mean(np.trace(parts, axis1=-2, axis2=-1))))


# --- simulated -------------------------------------------------------------------------------------------------------


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
