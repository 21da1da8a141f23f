"""What one of a unit is in millimetres or radians."""

from __future__ import annotations

import math

MICROMETRE = 1e-3
ARCSECOND = math.pi / 180 / 3600
MICRORADIAN = 1e-6
SCALES = {"um": ("mm", MICROMETRE), "mm": ("mm", 1.0), "arcsec": ("rad", ARCSECOND), "deg": ("rad", math.radians(1.0))}
SCALES |= {"rad": ("rad", 1.0)}
"""By the suffix of a key: the unit that its quantity has inside, and what one of its own is in that."""


def choose_arcseconds(arcsec: float | None, urad: float | None) -> float | None:
    """Return in arcseconds what is stated in either unit, None where in neither; ValueError where in both."""
    if arcsec is not None and urad is not None:
        raise ValueError(f"found orientation_arcsec {arcsec:g} beside orientation_urad {urad:g}, expected one of them")
    return arcsec if urad is None else urad * MICRORADIAN / ARCSECOND
