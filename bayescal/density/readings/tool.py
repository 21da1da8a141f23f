"""The tool's centre as a machine knows it from its readings, and how far that is off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.density.readings.poses import SensorSet, find_poses
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class ToolPositions:
    """The tool's centre at P poses of C machines.

    Attributes
    ----------
    position : ndarray, shape (C, P, m)
        mm, base frame.
    converged : ndarray of bool, shape (C, P)
    """

    position: Array
    converged: np.ndarray


def locate_tool(sensors: SensorSet, theta: Array, measured: Array, start: Array) -> ToolPositions:
    """Return the tool's centre that machines (C, D) make of readings (P, K) or (C, P, K), mm and rad."""
    found = find_poses(sensors, theta[:, None], measured, start, check=False)
    position, _, _ = sensors.model.tool(theta[:, None], found.pose)
    return ToolPositions(position, found.converged)


@dataclass(frozen=True, eq=False)
class ToolSensitivity:
    """How the tool's centre, as located from readings, errs to first order.

    Attributes
    ----------
    by_parameters : ndarray, shape (P, m, D)
        By an error of the parameters, the readings being right, mm.
    by_noise : ndarray, shape (P, m, K)
        By noise of the readings, in units of their standard deviations, mm.
    """

    by_parameters: Array
    by_noise: Array

    def covariance(self, places: np.ndarray, covariance: Array) -> Array:
        """Return the covariance of the tool's centre for that (n, n) of parameters at ``places``, (P, m, m), mm²."""
        slope = self.by_parameters[..., places]
        return np.asarray(slope @ covariance @ np.swapaxes(slope, -1, -2))

    @property
    def noise_covariance(self) -> Array:
        """Covariance of the tool's centre for the noise of the readings in use, (P, m, m), mm²."""
        return np.asarray(self.by_noise @ np.swapaxes(self.by_noise, -1, -2))


def compute_tool_sensitivity(sensors: SensorSet, theta: Array, pose: Array) -> ToolSensitivity:
    """Return how the tool's centre errs at poses (P, q) of one machine (D,)."""
    here = sensors.linearise(theta, pose)
    gain = np.linalg.pinv(here.by_pose)
    _, by_pose, by_parameters = sensors.model.tool(theta, pose)
    return ToolSensitivity(by_parameters - by_pose @ gain @ here.by_parameters, by_pose @ gain)
