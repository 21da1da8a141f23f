"""Units of a design and of its results; inside lengths are in mm and angles in rad."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

LENGTHS = {"um": 1e-3, "mm": 1.0, "m": 1e3}
ANGLES = {"arcsec": np.pi / 180 / 3600, "mrad": 1e-3, "deg": np.pi / 180, "rad": 1.0}


def units_like(unit: str) -> Mapping[str, float]:
    """Return the units that a column may be in instead of a channel's, each with its size in it."""
    return {"mm": LENGTHS, "rad": {name: float(v) for name, v in ANGLES.items()}}.get(unit, {unit: 1.0})


@dataclass(frozen=True)
class Units:
    """Units of lengths and of angles by name."""

    length: str = "mm"
    angle: str = "deg"

    def factor(self, unit: str) -> float:
        """Return the size of the design's unit in an inner one, ``mm``, ``rad`` or another."""
        return {"mm": LENGTHS[self.length], "rad": float(ANGLES[self.angle])}.get(unit, 1.0)

    def name(self, unit: str) -> str:
        """Return the design's name of an inner unit."""
        return {"mm": self.length, "rad": self.angle}.get(unit, unit)
