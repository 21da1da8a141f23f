"""The schema of an audit's design: a machine, its tolerances, a plan of measurement and what is required of it.

Keys that carry a unit are in it. Tolerances and requirements have no unit in their keys: they are in those of [units].
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from bayescal.config.sections import ExperimentConfig, Factor, InputFile, Names, Positive, Section, check_once
from bayescal.density.schema import FixedConfig, PriorConfig
from bayescal.experiments.shared.schema import (
    ActuatorNoiseConfig,
    DeformationConfig,
    FramesConfig,
    ModelConfig,
    RequirementsConfig,
    SensorConfig,
    UnitsConfig,
    WorkspaceConfig,
)
from bayescal.inference.schema import DrawsConfig

# --- plan of measurement -----------------------------------------------------------------------------------------


class FilePlanConfig(Section):
    """Actuator displacements from a CSV table, one row a pose."""

    plan: Literal["file"]
    configurations: InputFile
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


# --- what is required --------------------------------------------------------------------------------------------


# --- what would help ---------------------------------------------------------------------------------------------


class WhatIfConfig(Section):
    """A change of the plan; what is not named stays."""

    name: str
    poses_factor: Annotated[Positive, Field(ge=1e-4, le=1e4)] = 1.0
    workspace_factor: Factor = 1.0
    noise_factor: Factor = 1.0
    actuator_noise_factor: Factor = 1.0
    sensors: Annotated[Names, Field(min_length=1)] | None = None
    poses: PlanConfig | None = None


class SweepConfig(Section):
    """Factors on the sensors' noise and on the actuators' range, and numbers of poses, one swept at a time."""

    noise: Annotated[list[Factor], AfterValidator(check_once)] = Field(default=[0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0])
    poses: Annotated[list[Annotated[int, Field(ge=1, le=10_000)]], AfterValidator(check_once)] = Field(
        default=[6, 8, 10, 15, 20, 30, 40, 60, 100, 200]
    )
    workspace: Annotated[list[Factor], AfterValidator(check_once)] = Field(default=[0.25, 0.5, 1.0, 2.0, 4.0])


class AuditDataConfig(Section):
    """A study whose measured poses are audited in place of a plan, with its priors and its posterior.

    ``variant`` names one of the study's variants, needed where several have the design's model and deformation.
    """

    study: InputFile
    variant: str | None = None
    with_model_error: bool = True


class AuditConfig(ExperimentConfig):
    """An audit."""

    kind: Literal["audit"]
    mechanism: InputFile | None = None
    variant: ModelConfig
    units: UnitsConfig = UnitsConfig()
    deformation: DeformationConfig = DeformationConfig()
    parameters: dict[str, PriorConfig] = Field(default={})
    frames: FramesConfig = FramesConfig()
    noise: ActuatorNoiseConfig | None = None
    sensors: dict[str, SensorConfig] = Field(default={})
    measured_by: Names = Field(default=[])
    poses: PlanConfig | None = None
    data: AuditDataConfig | None = None
    posterior: DrawsConfig = DrawsConfig()
    workspace: WorkspaceConfig | None = None
    requirements: RequirementsConfig = RequirementsConfig()
    what_if: list[WhatIfConfig] = Field(default=[])
    sweep: SweepConfig = SweepConfig()
    profiles: Names = Field(default=[])
    simulated_calibrations: Annotated[int, Field(ge=0, le=10_000)] = 0
    expected_over_draws: Annotated[int, Field(ge=0, le=10_000)] = 0

    @model_validator(mode="after")
    def _check_plan(self) -> Self:
        check_once([one.name for one in self.what_if])
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
