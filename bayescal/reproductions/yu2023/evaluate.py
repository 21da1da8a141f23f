"""How accurate a calibrated machine is: it is told to take poses, and stands where the true machine stands then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.machines.kinematics import Machine
from bayescal.numerics.geometry import Array
from bayescal.reproductions.yu2023.angles import coordinates_from_pose, pose_from_coordinates
from bayescal.reproductions.yu2023.least_squares import find_lengths, move

PER_UNIT = {"rad": 1.0, "deg": 180.0 / np.pi}
CHUNK = 1 << 17  # poses at once


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of calibrated machines at verification poses (Yu, Wu and Wang 2023 eqs. 39 to 42).

    Attributes
    ----------
    position : ndarray, shape (B, V)
        dX_tn, mm.
    attitude : ndarray, shape (B, V)
        dX_sn, the norm of the errors of α, β, γ, rad.
    """

    position: Array
    attitude: Array

    def integrated(self, unit: str) -> Array:
        """Return dX_z, the root mean square of position in mm plus attitude in a unit, shape (B,).

        Their eq. (43) adds up 20 poses and divides by 30; both are read as the number of poses.
        """
        both = self.position + PER_UNIT[unit] * self.attitude
        return np.asarray(np.sqrt(np.mean(both**2, axis=-1)))

    @property
    def figures(self) -> dict[str, Array]:
        """The figures of their table 8, each of shape (B,), mm and deg."""
        degrees = np.degrees(self.attitude)
        return {
            "position_max_mm": self.position.max(axis=-1),
            "position_mean_mm": self.position.mean(axis=-1),
            "attitude_max_deg": degrees.max(axis=-1),
            "attitude_mean_deg": degrees.mean(axis=-1),
        }


def evaluate(machine: Machine, truth: Array, found: Array, targets: Array) -> PoseErrors:
    """Return the pose errors of calibrated machines.

    Parameters
    ----------
    machine : Machine
    truth, found : ndarray, shapes (B, D)
        Parameters of the machines as they are, and as calibrated; NaN where the calibration failed.
    targets : ndarray, shape (V, 6)
        q of the poses to take.
    """
    size = max(1, CHUNK // len(targets))
    parts = [_deviate(machine, truth[k : k + size], found[k : k + size], targets) for k in range(0, len(truth), size)]
    deviation = np.concatenate(parts)
    return PoseErrors(np.linalg.norm(deviation[..., :3], axis=-1), np.linalg.norm(deviation[..., 3:], axis=-1))


def _deviate(machine: Machine, truth: Array, found: Array, targets: Array) -> Array:
    """Return dX, shape (b, V, 6); NaN where there is none."""
    shape = (len(truth), *targets.shape)
    position, rotation = pose_from_coordinates(targets)
    lengths = find_lengths(machine, found[:, None], position, rotation)
    start = np.broadcast_to(position, (*shape[:2], 3)), np.broadcast_to(rotation, (*shape[:2], 3, 3))
    reached_position, reached_rotation, reached = move(machine, truth, lengths, *start)
    deviation = coordinates_from_pose(reached_position, reached_rotation) - targets
    return np.where(reached[:, None, None], deviation, np.nan)
