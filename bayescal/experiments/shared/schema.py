"""Sections that several kinds of experiment share: units, model, sensors, noise, workspace, requirements."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from bayescal.config.classes import ClassMark, OwnSection
from bayescal.config.load import MEASURED, OWN
from bayescal.config.sections import FileMark, Names, NotNegative, Number, Positive, Section, check_once
from bayescal.limits import LARGEST_KAPPA
from bayescal.machines.schema import PointsConfig, TargetRingConfig
from bayescal.numerics.units import choose_arcseconds


def _check_order(values: list[float]) -> list[float]:
    if values[0] > values[1]:
        raise ValueError(f"found {values[0]:g} to {values[1]:g}, expected the smaller first")
    return values


def _check_width(values: list[float]) -> list[float]:
    if values[0] == values[1]:
        raise ValueError(f"found {values[0]:g} to {values[1]:g}, expected different numbers")
    return values


type Axes = Literal["x", "y", "z", "xy", "xz", "yz", "xyz"]
type Turns = Annotated[list[Annotated[NotNegative, Field(le=180.0)]], Field(min_length=3, max_length=3)]
type Range = Annotated[list[Number], Field(min_length=2, max_length=2), AfterValidator(_check_order)]
type Bounds = Annotated[Range, AfterValidator(_check_width)]
type AccuracyFrame = Literal["aligned", "base"]
"""Relative to what a tool is accurate: after a best fit of the frames of base and tool, or in the base frame."""
type IgnoredDataErrors = Annotated[
    list[Literal["unit", "legs", "rows", "poses", "channel", "frame"]], AfterValidator(check_once)
]
type Extent = Annotated[list[NotNegative], Field(min_length=3, max_length=3)]


class DeformationConfig(Section):
    """Nominal platform deformation: κ for the linear variant, K for the matrix variant.

    ``matrix`` is the name of a CSV file, or ``targets`` to take K from the targets on the platform.
    """

    kappa: Annotated[Number, Field(ge=-LARGEST_KAPPA, le=LARGEST_KAPPA)] = 0.0
    """Nominal share of its leg's displacement by which a joint shifts, for the deformation `linear` [1]."""
    matrix: Annotated[str, FileMark(but=("targets",))] = "targets"
    """CSV file of the matrix K for the deformation `matrix`, or `targets` to take it from targets on the pads."""


class UnitsConfig(Section):
    """Units of tolerances, requirements and results; the mechanism's file has its own."""

    length: Literal["um", "mm", "m"] = "mm"
    """Unit of lengths in tolerances, requirements and results."""
    angle: Literal["arcsec", "mrad", "deg", "rad"] = "deg"
    """Unit of angles there."""


class ModelConfig(Section):
    """A kinematic model with a deformation; without a list, every parameter that has a prior is free."""

    model: Annotated[str, ClassMark("MODELS")]
    """Kinematic model; `bayescal list models` shows all."""
    deformation: Annotated[str, ClassMark("DEFORMATIONS")] = "none"
    """Deformation of the platform; `bayescal list deformations` shows all."""
    free: Annotated[Names, Field(min_length=1)] | None = None
    """Symbols that are free; all that have a prior where nothing is said."""


class RotationNoiseConfig(Section):
    """The noise of a measured rotation, in one of two units."""

    orientation_arcsec: Positive | None = None
    """Standard deviation of a rotation, each axis; none is measured where neither this nor a table states it."""
    orientation_urad: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """The same in microradians, instead of arcseconds."""

    @model_validator(mode="after")
    def _check_one_unit(self) -> Self:
        choose_arcseconds(self.orientation_arcsec, self.orientation_urad)
        return self

    @property
    def arcseconds(self) -> float | None:
        """The noise of a rotation in arcseconds, whichever unit states it."""
        return choose_arcseconds(self.orientation_arcsec, self.orientation_urad)


class PoseSensorConfig(RotationNoiseConfig):
    """An instrument that hands out poses, or a part of them."""

    kind: Literal["pose"]
    """`"pose"`."""
    position_um: Positive | None = None
    """Standard deviation of a position, each axis; without it positions are not seen."""
    axes: Axes = "xyz"
    """Which axes are seen."""

    @model_validator(mode="after")
    def _check_something(self) -> Self:
        if self.position_um is None and self.arcseconds is None:
            raise ValueError("expected position_um, orientation_arcsec, or both")
        return self


