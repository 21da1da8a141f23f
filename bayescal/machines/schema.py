"""Sections of machine files; keys carry their units, angles are in degrees."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, FiniteFloat, model_validator

from bayescal.config.classes import ClassMark
from bayescal.config.sections import InputFile, NotNegative, Number, PerLeg, Positive, PositivePerLeg, Section, Vector
from bayescal.limits import LARGEST_KAPPA

type Beta = Annotated[FiniteFloat, Field(gt=0, lt=0.5)]


class PointsConfig(Section):
    """Points of a body: on a circle by azimuth, or one by one."""

    radius_mm: Positive | None = None
    """Radius of the circle that the points lie on; with `azimuth_deg`."""
    azimuth_deg: list[Number] | None = None
    """Where on the circle they lie, one angle per leg, from x towards y."""
    height_mm: Number = 0.0
    """Height of the circle above the body's origin."""
    points_mm: list[Vector] | None = None
    """The points one by one, x, y, z of each leg, instead of a circle."""

    @model_validator(mode="after")
    def _check_one_way(self) -> Self:
        circle = [one for one in (self.radius_mm, self.azimuth_deg) if one is not None]
        one_by_one = self.points_mm is not None and not circle and self.height_mm == 0.0
        if not one_by_one and (len(circle) < 2 or self.points_mm is not None):
            raise ValueError("expected radius_mm with azimuth_deg, or points_mm")
        return self


class TargetRingConfig(Section):
    """Targets evenly on a circle of a body."""

    count: Annotated[int, Field(ge=1, le=1000)]
    """Number of targets, evenly on the circle."""
    radius_mm: Positive
    """Radius of the circle."""
    height_mm: Number
    """Height of the circle above the body's origin."""
    azimuth_deg: Number = 0.0
    """Where the first target lies."""


class LegsConfig(Section):
    """Lengths, actuator directions and initial actuator positions: one value for all legs or one per leg.

    Actuators drive the joints at the ``base`` along their directions, or each the length of a ``strut``. Directions may
    be of any length and sense; they are normalised. The lengths of legs may follow from the home pose.
    """

    actuated_joint: Literal["base", "strut"] = "base"
    """What the actuators move: the joints at the `base`, or the length of a `strut`."""
    length_mm: PositivePerLeg | None = None
    """Lengths of the legs between their joints; where they are missing they follow from the home pose."""
    direction: Vector | list[Vector] | None = None
    """Directions of the actuators at the base, one for all legs or one per leg, of any length [1]."""
    initial_actuator_position_mm: PerLeg = 0.0
    """What the actuators read at home."""
    actuator_range_mm: Positive
    """How far an actuator may move from its initial position, to either side."""
    actuator_gain: PositivePerLeg | None = None
    """True travel of an actuator over what it reads, both from its initial position; 1 where nothing is said [1]."""

    @model_validator(mode="after")
    def _check_drive(self) -> Self:
        if self.actuated_joint == "strut" and self.direction is not None:
            raise ValueError("found direction with actuated_joint 'strut', expected none")
        return self


class HomeConfig(Section):
    """Where the platform's origin stands at home, base frame, with the platform level; it gives the legs' lengths.

    With lengths given, near which place it is found, or on which side of the legs' lower joints the platform stands,
    above where nothing is said.
    """

    position_mm: Vector | None = None
    """Where the platform's origin stands at home, the platform level; the legs' lengths follow."""
    initial_guess_mm: Vector | None = None
    """With lengths given: near which place the home pose is."""
    platform: Literal["above", "below"] | None = None
    """With lengths given: on which side of the legs' lower joints the platform stands."""

    @model_validator(mode="after")
    def _check_one_way(self) -> Self:
        if sum(one is not None for one in (self.position_mm, self.initial_guess_mm, self.platform)) != 1:
            raise ValueError("expected position_mm, or platform or initial_guess_mm with leg lengths")
        return self


class FlexuresConfig(Section):
    """Flexure joints at both ends of every leg: length l_b and β, one value for all legs or one per leg."""

    length_mm: PositivePerLeg
    """Length of a flexure joint."""
    beta: Beta | list[Beta] = 0.25
    """Where its centre of motion lies, as a share of its length from the leg's end [1]."""


class BeamSectionConfig(Section):
    """A round solid section of an elastic material, or k1 = EI, k2 = ES and k3 = GJ themselves."""

    diameter_mm: Positive | None = None
    """Diameter of the round section."""
    young_modulus_gpa: Positive | None = None
    """Young's modulus."""
    shear_modulus_gpa: Positive | None = None
    """Shear modulus."""
    k1_n_mm2: Positive | None = None
    """Bending stiffness EI."""
    k2_n: Positive | None = None
    """Stretching stiffness ES."""
    k3_n_mm2: Positive | None = None
    """Twisting stiffness GJ."""

    @model_validator(mode="after")
    def _check_one_way(self) -> Self:
        rod, numbers = {"diameter_mm", "young_modulus_gpa", "shear_modulus_gpa"}, {"k1_n_mm2", "k2_n", "k3_n_mm2"}
        if self.model_fields_set not in (rod, numbers):
            raise ValueError(
                "expected diameter_mm, young_modulus_gpa and shear_modulus_gpa, or k1_n_mm2, k2_n and k3_n_mm2"
            )
        return self


