"""What a sensor has to supply: how much it tells of the platform's pose."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Self

from bayescal.config.sections import Section
from bayescal.numerics.geometry import Array


class Sensor(ABC):
    """An instrument that measures the platform in the base frame, or a part of its pose.

    One of somebody else's is named in a config, ``kind = "own_sensor.py:OwnSensor"``; the other keys of its section are
    checked by its ``Config`` and become its fields.
    """

    Config: ClassVar[type[Section]] = Section

    @classmethod
    def from_config(cls, config: Any) -> Self:
        """Return the sensor of a section of a config."""
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