class TargetSensorConfig(Section):
    """An instrument that sees points on the platform, and on the base where its own frame wanders."""

    kind: Literal["targets"]
    """`"targets"`."""
    noise_um: Positive
    """Standard deviation of a target's coordinates."""
    platform: Annotated[list[TargetRingConfig], Field(min_length=1)] | PointsConfig
    """Targets on the platform, on circles or one by one."""
    base: Annotated[list[TargetRingConfig], Field(min_length=1)] | PointsConfig | None = None
    """Targets on the base, where the instrument's own frame wanders."""


class OwnSensorConfig(OwnSection):
    """An instrument of somebody else's class, with its options."""

    kind: Annotated[str, ClassMark("SENSORS", beside=True)]
    """Class of the instrument, `file.py:Class`; its options stand beside it."""


def _tag_sensor(section: object) -> str:
    kind = section.get("kind") if isinstance(section, dict) else getattr(section, "kind", None)
    return kind if kind in ("pose", "targets") else OWN


type SensorConfig = Annotated[
    Annotated[PoseSensorConfig, Tag("pose")]
    | Annotated[TargetSensorConfig, Tag("targets")]
    | Annotated[OwnSensorConfig, Tag(OWN)],
    Discriminator(_tag_sensor),
]


class ActuatorNoiseConfig(Section):
    """What moves a pose besides the geometry, per actuator."""

    actuator_um: NotNegative
    """Standard deviation of an actuator's position about what it reads."""
    model_error_um: NotNegative = 0.0
    """What the model leaves out, per leg, one standard deviation."""


class FrameConfig(Section):
    """How well a frame is known: standard deviations along and about its axes."""

    position: Positive
    """Standard deviation of its origin along each axis [length of units; mm in studies]."""
    rotation: Positive
    """Standard deviation about each axis [angle of units; degrees in studies]."""


class FramesConfig(Section):
    """Frames that the calibration has to find: the instrument's against the base, the tool's against the platform."""

    base: FrameConfig | None = None
    """How well the instrument's frame against the base is known; exactly, where nothing is said."""
    tool: FrameConfig | None = None
    """How well the probe's frame against the platform is known; exactly, where nothing is said."""

    @property
    def is_free(self) -> bool:
        """Whether the calibration has to find any of them."""
        return self.base is not None or self.tool is not None


class WorkspaceConfig(Section):
    """Where accuracy counts: half widths about the home pose.

    ``ellipsoid``: all axes together within one; ``box``: every combination; ``axes``: one axis at a time.
    """

    position_mm: Extent
    """Half widths in x, y and z."""
    rotation_deg: Turns
    """Half widths of the rotation vector."""
    shape: Literal["ellipsoid", "box", "axes"] = "ellipsoid"
    """All axes together within an `ellipsoid`, every combination (`box`), or one axis at a time (`axes`)."""
    poses: Annotated[int, Field(ge=12, le=5000)] = 200
    """How many poses stand for the workspace."""


def _tag_workspace(section: object) -> str:
    keys = WorkspaceConfig.model_fields.keys()
    legs = isinstance(section, WorkspaceConfig) or (isinstance(section, dict) and not keys.isdisjoint(section))
    return f"{MEASURED}home" if legs else f"{MEASURED}coordinates"


type AnyWorkspaceConfig = Annotated[
    Annotated[WorkspaceConfig, Tag(f"{MEASURED}home")] | Annotated[dict[str, Bounds], Tag(f"{MEASURED}coordinates")],
    Discriminator(_tag_workspace),
]


class RequirementsConfig(Section):
    """Largest errors of the calibrated machine's pose anywhere in the workspace."""

    x: Positive | None = None
    """Largest error along x [length of units]."""
    y: Positive | None = None
    """Largest error along y [length of units]."""
    z: Positive | None = None
    """Largest error along z [length of units]."""
    position: Positive | None = None
    """Largest distance from where the platform should be [length of units]."""
    rotation_x: Positive | None = None
    """Largest error about x [angle of units]."""
    rotation_y: Positive | None = None
    """Largest error about y [angle of units]."""
    rotation_z: Positive | None = None
    """Largest error about z [angle of units]."""
    rotation: Positive | None = None
    """Largest angle of the rotation that is wrong [angle of units]."""

    @property
    def is_any(self) -> bool:
        """Whether anything is required."""
        return any(limit is not None for _, limit in self)
