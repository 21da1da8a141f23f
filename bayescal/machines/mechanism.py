"""The machine as it was designed: nominal geometry of a parallel mechanism of N legs.

What an actuator moves is the machine's drive: the joint at the base of a leg of fixed length (prismatic-universal-
spherical legs), or the length of a strut between two joints that stay where they are (universal-prismatic-spherical).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.parameters import DirectionChart, HomeStart, ParameterBlock, ParameterLayout, choose_chart
from bayescal.numerics.geometry import Array

MIN_LEGS = 6
UNIT = 1e-9  # by which the length of a direction may differ from one

type Drive = Literal["base", "strut"]


@dataclass(frozen=True)
class BeamSection:
    """Stiffness of a beam's cross-section (RR-8096 eq. 21): k1 = EI and k3 = GJ in N mm², k2 = ES in N."""

    k1: float
    k2: float
    k3: float


def section_of_rod(diameter: float, young_modulus: float, shear_modulus: float) -> BeamSection:
    """Return the section of a solid round rod; diameter in mm, moduli in N/mm² (MPa)."""
    area, inertia = np.pi * diameter**2 / 4, np.pi * diameter**4 / 64
    return BeamSection(k1=young_modulus * inertia, k2=young_modulus * area, k3=shear_modulus * 2 * inertia)


@dataclass(frozen=True)
class Flexures:
    """Flexure joints at both ends of every leg (RR-8096 figures 10 and 12)."""

    lengths: Array  # (N,): l_b of the flexures of each leg, mm
    beta: Array  # (N,): β, where a flexure's centre of motion lies, as a share of l_b; between 0 and 1/2
    # of a flexure and of a leg between its flexures
    section: BeamSection | None = None
    leg_section: BeamSection | None = None


@dataclass(frozen=True)
class ExternalLoad:
    """What pulls at the platform besides its legs: a wrench at the platform's origin, and its weight."""

    # in N and N mm, base frame
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    weight: tuple[float, float, float] = (0.0, 0.0, 0.0)  # the platform's weight in N, base frame
    centre_of_mass: tuple[float, float, float] = (0.0, 0.0, 0.0)  # where the weight acts, mm, platform frame


@dataclass(frozen=True)
class Mechanism:
    """Nominal geometry of an N-leg platform, frames and symbols of RR-8096 section 2.2."""

    name: str
    base_points: Array  # (N, 3): a_i, attachment of actuator i or lower joint of strut i, base frame, mm
    platform_points: Array  # (N, 3): b_i, joint of leg i on the platform, platform frame, mm
    directions: Array  # (N, 3): u_i, unit direction of actuator i, base frame; zeros for struts
    leg_lengths: Array  # (N,): l_i, mm; of a strut, its length at the initial actuator position
    initial_actuator_positions: Array  # (N,): rho_i^0, mm; displacements are measured from here
    actuator_range: float  # largest displacement from the initial position, mm
    flexures: Flexures | None = None  # for the models that know of flexures
    load: ExternalLoad = ExternalLoad()  # for the models that know of forces
    drive: Drive = "base"  # whether actuators move the joints at the base or change the lengths of struts
    # where the platform's origin stands at home, level, base frame, mm; the start of the search for the home pose
    home_position: tuple[float, float, float] | None = None
    # without a home position, whether the platform stands below the lower joints at home and not above them
    platform_below: bool = False
    # (N,): true travel of each actuator from its initial position over what it reads; None where nothing is said of it
    actuator_gains: Array | None = None

    def __post_init__(self) -> None:
        """Check the number of legs and that the actuators' directions are unit vectors."""
        if self.n_legs < MIN_LEGS:
            raise InputError(
                f"mechanism {self.name!r}: found {self.n_legs} legs, expected at least {MIN_LEGS}, or "
                "a machine of channels"
            )
        sizes = np.linalg.norm(self.directions, axis=1)
        if self.drive == "base" and not np.all(np.abs(sizes - 1.0) < UNIT):
            leg = int(np.argmax(np.abs(sizes - 1.0)))
            raise InputError(
                f"mechanism {self.name!r}: direction of leg {leg + 1} has length {sizes[leg]:g}, expected a unit vector"
            )

    @property
    def n_legs(self) -> int:
        """Number of legs N."""
        return len(self.leg_lengths)

    @cached_property
    def chart(self) -> DirectionChart:
        """Which components of the actuators' directions are parameters; for struts, that of vertical actuators."""
        return choose_chart(self.directions if self.drive == "base" else np.tile([0.0, 0.0, 1.0], (self.n_legs, 1)))

    def lay_out(self, blocks: Iterable[ParameterBlock]) -> ParameterLayout:
        """Return blocks of parameters laid out for this machine."""
        chart = self.chart if self.drive == "base" else None
        return ParameterLayout(tuple(blocks), chart, HomeStart(self.home_position, self.platform_below))

    def place_actuators(self, readings: Array) -> Array:
        """Return where actuators of the nominal machine stand that read (..., N), mm."""
        if self.actuator_gains is None:
            return readings
        start = self.initial_actuator_positions
        return np.asarray(start + self.actuator_gains * (readings - start))

    @property
    def home_joints(self) -> Array:
        """Lower joints at the initial actuator positions, shape (N, 3), mm: c_i = a_i + rho_i^0 u_i, a_i of a strut."""
        if self.drive == "strut":
            return self.base_points
        return self.base_points + self.initial_actuator_positions[:, None] * self.directions
