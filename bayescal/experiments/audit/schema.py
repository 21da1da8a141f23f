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
    """`"file"`."""
    configurations: InputFile
    """CSV file of actuator displacements, a row a pose."""
    unit_mm: Positive = 1.0
    """Unit of its numbers."""


class ActuatorPlanConfig(Section):
    """Random displacements of the actuators, even over their range or at its ends and middle."""

    plan: Literal["uniform", "extremes"]
    """`uniform`: evenly over the range; `extremes`: at its ends and its middle."""
    count: Annotated[int, Field(ge=1, le=10_000)]
    """Number of poses."""
    range_mm: Positive | None = None
    """Largest displacement to either side; the actuators' range where nothing is said."""


class WorkspacePlanConfig(Section):
    """Random poses of the workspace."""

    plan: Literal["workspace"]
    """`"workspace"`."""
    count: Annotated[int, Field(ge=1, le=10_000)]
    """Number of poses."""


type PlanConfig = Annotated[FilePlanConfig | ActuatorPlanConfig | WorkspacePlanConfig, Field(discriminator="plan")]


# --- what is required --------------------------------------------------------------------------------------------


# --- what would help ---------------------------------------------------------------------------------------------


class WhatIfConfig(Section):
    """A change of the plan; what is not named stays."""

    name: str
    """What the page calls the change."""
    poses_factor: Annotated[Positive, Field(ge=1e-4, le=1e4)] = 1.0
    """Factor on the number of poses [1]."""
    workspace_factor: Factor = 1.0
    """Factor on the displacements [1]."""
    noise_factor: Factor = 1.0
    """Factor on the noise of the instruments [1]."""
    actuator_noise_factor: Factor = 1.0
    """Factor on the noise of the actuators [1]."""
    sensors: Annotated[Names, Field(min_length=1)] | None = None
    """Other instruments."""
    poses: PlanConfig | None = None
    """Another plan."""


class SweepConfig(Section):
    """Factors on the sensors' noise and on the actuators' range, and numbers of poses, one swept at a time."""

    noise: Annotated[list[Factor], AfterValidator(check_once)] = Field(default=[0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0])
    """Factors on the noise of the instruments [1]."""
    poses: Annotated[list[Annotated[int, Field(ge=1, le=10_000)]], AfterValidator(check_once)] = Field(
        default=[6, 8, 10, 15, 20, 30, 40, 60, 100, 200]
    )
    """Numbers of poses."""
    workspace: Annotated[list[Factor], AfterValidator(check_once)] = Field(default=[0.25, 0.5, 1.0, 2.0, 4.0])
    """Factors on the displacements [1]."""


class AuditDataConfig(Section):
    """A study whose measured poses are audited in place of a plan, with its priors and its posterior.

    ``variant`` names one of the study's variants, needed where several have the design's model and deformation.
    """

    study: InputFile
    """TOML file of a study, whose measured poses are audited."""
    variant: str | None = None
    """One of its variants by name, where several have the design's model and deformation."""
    with_model_error: bool = True
    """Whether the posterior has a model error."""


class StructuredErrorConfig(Section):
    """What the legs err by as a function of the pose, beside what is drawn anew at every pose."""

    kernel: Literal["linear", "quadratic", "smooth"]
    """Kind of function of the actuators' travel: `linear`, `quadratic` (linear and quadratic), or `smooth`."""
    scale_um: Positive
    """What one actuator at the end of its range makes a leg err by, one standard deviation."""
    length: Positive = 5.0
    """Over how far quadratic and smooth errors change [ranges of the actuators]."""


OF_PLANS = ("noise", "structured_error", "poses", "measured_by", "parameters")
NOT_STRUCTURED = ("requirements", "profiles", "simulated_calibrations", "expected_over_draws")
"""What an audit does not have of errors that are functions of the pose."""


class AuditConfig(ExperimentConfig):
    """An audit."""

    kind: Literal["audit"]
    """`"audit"`."""
    mechanism: InputFile | None = None
    """The machine's TOML file."""
    variant: ModelConfig
    """Model, deformation and free parameters."""
    units: UnitsConfig = UnitsConfig()
    """Units of tolerances, requirements and results."""
    deformation: DeformationConfig = DeformationConfig()
    """Nominal deformation of the platform."""
    parameters: dict[str, PriorConfig] = Field(default={})
    """Tolerance of each symbol."""
    frames: FramesConfig = FramesConfig()
    """Frames that the calibration has to find."""
    noise: ActuatorNoiseConfig | None = None
    """Noise of the actuators and model error."""
    structured_error: StructuredErrorConfig | None = Field(default=None, exclude_if=lambda value: value is None)
    """Error of the legs that is a function of the pose."""
    sensors: dict[str, SensorConfig] = Field(default={})
    """Instruments by name."""
    measured_by: Names = Field(default=[])
    """Instruments that measure each pose."""
    poses: PlanConfig | None = None
    """Planned poses."""
    data: AuditDataConfig | None = None
    """A study of measured poses in place of a plan."""
    posterior: DrawsConfig = DrawsConfig()
    """Effort of posterior draws."""
    workspace: WorkspaceConfig | None = None
    """Where accuracy counts."""
    requirements: RequirementsConfig = RequirementsConfig()
    """What is required there."""
    what_if: list[WhatIfConfig] = Field(default=[])
    """Changes of the plan whose effect is told."""
    sweep: SweepConfig = SweepConfig()
    """Factors and numbers of poses that the page's curves go over."""
    profiles: Names = Field(default=[])
    """Parameters whose profiles are drawn; a few that matter where nothing is said."""
    simulated_calibrations: Annotated[int, Field(ge=0, le=10_000)] = 0
    """How many calibrations are simulated to see whether the predicted deviations come true."""
    expected_over_draws: Annotated[int, Field(ge=0, le=10_000)] = 0
    """Over how many machines within the tolerances predictions are averaged."""

    @model_validator(mode="after")
    def _check_plan(self) -> Self:
        check_once([one.name for one in self.what_if])
        if self.data is not None:
            for field in (*OF_PLANS, "deformation", "frames"):
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
