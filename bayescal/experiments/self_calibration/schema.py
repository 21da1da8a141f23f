"""The schemas of a self-calibration from readings, and of readings simulated for one. Keys carry their units."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.sections import ExperimentConfig, InputFile, Name, Names, Section
from bayescal.inference.schema import EvidenceConfig, SamplerConfig
from bayescal.machines.readings.schema import Count, PlanarPosesConfig, ReadingSensorConfig, ReadingTolerancesConfig

type Sensors = Annotated[dict[str, ReadingSensorConfig], Field(min_length=1)]


class ReadingDataConfig(Section):
    """CSV files: readings; of simulated ones also the truth, parameters and poses, to compare with."""

    readings: InputFile
    true_parameters: InputFile | None = None
    true_poses: InputFile | None = None

    @model_validator(mode="after")
    def _check_truth(self) -> Self:
        if (self.true_parameters is None) != (self.true_poses is None):
            raise ValueError("expected true_parameters and true_poses both or none")
        return self


class ReadingVariantConfig(Section):
    """Sensors that are used, and what is free: by default what they see, but for what defines the frames.

    ``fixed`` keeps parameters, or all of a symbol, nominal; ``also_free`` frees some that define frames, for an
    instrument beside the machine; parameters of a ``common`` symbol deviate alike.
    """

    name: Name
    title: str
    sensors: Annotated[Names, Field(min_length=1)]
    fixed: Names = Field(default_factory=list)
    also_free: Names = Field(default_factory=list)
    common: Names = Field(default_factory=list)

    @property
    def is_plain(self) -> bool:
        """Whether everything is free that is so by default."""
        return not self.fixed and not self.common


class SelfCalibrationConfig(ExperimentConfig):
    """One machine calibrated from the readings of its own sensors; the workspace holds what poses may be."""

    kind: Literal["self_calibration"]
    origin: str
    machine: InputFile
    data: ReadingDataConfig
    sensors: Sensors
    tolerances: ReadingTolerancesConfig
    workspace: PlanarPosesConfig
    variants: Annotated[list[ReadingVariantConfig], Field(min_length=1)]
    sampler: SamplerConfig = SamplerConfig()
    evidence: EvidenceConfig = EvidenceConfig()

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        names = [variant.name for variant in self.variants]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"variants: found {name!r} twice, expected each name once")
        return self


class ReadingTruthConfig(Section):
    """A file with all true parameters, as a simulation writes it."""

    parameters: InputFile


class ReadingSimulationConfig(ExperimentConfig):
    """Readings of a machine drawn within its tolerances, or of a given one; legs of a ``common`` symbol are alike."""

    kind: Literal["reading_simulation"]
    origin: str
    machine: InputFile
    sensors: Sensors
    tolerances: ReadingTolerancesConfig
    poses: PlanarPosesConfig
    verification_poses: Count
    truth: ReadingTruthConfig | None = None
    common: Names = Field(default_factory=list)
