"""Targets on the platform, seen as points: photogrammetry, a tracker's reflectors, a measuring machine's balls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.machines.sensors.base import Sensor
from bayescal.numerics.geometry import Array, compute_relative_pose, compute_rigid_jacobian


def information_of_points(points: Array, rotation: Array, noise: float) -> Array:
    """Return what targets tell of their body's pose, shape (P, 6, 6): Σ JᵀJ / σ² with J = (1, -[R s]×).

    Parameters
    ----------
    points : ndarray, shape (K, 3)
        s, the targets in the body's frame, mm.
    rotation : ndarray, shape (P, 3, 3)
    noise : float
        σ of each coordinate, mm.
    """
    jacobian = compute_rigid_jacobian(points, rotation)
    return np.einsum("pkij,pkim->pjm", jacobian, jacobian, optimize=True) / noise**2


@dataclass(frozen=True, eq=False)
class PointSensor(Sensor):
    """Targets on the platform, and on the base where the instrument's own frame wanders.

    Attributes
    ----------
    platform : ndarray, shape (K, 3)
        Targets, platform frame, mm.
    noise : float
        Standard deviation of a coordinate, mm.
    base : ndarray, shape (M, 3), optional
        Targets on the base, base frame, mm, three or more; without them the instrument stands in the base frame.
    """

    platform: Array
    noise: float
    base: Array | None = None

    def information(self, position: Array, rotation: Array) -> Array:
        """Return what the targets tell of the pose in the base frame; see `Sensor.information`."""
        seen = information_of_points(self.platform, rotation, self.noise)
        if self.base is None:
            return seen
        level = np.broadcast_to(np.eye(3), rotation.shape)
        base = (np.zeros_like(position), level, np.linalg.inv(information_of_points(self.base, level, self.noise)))
        _, _, frame = compute_relative_pose(base, (position, rotation, np.zeros((len(position), 6, 6))))
        return np.linalg.solve(np.eye(6) + seen @ frame, seen)
