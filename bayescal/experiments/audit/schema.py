"""The schema of an audit's design: a machine, its tolerances, a plan of measurement and what is required of it.

Keys that carry a unit are in it. Tolerances and requirements have no unit in their keys: they are in those of [units].
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.schema import (
    DeformationConfig,
    FixedConfig,
    NotNegative,
    PointsConfig,
    Positive,
    PriorConfig,
    Section,
    TargetRingConfig,
)

type Axes = Literal["x", "y", "z", "xy", "xz", "yz", "xyz"]
type Extent = Annotated[list[NotNegative], Field(min_length=3, max_length=3)]
type Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]


class UnitsConfig(Section):
    """Units of tolerances, requirements and results; the mechanism's file has its own."""

    length: Literal["um", "mm", "m"] = "mm"
    angle: Literal["arcsec", "mrad", "deg", "rad"] = "deg"


class AuditVariantConfig(Section):
    """A kinematic model with a deformation; without a list, every parameter that has a prior is free."""

    model: str
    deformation: str = "none"
    free: Annotated[list[str], Field(min_length=1)] | None = None


# --- sensors -----------------------------------------------------------------------------------------------------


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


type SensorConfig = Annotated[PoseSensorConfig | TargetSensorConfig, Field(discriminator="kind")]


# --- plan of measurement -----------------------------------------------------------------------------------------


class FilePlanConfig(Section):
    """Actuator displacements from a CSV table, one row a pose."""

    plan: Literal["file"]
    configurations: str
    unit_mm: Positive = 1.0


class ActuatorPlanConfig(Section):
    """Random displacements of the actuators, even over their range or at its ends and middle."""

    plan: Literal["uniform", "extremes"]
    count: Annotated[int, Field(ge=1, le=10_000)]
    range_mm: Positive | None = None


class WorkspacePlanConfig(Section):
    """Random poses of the workspace."""

    plan: Literal["workspace"]
    count: Annotated[int, Field(ge=1, le=10_000)]


type PlanConfig = Annotated[FilePlanConfig | ActuatorPlanConfig | WorkspacePlanConfig, Field(discriminator="plan")]


class AuditNoiseConfig(Section):
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


# --- what is required --------------------------------------------------------------------------------------------


class WorkspaceConfig(Section):
    """Where accuracy counts: half widths about the home pose.

    ``ellipsoid``: all axes together within one; ``box``: every combination; ``axes``: one axis at a time.
    """

    position_mm: Extent
    rotation_deg: Extent
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


# --- what would help ---------------------------------------------------------------------------------------------


class WhatIfConfig(Section):
    """A change of the plan; what is not named stays."""

    name: str
    poses_factor: Positive = 1.0
    workspace_factor: Positive = 1.0
    noise_factor: Positive = 1.0
    actuator_noise_factor: Positive = 1.0
    sensors: Annotated[list[str], Field(min_length=1)] | None = None
    poses: PlanConfig | None = None


class SweepConfig(Section):
    """Factors on the sensors' noise and on the actuators' range, and numbers of poses, one swept at a time."""

    noise: list[Positive] = Field(default=[0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0])
    poses: list[Annotated[int, Field(ge=1, le=10_000)]] = Field(default=[6, 8, 10, 15, 20, 30, 40, 60, 100, 200])
    workspace: list[Positive] = Field(default=[0.25, 0.5, 1.0, 2.0, 4.0])


class AuditDataConfig(Section):
    """A study whose measured poses are audited in place of a plan, with its priors and its posterior."""

    study: str
    with_model_error: bool = True


class PosteriorConfig(Section):
    """Draws of the posterior, all ensembles together: by default many where there are data, otherwise none."""

    draws: Annotated[int, Field(ge=0, le=10_000_000)] | None = None
    ensembles: Annotated[int, Field(ge=4, le=64)] = 4
    walkers: Annotated[int, Field(ge=8, le=4096)] = 128
    burn_in: Annotated[int, Field(ge=0)] = 20


class AuditConfig(Section):
    """An audit."""

    kind: Literal["audit"]
    name: Name
    title: str
    seed: Annotated[int, Field(ge=0)]
    mechanism: str | None = None
    variant: AuditVariantConfig
    units: UnitsConfig = UnitsConfig()
    deformation: DeformationConfig = DeformationConfig()
    parameters: dict[str, PriorConfig] = Field(default={})
    frames: FramesConfig = FramesConfig()
    noise: AuditNoiseConfig | None = None
    sensors: dict[str, SensorConfig] = Field(default={})
    measured_by: list[str] = Field(default=[])
    poses: PlanConfig | None = None
    data: AuditDataConfig | None = None
    posterior: PosteriorConfig = PosteriorConfig()
    workspace: WorkspaceConfig | None = None
    requirements: RequirementsConfig = RequirementsConfig()
    what_if: list[WhatIfConfig] = Field(default=[])
    sweep: SweepConfig = SweepConfig()
    profiles: list[str] = Field(default=[])
    simulated_calibrations: Annotated[int, Field(ge=0, le=10_000)] = 0
    expected_over_draws: Annotated[int, Field(ge=0, le=10_000)] = 0

    @model_validator(mode="after")
    def _check_plan(self) -> Self:
        if self.data is not None:
            for field in ("noise", "poses", "measured_by", "parameters", "deformation", "frames"):
                if field in self.model_fields_set:
                    raise ValueError(f"found {field} beside [data], expected none, since the study has its own")
        else:
            for field in ("mechanism", "noise", "poses", "sensors", "measured_by", "parameters"):
                if not getattr(self, field):
                    raise ValueError(f"found no {field}, expected it, or [data] with a study of measured poses")
            if all(isinstance(prior, FixedConfig) for prior in self.parameters.values()):
                raise ValueError("found no tolerance in [parameters], expected a normal or uniform prior of some")
        if self.requirements.model_fields_set and self.workspace is None:
            raise ValueError("found [requirements] without [workspace], expected both")
        return self
