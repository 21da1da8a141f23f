"""Measured poses: what photogrammetry hands to the likelihood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class MeasuredPoses:
    """Measured poses of the platform in the base frame with the actuator positions at which they were taken.

    Attributes
    ----------
    names : tuple of str
        Names of the P poses.
    position, rotation : ndarray, shapes (P, 3) and (P, 3, 3)
        Pose of the platform frame, base frame, mm.
    covariance : ndarray, shape (P, 6, 6)
        Covariance of position (mm) and rotation vector (rad), base frame.
    actuators : ndarray, shape (P, N)
        Actuator positions ρ, mm.
    """

    names: tuple[str, ...]
    position: Array
    rotation: Array
    covariance: Array
    actuators: Array

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return len(self.names)

    def select(self, index: np.ndarray) -> MeasuredPoses:
        """Return some of the poses."""
        names = tuple(np.asarray(self.names)[index])
        return MeasuredPoses(
            names, self.position[index], self.rotation[index], self.covariance[index], self.actuators[index]
        )
