"""Poses as an instrument hands them out, whole or in part: a laser tracker with a probe, a camera, a measuring arm.

The position is compared coordinate by coordinate. A rotation that is measured whole is compared as a rotation: the
residual is the rotation vector from the expected to the measured one, and the covariance is that of this vector. Of a
rotation that is measured in part nothing but some coordinates of its rotation vector is known; these are compared as
they stand.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from bayescal.data.instruments.base import Instrument, Rows
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.numerics.geometry import (
    DEGREES_OF_FREEDOM,
    Array,
    compute_left_inverse_jacobian,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
)

LOG_TWO_PI = float(np.log(2.0 * np.pi))
COORDINATES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, eq=False)
class PoseReadings(Instrument):
    """Poses read by one instrument.

    Attributes
    ----------
    names : tuple of str
    actuators : ndarray, shape (P, N)
        mm.
    values : ndarray, shape (P, 6)
        Position (mm) and rotation vector (rad) of the tool in the instrument's frame; NaN where not measured.
    covariance : ndarray, shape (P, 6, 6)
        Of position (mm) and of the error's rotation vector (rad), instrument's axes; only what was measured counts.
    """

    names: tuple[str, ...]
    actuators: Array
    values: Array
    covariance: Array
    rows: Rows = field(init=False)

    def __post_init__(self) -> None:
        """Build the rows: what was not measured is no row."""
        measured = np.isfinite(self.values)
        both = measured[:, :, None] & measured[:, None, :]
        covariance = np.where(both, self.covariance, np.eye(DEGREES_OF_FREEDOM))
        constant = -0.5 * LOG_TWO_PI * measured.sum(axis=1)
        rows = Rows(covariance, constant, np.eye(6) * measured[:, None, :], measured, measured.sum(axis=1))
        object.__setattr__(self, "rows", rows)

    @property
    def n_stations(self) -> int:
        """One."""
        return 1

    @cached_property
    def _rotation(self) -> tuple[np.ndarray, Array]:
        """Which rotations are measured whole, shape (P,), and the rotations (P, 3, 3), level where they are not."""
        whole = self.rows.measured[:, 3:].all(axis=1)
        return whole, matrix_from_rotation_vector(np.where(whole[:, None], self.values[:, 3:], 0.0))

    @cached_property
    def poses(self) -> MeasuredPoses:
        """The poses as read; NaN where a coordinate is not measured."""
        whole, rotation = self._rotation
        rotation = np.where(whole[:, None, None], rotation, np.nan)
        both = self.rows.measured[:, :, None] & self.rows.measured[:, None, :]
        covariance = np.where(both, self.covariance, np.nan)
        return MeasuredPoses(self.names, self.values[:, :3], rotation, covariance, self.actuators)

    def residuals(self, position: Array, rotation: Array) -> Array:
        """Return measured minus expected coordinates, shape (..., P, 6); see `Instrument.residuals`."""
        position, rotation = position[..., 0, :, :], rotation[..., 0, :, :, :]
        whole, measured = self._rotation
        turn = rotation_vector_from_matrix(measured @ np.swapaxes(rotation, -1, -2))
        if not whole.all():
            turn = np.where(whole[:, None], turn, self.values[:, 3:] - rotation_vector_from_matrix(rotation))
        return np.where(self.rows.measured, np.concatenate([self.values[:, :3] - position, turn], axis=-1), 0.0)

    def slopes(self, position: Array, rotation: Array) -> Array:
        """Return the derivative by the pose seen, shape (1, P, 6, 6); see `Instrument.slopes`."""
        whole, _ = self._rotation
        turn = self.residuals(position, rotation)[..., 3:]
        turned = -np.swapaxes(compute_left_inverse_jacobian(turn), -1, -2)
        partial = -compute_left_inverse_jacobian(rotation_vector_from_matrix(rotation[0]))
        result = np.zeros((self.n_poses, DEGREES_OF_FREEDOM, DEGREES_OF_FREEDOM))
        result[:, :3, :3] = -np.eye(3)
        result[:, 3:, 3:] = np.where(whole[:, None, None], turned, partial)
        return (result * self.rows.measured[:, :, None])[None]

    def select(self, chosen: np.ndarray) -> PoseReadings:
        """Return the readings of some poses."""
        names = tuple(np.asarray(self.names)[chosen])
        return PoseReadings(names, self.actuators[chosen], self.values[chosen], self.covariance[chosen])

    def describe(self) -> dict[str, Any]:
        """Return which coordinates were measured."""
        count = self.rows.measured.sum(axis=0).tolist()
        return {"measured_coordinates": dict(zip(COORDINATES, count, strict=True))}
