"""An instrument that hands out whole poses, or only positions, or only orientations: a laser tracker with its probe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.machines.sensors.base import Sensor
from bayescal.numerics.geometry import Array


@dataclass(frozen=True)
class PoseSensor(Sensor):
    """Noise of each coordinate of the position and of the rotation vector, independent; None where it is not measured.

    Attributes
    ----------
    position_noise : float or None
        Standard deviation, mm.
    rotation_noise : float or None
        Standard deviation, rad.
    axes : str
        Which coordinates are measured, of both, along the base frame's axes.
    """

    position_noise: float | None
    rotation_noise: float | None
    axes: str = "xyz"

    def information(self, position: Array, rotation: Array) -> Array:
        """Return the inverse variances on the diagonal; see `Sensor.information`."""
        del rotation
        seen = np.array([axis in self.axes for axis in "xyz"], dtype=np.float64)
        parts = [seen * (0.0 if noise is None else noise**-2) for noise in (self.position_noise, self.rotation_noise)]
        return np.broadcast_to(np.diag(np.concatenate(parts)), (len(position), 6, 6)).copy()
