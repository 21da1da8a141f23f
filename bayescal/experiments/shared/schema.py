"""Sections that several kinds of experiment share: units, model, sensors, noise, workspace, requirements."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from bayescal.config.classes import ClassMark, OwnSection
from bayescal.config.load import OWN
from bayescal.config.sections import FileMark, Names, NotNegative, Number, Positive, Section
from bayescal.data.schema import TargetRingConfig
from bayescal.limits import LARGEST_KAPPA
from bayescal.machines.schema import PointsConfig

type Axes = Literal["x", "y", "z", "xy", "xz", "yz", "xyz"]
type Turns = Annotated[list[Annotated[NotNegative, Field(le=180.0)]], Field(min_length=3, max_length=3)]
type Extent = Annotated[list[NotNegative], Field(min_length=3, max_length=3)]


class DeformationConfig(Section):
    """Nominal platform deformation: κ for the linear variant, K for the matrix variant.

    ``matrix`` is the name of a CSV file, or ``targets`` to take K from the targets on the platform.
    """

    kappa: Annotated[Number, Field(ge=-LARGEST_KAPPA, le=LARGEST_KAPPA)] = 0.0
    matrix: Annotated[str, FileMark(but=("targets",))] = "targets"


class UnitsConfig(Section):
    """Units of tolerances, requirements and results; the mechanism's file has its own."""

    length: Literal["um", "mm", "m"] = "mm"
    angle: Literal["arcsec", "mrad", "deg", "rad"] = "deg"


class ModelConfig(Section):
    """A kinematic model with a deformation; without a list, every parameter that has a prior is free."""

    model: Annotated[str, ClassMark("MODELS")]
    deformation: Annotated[str, ClassMark("DEFORMATIONS")] = "none"
    free: Annotated[Names, Field(min_length=1)] | None = None


class PoseSensorConfig(Section):
    """An instrument that hands out poses, or a part of them."""

    kind: Literal["pose"]
    position_um: Positive | None = None
    orientation_arcsec: Positive | None = None
    axes: Axes = "xyz"

    @model_validator(mode="after")
    def _check_something(self) -> Self:
        if self.position_um is None and self.orientation_arcsec is None:
            raise ValueError("expected position_um or orientation_arcsec, or both")
        return self


class TargetSensorConfig(Section):
    """An instrument that sees points on the platform, and on the base where its own frame wanders."""

    kind: Literal["targets"]
    noise_um: Positive
    platform: Annotated[list[TargetRingConfig], Field(min_length=1)] | PointsConfig
    base: Annotated[list[TargetRingConfig], Field(min_length=1)] | PointsConfig | None = None


class OwnSensorConfig(OwnSection):
    """An instrument of somebody else's class, with its options."""

    kind: Annotated[str, ClassMark("SENSORS", beside=True)]


def _tag_sensor(section: Any) -> str:
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
    model_error_um: NotNegative = 0.0


class FrameConfig(Section):
    """How well a frame is known: standard deviations along and about its axes."""

    position: Positive
    rotation: Positive


class FramesConfig(Section):
    """Frames that the calibration has to find: the instrument's against the base, the tool's against the platform."""

    base: FrameConfig | None = None
    tool: FrameConfig | None = None


class WorkspaceConfig(Section):
    """Where accuracy counts: half widths about the home pose.

    ``ellipsoid``: all axes together within one; ``box``: every combination; ``axes``: one axis at a time.
    """

    position_mm: Extent
    rotation_deg: Turns
    shape: Literal["ellipsoid", "box", "axes"] = "ellipsoid"
    poses: Annotated[int, Field(ge=12, le=5000)] = 200


class RequirementsConfig(Section):
    """Largest errors of the calibrated machine's pose anywhere in the workspace."""

    x: Positive | None = None
    y: Positive | None = None
    z: Positive | None = None
    position: Positive | None = None
    rotation_x: Positive | None = None
    rotation_y: Positive | None = None
    rotation_z: Positive | None = None
    rotation: Positive | None = None

    @property
    def is_any(self) -> bool:
        """Whether anything is required."""
        return any(limit is not None for _, limit in self)
