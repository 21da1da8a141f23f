"""The schema of simulated photogrammetry."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.classes import ClassMark
from bayescal.config.sections import (
    ExperimentConfig,
    InputFile,
    NotNegative,
    Number,
    PerLeg,
    Positive,
    Section,
)


class TruthConfig(Section):
    """The machine behind the simulated data, and a deformation matrix; rigid without one.

    Its parameters are nominal plus offsets, or those of a file as a simulation writes it.
    """

    deformation_matrix: InputFile | None = None
    offsets: dict[str, PerLeg] | None = None
    parameters: InputFile | None = None

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        if (self.offsets is None) == (self.parameters is None):
            raise ValueError("expected either offsets or parameters")
        return self


class PosesConfig(Section):
    """Actuator configurations as CSV tables in units of ``unit_mm`` about the initial position."""

    calibration: InputFile
    verification: InputFile
    unit_mm: Positive


class NoiseConfig(Section):
    """Standard deviations."""

    target_um: NotNegative
    actuator_um: NotNegative


class TargetRingConfig(Section):
    """Targets evenly on a circle of a body."""

    count: Annotated[int, Field(ge=1)]
    radius_mm: Positive
    height_mm: Number
    azimuth_deg: Number = 0.0


class TargetsConfig(Section):
    """Targets on the rigid parts of both bodies and, where there are any, on the pads that carry the legs' joints."""

    base: Annotated[list[TargetRingConfig], Field(min_length=1)]
    platform: Annotated[list[TargetRingConfig], Field(min_length=1)]
    per_pad: Annotated[int, Field(ge=0)] = 0
    pad_radius_mm: Positive | None = None

    @model_validator(mode="after")
    def _check_pads(self) -> Self:
        if self.per_pad and self.pad_radius_mm is None:
            raise ValueError(f"found per_pad {self.per_pad} without pad_radius_mm, expected both")
        return self


class MeasurementFrameConfig(Section):
    """How far the measurement frame wanders from pose to pose."""

    distance_mm: NotNegative
    angle_deg: NotNegative


class SimulationConfig(ExperimentConfig):
    """Simulated photogrammetry of a machine."""

    kind: Literal["simulation"]
    origin: str
    mechanism: InputFile
    model: Annotated[str, ClassMark("MODELS")]
    truth: TruthConfig
    poses: PosesConfig
    noise: NoiseConfig
    targets: TargetsConfig
    measurement_frame: MeasurementFrameConfig