class StiffnessConfig(Section):
    """Sections of a flexure and of a leg between its flexures, the same for all legs."""

    flexure: BeamSectionConfig
    """Section of a flexure joint."""
    leg: BeamSectionConfig
    """Section of a leg between its flexures."""


class LoadConfig(Section):
    """What pulls at the platform besides its legs, base frame; its weight acts at the centre of mass."""

    force_n: Vector = Field(default=[0.0, 0.0, 0.0])
    """Force on the platform at its origin."""
    moment_n_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    """Moment on the platform about its origin."""
    mass_kg: NotNegative = 0.0
    """Mass of the platform, whose weight acts at the centre of mass."""
    centre_of_mass_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    """Where the centre of mass lies, platform frame."""
    gravity_m_s2: Vector = Field(default=[0.0, 0.0, -9.80665])
    """Acceleration of gravity, base frame."""


class MechanismConfig(Section):
    """A platform on legs, driven at the base or as struts."""

    name: str
    """What pages call the machine."""
    base: PointsConfig
    """Where the legs' joints at the base are: of moving feet where the actuators are at zero."""
    platform: PointsConfig
    """Where the legs' joints on the platform are, platform frame."""
    legs: LegsConfig
    """Lengths and actuators."""
    home: HomeConfig | None = None
    """The home pose, from which lengths follow or which tells the assembly."""
    flexures: FlexuresConfig | None = None
    """Flexure joints, for the models `beam` and `stiffness`."""
    stiffness: StiffnessConfig | None = None
    """Sections of flexures and legs, for the model `stiffness`."""
    load: LoadConfig = LoadConfig()
    """What pulls at the platform besides its legs, for the model `stiffness`."""

    @model_validator(mode="after")
    def _check_flexures(self) -> Self:
        if self.stiffness is not None and self.flexures is None:
            raise ValueError("found [stiffness], expected [flexures] with it")
        return self


type Count = Annotated[int, Field(ge=1, le=100_000)]
type Turn = Annotated[float, Field(ge=-360.0, le=360.0, allow_inf_nan=False)]
type Point = Annotated[list[Number], Field(min_length=2, max_length=2)]


class SlidingLegConfig(Section):
    """A leg: where its carriage reads zero, where its guide points, its length, its joint on the platform.

    ``direction`` says whether it points along its guide, from the carriage, or against it.
    """

    guide_point_mm: Point
    """Where the carriage reads zero, x and y."""
    guide_angle_deg: Turn
    """Where the guide points, from x towards y."""
    length_mm: Positive
    """Length of the leg."""
    platform_point_mm: Point
    """The leg's joint on the platform, platform frame."""
    direction: Literal["along", "against"] = "along"
    """Whether the leg points from the carriage along its guide, or against it."""


class ToolConfig(Section):
    """The tool's centre in the platform's frame."""

    point_mm: Point
    """The tool's centre, platform frame."""


class PlanarHomeConfig(Section):
    """Where the tool's centre stands at home, and how the platform is turned there."""

    tool_mm: Point
    """Where the tool's centre stands at home."""
    angle_deg: Turn
    """How the platform is turned at home."""


class MachineFileConfig(Section):
    """What the file of any machine says."""

    kind: str
    """Class of the machine: a built-in name, or `file.py:Class` beside this file."""
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
    """What tables call the machine."""
    title: str = ""
    """What pages call the machine; its name where nothing is said."""
    source: str = ""
    """Where the dimensions come from."""
    places: Literal[1, 2] = 1
    """In a row of the data the machine stands at one place, or at `2`: then channels are `s[1a]` and `s[1b]`,
    `height[a]` and `height[b]`, and `distance` from tool to tool [1].
    """


class SlidingPlatformConfig(MachineFileConfig):
    """A planar platform on sliding legs; platform points lie in a frame of its own, whose origin does not matter."""

    kind: Literal["sliding_platform"]
    """`"sliding_platform"`."""
    legs: Annotated[list[SlidingLegConfig], Field(min_length=1)]
    """The legs, one table each."""
    tool: ToolConfig
    """The tool on the platform."""
    home: PlanarHomeConfig
    """The home pose."""


class LegsMachineConfig(MachineFileConfig):
    """A mechanism on legs seen by its sensors, through a kinematic model and a deformation of the platform."""

    kind: Literal["legs"]
    """`"legs"`."""
    mechanism: InputFile
    """The mechanism's TOML file."""
    model: Annotated[str, ClassMark("MODELS")]
    """Kinematic model; `bayescal list models` shows all."""
    deformation: Annotated[str, ClassMark("DEFORMATIONS")] = "none"
    """Deformation of the platform: `none`, `linear` or `matrix`, or one of your own."""
    kappa: Annotated[Number, Field(ge=-LARGEST_KAPPA, le=LARGEST_KAPPA)] = 0.0
    """Nominal share of its leg's displacement by which a joint shifts, for the deformation `linear` [1]."""
    matrix: InputFile | None = None
    """CSV file of the matrix K for the deformation `matrix`, in thousandths."""
    tool_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    """The tool's centre, platform frame."""
    places: Literal[1] = 1
    """One place in a row: only a machine of one function may stand at two [1]."""
