"""The schema of a mechanism's file."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, FiniteFloat, model_validator

from bayescal.config.sections import NotNegative, Number, PerLeg, Positive, PositivePerLeg, Section, Vector

type Beta = Annotated[FiniteFloat, Field(gt=0, lt=0.5)]


class PointsConfig(Section):
    """Points of a body: on a circle by azimuth, or one by one."""

    radius_mm: Positive | None = None
    azimuth_deg: list[Number] | None = None
    height_mm: Number = 0.0
    points_mm: list[Vector] | None = None

    @model_validator(mode="after")
    def _check_one_way(self) -> Self:
        circle = [one for one in (self.radius_mm, self.azimuth_deg) if one is not None]
        one_by_one = self.points_mm is not None and not circle and self.height_mm == 0.0
        if not one_by_one and (len(circle) < 2 or self.points_mm is not None):
            raise ValueError("expected either radius_mm with azimuth_deg, or points_mm")
        return self


class LegsConfig(Section):
    """Lengths, actuator directions and initial actuator positions: one value for all legs or one per leg.

    Actuators drive the joints at the ``base`` along their directions, or each the length of a ``strut``. Directions may
    be of any length and sense; they are normalised. The lengths of legs may follow from the home pose.
    """

    drive: Literal["base", "strut"] = "base"
    length_mm: PositivePerLeg | None = None
    direction: Vector | list[Vector] | None = None
    initial_actuator_position_mm: PerLeg = 0.0
    actuator_range_mm: Positive

    @model_validator(mode="after")
    def _check_drive(self) -> Self:
        if self.drive == "strut" and self.direction is not None:
            raise ValueError("found direction with drive 'strut', expected none, since a strut acts along itself")
        return self


class HomeConfig(Section):
    """Where the platform's origin stands at home, base frame, with the platform level; it gives the legs' lengths.

    With lengths given, near which place it is found, or on which side of the legs' lower joints the platform stands,
    above where nothing is said.
    """

    position_mm: Vector | None = None
    near_mm: Vector | None = None
    platform: Literal["above", "below"] | None = None

    @model_validator(mode="after")
    def _check_one_way(self) -> Self:
        if sum(one is not None for one in (self.position_mm, self.near_mm, self.platform)) != 1:
            raise ValueError("expected either position_mm, or platform or near_mm with the legs' lengths")
        return self


class FlexuresConfig(Section):
    """Flexure joints at both ends of every leg: length l_b and β, one value for all legs or one per leg."""

    length_mm: PositivePerLeg
    beta: Beta | list[Beta] = 0.25


class BeamSectionConfig(Section):
    """A round solid section of an elastic material, or k1 = EI, k2 = ES and k3 = GJ themselves."""

    diameter_mm: Positive | None = None
    young_modulus_gpa: Positive | None = None
    shear_modulus_gpa: Positive | None = None
    k1_n_mm2: Positive | None = None
    k2_n: Positive | None = None
    k3_n_mm2: Positive | None = None

    @model_validator(mode="after")
    def _check_one_way(self) -> Self:
        rod, numbers = {"diameter_mm", "young_modulus_gpa", "shear_modulus_gpa"}, {"k1_n_mm2", "k2_n", "k3_n_mm2"}
        if self.model_fields_set not in (rod, numbers):
            raise ValueError(
                "expected either diameter_mm, young_modulus_gpa and shear_modulus_gpa, or k1_n_mm2, k2_n and k3_n_mm2"
            )
        return self


class StiffnessConfig(Section):
    """Sections of a flexure and of a leg between its flexures, the same for all legs."""

    flexure: BeamSectionConfig
    leg: BeamSectionConfig


class LoadConfig(Section):
    """What pulls at the platform besides its legs, base frame; its weight acts at the centre of mass."""

    force_n: Vector = Field(default=[0.0, 0.0, 0.0])
    moment_n_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    mass_kg: NotNegative = 0.0
    centre_of_mass_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    gravity_m_s2: Vector = Field(default=[0.0, 0.0, -9.80665])


class MechanismConfig(Section):
    """A platform on legs, driven at the base or as struts."""

    name: str
    base: PointsConfig
    platform: PointsConfig
    legs: LegsConfig
    home: HomeConfig | None = None
    flexures: FlexuresConfig | None = None
    stiffness: StiffnessConfig | None = None
    load: LoadConfig = LoadConfig()

    @model_validator(mode="after")
    def _check_flexures(self) -> Self:
        if self.stiffness is not None and self.flexures is None:
            raise ValueError("found [stiffness] without [flexures], expected both")
        return self
