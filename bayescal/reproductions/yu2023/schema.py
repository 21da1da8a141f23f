"""The schema of an experiment of many simulated calibrations of a hexapod. Keys carry their units."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from bayescal.config.sections import ExperimentConfig, Factor, InputFile, Name, Positive, Section, check_once
from bayescal.experiments.shared.schema import Extent, Turns

type Count = Annotated[int, Field(ge=1, le=100_000)]
type Repeats = Annotated[int, Field(ge=2, le=100_000)]
type Index = Literal["O1", "O2", "O3", "O4", "O5"]


class BoxConfig(Section):
    """Half widths of the workspace about home, position and rotation vector."""

    position_mm: Extent
    rotation_deg: Turns


class TabuConfig(Section):
    """The improved DETMAX and the even candidates that it selects from."""

    candidates: Count = 2000
    list_length: Annotated[int, Field(ge=0, le=100_000)] = 100
    iterations: Count = 219


class PoseNoiseConfig(Section):
    """Standard deviations of a measured pose: each coordinate, each of the angles α, β, γ."""

    position_mm: Annotated[Positive, Field(le=100.0)]
    attitude_deg: Annotated[Positive, Field(le=10.0)]


class ConditionConfig(PoseNoiseConfig):
    """A measurement condition."""

    name: Name
    poses: Count


class IndexStudyConfig(Section):
    """Observability indices compared by calibrations with the poses that each selects (table 4, figure 5)."""

    of: Literal["observability"]
    indices: Annotated[list[Index], Field(min_length=1), AfterValidator(check_once)]
    conditions: Annotated[list[ConditionConfig], Field(min_length=1)]
    parameter_sets: Repeats = 100
    noise_draws: Repeats = 200
    selections: Annotated[int, Field(ge=2, le=1000)] = 4
    workspace_scales: Annotated[list[Factor], AfterValidator(check_once)] = Field(default_factory=list)
    published: InputFile | None = None

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        check_once([condition.name for condition in self.conditions])
        if 1.0 in self.workspace_scales:
            raise ValueError("workspace_scales: found 1, the workspace itself, expected others")
        return self


class AccuracyStudyConfig(Section):
    """Selected poses against random ones, and least squares with and without weights (tables 6 to 8)."""

    of: Literal["accuracy"]
    poses: Count
    noise: PoseNoiseConfig
    repeats: Repeats = 200
    selections: Annotated[int, Field(ge=1, le=1000)] = 4
    parameter_errors: InputFile
    published: InputFile | None = None
    published_parameters: InputFile | None = None


class NumberStudyConfig(Section):
    """The integrated error against the number of poses (figure 10)."""

    of: Literal["numbers"]
    poses: Annotated[list[Count], Field(min_length=2), AfterValidator(check_once)]
    noise: PoseNoiseConfig
    repeats: Repeats = 200
    selections: Annotated[int, Field(ge=1, le=1000)] = 4
    parameter_errors: InputFile


type StudyOfConfig = Annotated[IndexStudyConfig | AccuracyStudyConfig | NumberStudyConfig, Field(discriminator="of")]


class HexapodCalibrationsConfig(ExperimentConfig):
    """Many simulated calibrations of a hexapod, as in Yu, Wu and Wang (2023)."""

    kind: Literal["hexapod_calibrations"]
    mechanism: InputFile
    workspace: BoxConfig
    selection: TabuConfig = TabuConfig()
    parameter_error_mm: Annotated[Positive, Field(ge=1e-7, le=1e3)] = 0.5
    verification_poses: Count
    study: StudyOfConfig
