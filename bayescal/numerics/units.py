"""What one of a unit is in millimetres or radians."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

MICROMETRE = 1e-3
ARCSECOND = math.pi / 180 / 3600
MICRORADIAN = 1e-6
SCALES = {"um": ("mm", MICROMETRE), "mm": ("mm", 1.0), "arcsec": ("rad", ARCSECOND), "deg": ("rad", math.radians(1.0))}
SCALES |= {"rad": ("rad", 1.0)}
"""By the suffix of a key: the unit that its quantity has inside, and what one of its own is in that."""


def choose_arcseconds(arcsec: float | None, urad: float | None) -> float | None:
    """Return in arcseconds what is stated in either unit, None where in neither; ValueError where in both."""
    if arcsec is not None and urad is not None:
        raise ValueError(f"found orientation_arcsec {arcsec:g} and orientation_urad {urad:g}, expected either")
    return arcsec if urad is None else urad * MICRORADIAN / ARCSECOND


LENGTHS = {"um": 1e-3, "mm": 1.0, "m": 1e3}
ANGLES = {"arcsec": math.pi / 180 / 3600, "mrad": 1e-3, "deg": math.pi / 180, "rad": 1.0}


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
