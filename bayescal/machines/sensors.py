"""Sensors that may measure a machine: how much each tells of the platform's pose."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from bayescal.config.sections import Section
from bayescal.numerics.geometry import Array, compute_relative_pose, compute_rigid_jacobian


class Sensor(ABC):
    """An instrument that measures the platform in the base frame, or a part of its pose.

    One of somebody else's is named in a config, ``kind = "own_sensor.py:OwnSensor"``; its ``Config`` checks the other
    keys of its section, and `__init__(self, config)` makes it.
    """

    Config: ClassVar[type[Section]] = Section

    @classmethod
    def from_config(cls, config: Any) -> Self:
        """Return a built-in sensor of a section of a config."""
        return cls(**dict(config))

    @abstractmethod
    def information(self, position: Array, rotation: Array) -> Array:
        """Return the information on the pose, the inverse of its covariance where it is measured whole.

        Parameters
        ----------
        position, rotation : ndarray, shapes (P, 3) and (P, 3, 3)
            Poses of the platform frame in the base frame, mm.

        Returns
        -------
        ndarray, shape (P, 6, 6)
            By position (mm) and rotation vector (rad) in the base frame; singular where the sensor sees only a part.
        """


def information_of_points(points: Array, rotation: Array, noise: float) -> Array:
    """Return what targets tell of their body's pose, shape (P, 6, 6): Σ JᵀJ / σ² with J = (1, -[R s]×).

    Targets s (K, 3) in the body's frame, mm, turned by R (P, 3, 3), with noise σ of each coordinate, mm.
    """
    jacobian = compute_rigid_jacobian(points, rotation)
    return np.einsum("pkij,pkim->pjm", jacobian, jacobian, optimize=True) / noise**2


@dataclass(frozen=True, eq=False)
class PointSensor(Sensor):
    """Targets on the platform, and on the base where the instrument's own frame wanders: photogrammetry, a tracker."""

    platform: Array  # (K, 3): targets, platform frame, mm
    noise: float  # standard deviation of a coordinate, mm
    # (M, 3): targets on the base, base frame, mm, three or more; without them the instrument stands in the base frame
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


@dataclass(frozen=True)
class PoseSensor(Sensor):
    """Whole poses, or only positions or orientations, as a laser tracker with its probe has them, noise independent."""

    position_noise: float | None  # standard deviation of each coordinate, mm; None where it is not measured
    rotation_noise: float | None  # standard deviation, rad
    axes: str = "xyz"  # which coordinates are measured, of both, along the base frame's axes

    def information(self, position: Array, rotation: Array) -> Array:
        """Return the inverse variances on the diagonal; see `Sensor.information`."""
        del rotation
        seen = np.array([axis in self.axes for axis in "xyz"], dtype=np.float64)
        parts = [seen * (0.0 if noise is None else noise**-2) for noise in (self.position_noise, self.rotation_noise)]
        return np.broadcast_to(np.diag(np.concatenate(parts)), (len(position), 6, 6)).copy()


SENSORS = {"pose": PoseSensor, "targets": PointSensor}
"""Built-in sensors, by the ``kind`` of their sections."""
