"""The schema of an experiment of many simulated calibrations of a hexapod. Keys carry their units."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from bayescal.config.sections import ExperimentConfig, Factor, InputFile, Name, Positive, Section, check_once
from bayescal.experiments.shared.schema import Extent, Turns
from detmax import Count, TabuDetmaxConfig

type Repeats = Annotated[int, Field(ge=2, le=100_000)]
type Index = Literal["O1", "O2", "O3", "O4", "O5"]


class BoxConfig(Section):
    """Half widths of the workspace about home, position and rotation vector."""

    position_mm: Extent
    """Half widths of displacements."""
    rotation_deg: Turns
    """Half widths of rotation vectors."""


class TabuConfig(TabuDetmaxConfig):
    """The improved DETMAX and the even candidates that it selects from."""

    candidates: Count = 2000
    """Number of even candidates."""


class PoseNoiseConfig(Section):
    """Standard deviations of a measured pose: each coordinate, each of the angles α, β, γ."""

    position_mm: Annotated[Positive, Field(le=100.0)]
    """Standard deviation of each coordinate."""
    attitude_deg: Annotated[Positive, Field(le=10.0)]
    """Standard deviation of each angle."""


class ConditionConfig(PoseNoiseConfig):
    """A measurement condition."""

    name: Name
    """What tables call the condition."""
    poses: Count
    """Number of poses."""


class IndexStudyConfig(Section):
    """Observability indices compared by calibrations with the poses that each selects (table 4, figure 5)."""

    of: Literal["observability"]
    """`"observability"`."""
    indices: Annotated[list[Index], Field(min_length=1), AfterValidator(check_once)]
    """Indices to compare."""
    conditions: Annotated[list[ConditionConfig], Field(min_length=1)]
    """Measurement conditions."""
    parameter_sets: Repeats = 100
    """Machines drawn."""
    noise_draws: Repeats = 200
    """Draws of the noise for each."""
    selections: Annotated[int, Field(ge=2, le=1000)] = 4
    """Repeated selections of poses by each index."""
    workspace_scales: Annotated[list[Factor], AfterValidator(check_once)] = Field(default_factory=list)
    """Factors on the workspace, to see what it changes [1]."""
    published: InputFile | None = None
    """CSV file of printed values."""

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        check_once([condition.name for condition in self.conditions])
        if 1.0 in self.workspace_scales:
            raise ValueError("workspace_scales: found 1, the workspace itself, expected others")
        return self


class AccuracyStudyConfig(Section):
    """Selected poses against random ones, and least squares with and without weights (tables 6 to 8)."""

    of: Literal["accuracy"]
    """`"accuracy"`."""
    poses: Count
    """Number of poses."""
    noise: PoseNoiseConfig
    """Noise of a measured pose."""
    repeats: Repeats = 200
    """Draws of the noise."""
    selections: Annotated[int, Field(ge=1, le=1000)] = 4
    """Repeated selections of poses."""
    parameter_errors: InputFile
    """CSV file of the true machine's deviations."""
    published: InputFile | None = None
    """CSV file of printed errors."""
    published_parameters: InputFile | None = None
    """CSV file of printed parameters."""


class NumberStudyConfig(Section):
    """The integrated error against the number of poses (figure 10)."""

    of: Literal["numbers"]
    """`"numbers"`."""
    poses: Annotated[list[Count], Field(min_length=2), AfterValidator(check_once)]
    """Numbers of poses."""
    noise: PoseNoiseConfig
    """Noise of a measured pose."""
    repeats: Repeats = 200
    """Draws of the noise."""
    selections: Annotated[int, Field(ge=1, le=1000)] = 4
    """Repeated selections of poses."""
    parameter_errors: InputFile
    """CSV file of the true machine's deviations."""


type StudyOfConfig = Annotated[IndexStudyConfig | AccuracyStudyConfig | NumberStudyConfig, Field(discriminator="of")]


class HexapodCalibrationsConfig(ExperimentConfig):
    """Many simulated calibrations of a hexapod, as in Yu, Wu and Wang (2023)."""

    mechanism: InputFile
    """The machine's TOML file."""
    workspace: BoxConfig
    """Where poses lie."""
    selection: TabuConfig = TabuConfig()
    """How poses are selected."""
    parameter_error_mm: Annotated[Positive, Field(ge=1e-7, le=1e3)] = 0.5
    """Standard deviation of the true machine's parameters about nominal."""
    verification_poses: Count
    """Poses at which errors are judged."""
    study: StudyOfConfig
    """Which conclusion is repeated."""
