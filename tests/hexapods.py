"""The hexapods of Rubin Observatory as shipped, and poses within their limits."""

from __future__ import annotations

import numpy as np
import studies

from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import load_mechanism
from bayescal.numerics.geometry import matrix_from_rotation_vector

AUDIT = studies.EXPERIMENTS / "audit"
LIMITS = {  # x, y, z about the pivot in mm, rotations about x, y, z in degrees
    "camera": (11.4, 11.4, 13.1, 0.36, 0.36, 0.1),
    "m2": (10.5, 10.5, 8.9, 0.175, 0.175, 0.05),
}


def load_hexapod(name: str) -> Mechanism:
    """Return a shipped hexapod, ``camera`` or ``m2``."""
    return load_mechanism(AUDIT / f"{name}_hexapod_mechanism.toml")


def poses_about_pivot(name: str, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return poses (P, 3) in mm and (P, 3, 3) at shares (P, 6) of a hexapod's limits."""
    change = share * np.array(LIMITS[name])
    pivot = np.array(load_hexapod(name).home_position)
    return pivot + change[:, :3], matrix_from_rotation_vector(np.radians(change[:, 3:]))
