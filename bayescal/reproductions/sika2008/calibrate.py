"""Many self-calibrations at once by Gauss and Newton's method, the poses eliminated in every step.

The procedure of Šika et al. (2008, eqs. 3 to 5) is the one without priors, all residuals weighted alike in metres and
radians; with the sensors' noise and the tolerances as priors it finds the posterior's mode, and its last step the
covariance there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.machines.readings import Readings
from bayescal.numerics.geometry import Array
from bayescal.reproductions.sika2008.calibrability import MM_PER_METRE, in_units
from bayescal.reproductions.sika2008.sensor_sets import FreeParameters, SensorSet, null_basis, solve_least_squares

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
