"""The machine as it was designed: nominal geometry of a parallel mechanism of N prismatic-universal-spherical legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.errors import InputError
from bayescal.geometry import Array

MIN_LEGS = 6


@dataclass(frozen=True)
class Mechanism:
    """Nominal geometry of an N-leg P-U-S platform, frames and symbols of RR-8096 section 2.2.

    Attributes
    ----------
    name : str
        Name of the machine.
    base_points : ndarray, shape (N, 3)
        a_i, attachment of actuator i, base frame, mm.
    platform_points : ndarray, shape (N, 3)
        b_i, joint of leg i on the platform, platform frame, mm.
    directions : ndarray, shape (N, 3)
        u_i, unit direction of actuator i, base frame.
    leg_lengths : ndarray, shape (N,)
        l_i, mm.
    initial_actuator_positions : ndarray, shape (N,)
        rho_i^0, mm; displacements are measured from here.
    actuator_range : float
        Largest displacement from the initial position, mm.
    """

    name: str
    base_points: Array
    platform_points: Array
    directions: Array
    leg_lengths: Array
    initial_actuator_positions: Array
    actuator_range: float

    def __post_init__(self) -> None:
        """Check the shapes and that the directions point upwards, as u_z = sqrt(1 - u_x² - u_y²) requires."""
        if self.n_legs < MIN_LEGS:
            raise InputError(f"mechanism {self.name!r}: found {self.n_legs} legs, expected at least {MIN_LEGS}")
        if np.any(self.directions[:, 2] <= 0):
            leg = int(np.argmin(self.directions[:, 2])) + 1
            raise InputError(
                f"mechanism {self.name!r}: direction of leg {leg} has z <= 0, expected it to point upwards"
            )

    @property
    def n_legs(self) -> int:
        """Number of legs N."""
        return len(self.leg_lengths)

    @property
    def home_joints(self) -> Array:
        """Lower joints c_i = a_i + rho_i^0 u_i at the initial actuator positions, shape (N, 3), mm."""
        return self.base_points + self.initial_actuator_positions[:, None] * self.directions
