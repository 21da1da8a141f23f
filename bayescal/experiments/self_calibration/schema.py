"""The schemas of a self-calibration from readings, and of readings simulated for one. Keys carry their units."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.sections import ExperimentConfig, InputFile, Name, Names, Positive, Section
from bayescal.density.schema import KernelChoiceConfig, KernelConfig
from bayescal.experiments.shared.slips import DeniedSlips
from bayescal.inference.schema import EvidenceConfig, SamplerConfig
from bayescal.machines.readings.schema import Count, PlanarPosesConfig, ReadingSensorConfig, ReadingTolerancesConfig

type Sensors = Annotated[dict[str, ReadingSensorConfig], Field(min_length=1)]


class ReadingDataConfig(Section):
    """CSV files: readings; of simulated ones also the truth, parameters and poses, to compare with."""

    readings: InputFile
    """CSV file of readings."""
    true_parameters: InputFile | None = None
    """CSV file of the true parameters, of simulated readings."""
    true_poses: InputFile | None = None
    """CSV file of the true poses, of simulated readings."""
    denied_slips: DeniedSlips = Field(default=[], exclude_if=lambda value: not value)
    """Kinds of slips that the readings look like and are not, as somebody says who looked: `unit`, `legs`, `rows`."""

    @model_validator(mode="after")
    def _check_truth(self) -> Self:
        if (self.true_parameters is None) != (self.true_poses is None):
            raise ValueError("expected true_parameters and true_poses both or none")
        return self


class ReadingErrorConfig(KernelConfig):
    """Prior of sensors' errors that are functions of what they read, the same every time.

    Each sensor has a function of its own reading, zero at home; a sensor of lengths errs by ``kernel_scale_um`` at the
    end of its range, one of angles by ``kernel_scale_arcsec``. The range is how far the reading goes from home over
    the workspace. One scale holds for all sensors of a kind, or for each with ``kernel_per_leg``.
    """

    kernel_scale_arcsec: Positive = 20.0
    """What a sensor of angles errs by at the end of its range, one standard deviation."""
    kernel_sensors: Annotated[Names, Field(min_length=1)] | None = None
    """Sensors, or kinds of them, that may err so; all of the machine's own where nothing is said."""


class ReadingVariantConfig(KernelChoiceConfig):
    """Sensors that are used, and what is free: by default what they see, but for what defines the frames.

    ``fixed`` keeps parameters, or all of a symbol, nominal; ``also_free`` frees some that define frames, for an
    instrument beside the machine; parameters of a ``common`` symbol deviate alike. ``model_error`` is a kernel of
    errors that are functions of the readings.
    """

    name: Name
    """What tables call the variant."""
    title: str
    """What the page calls it."""
    sensors: Annotated[Names, Field(min_length=1)]
    """Sensors, or kinds of them, that are used."""
    fixed: Names = Field(default_factory=list)
    """Parameters, or symbols, that stay nominal."""
    also_free: Names = Field(default_factory=list)
    """Parameters that define frames and are free all the same."""
    common: Names = Field(default_factory=list)
    """Symbols whose parameters deviate alike."""

    @property
    def is_plain(self) -> bool:
        """Whether everything is free that is so by default."""
        return not self.fixed and not self.common


class SelfCalibrationConfig(ExperimentConfig):
    """One machine calibrated from the readings of its own sensors; the workspace holds what poses may be."""

    kind: Literal["self_calibration"]
    """`"self_calibration"`."""
    origin: str
    """What the page says of where the data come from."""
    machine: InputFile
    """The machine's TOML file."""
    data: ReadingDataConfig
    """The tables."""
    sensors: Sensors
    """Noise of each sensor, or of all of a kind."""
    tolerances: ReadingTolerancesConfig
    """How far dimensions may be off."""
    workspace: PlanarPosesConfig
    """Where poses may be."""
    model_error: ReadingErrorConfig = Field(
        default=ReadingErrorConfig(), exclude_if=lambda value: value == ReadingErrorConfig()
    )
    """Sensors' errors that are functions of what they read."""
    variants: Annotated[list[ReadingVariantConfig], Field(min_length=1)]
    """Models to compare."""
    sampler: SamplerConfig = SamplerConfig()
    """Effort of sampling."""
    evidence: EvidenceConfig = EvidenceConfig()
    """Effort of the evidence."""

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
    """CSV file of all true parameters, as a simulation writes it."""


class ReadingSimulationConfig(ExperimentConfig):
    """Readings of a machine drawn within its tolerances, or of a given one; legs of a ``common`` symbol are alike."""

    kind: Literal["reading_simulation"]
    """`"reading_simulation"`."""
    origin: str
    """What is written into all files about where they come from."""
    machine: InputFile
    """The machine's TOML file."""
    sensors: Sensors
    """Noise of each sensor, or of all of a kind."""
    tolerances: ReadingTolerancesConfig
    """How far dimensions may be off; the true machine is drawn within."""
    poses: PlanarPosesConfig
    """Where it is measured."""
    verification_poses: Count
    """Number of poses that are held back."""
    truth: ReadingTruthConfig | None = None
    """A given true machine in place of a drawn one."""
    common: Names = Field(default_factory=list)
    """Symbols whose parameters deviate alike."""
