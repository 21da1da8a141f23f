"""What one of a unit is in millimetres or radians."""

from __future__ import annotations

import math

MICROMETRE = 1e-3
ARCSECOND = math.pi / 180 / 3600
