"""Measured poses: what photogrammetry hands to the likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.errors import InputError
from bayescal.numerics.geometry import Array

MIN_POSES = 3


def check_repeated(names: Sequence[str], readings: Array, verification: np.ndarray) -> None:
    """Raise InputError where two poses have the same readings to the last digit: one measurement, copied.

    Readings (P, ...) are as measured, noise included; NaN where nothing was. Fewer than `MIN_POSES` numbers may agree
    by chance. A copy of a calibration pose verifies nothing.
    """
    flat = readings.reshape(len(names), -1)
    first: dict[bytes, int] = {}
    for k, row in enumerate(flat):
        if np.isfinite(row).sum() < MIN_POSES or not np.any(row[np.isfinite(row)]):
            continue
        earlier = first.setdefault(row.tobytes(), k)
        if earlier != k:
            raise InputError(f"pose {names[k]!r}: found the readings of pose {names[earlier]!r}, expected its own")


@dataclass(frozen=True, eq=False)
class MeasuredPoses:
    """Measured poses of the platform in the base frame with the actuator positions at which they were taken."""

    names: tuple[str, ...]  # names of the P poses
    position: Array  # (P, 3): pose of the platform frame, base frame, mm
    rotation: Array  # (P, 3, 3)
    covariance: Array  # (P, 6, 6): covariance of position (mm) and rotation vector (rad), base frame
    actuators: Array  # (P, N): actuator positions ρ, mm

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return len(self.names)

    def is_whole(self) -> bool:
        """Whether every coordinate of every pose is known."""
        return bool(np.isfinite(self.position).all() and np.isfinite(self.rotation).all())

    def select(self, index: np.ndarray) -> MeasuredPoses:
        """Return some of the poses."""
        names = tuple(np.asarray(self.names)[index])
        return MeasuredPoses(
            names, self.position[index], self.rotation[index], self.covariance[index], self.actuators[index]
        )
