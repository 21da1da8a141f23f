"""The schema of simulated measurements: photogrammetry, poses that an instrument hands out, tracked points."""

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
    Vector,
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

    target_um: NotNegative | None = Field(default=None, exclude_if=lambda value: value is None)
    actuator_um: NotNegative


class TargetRingConfig(Section):
    """Targets evenly on a circle of a body."""

    count: Annotated[int, Field(ge=1, le=1000)]
    radius_mm: Positive
    height_mm: Number
    azimuth_deg: Number = 0.0


class TargetsConfig(Section):
    """Targets on the rigid parts of both bodies and, where there are any, on the pads that carry the legs' joints."""

    base: Annotated[list[TargetRingConfig], Field(min_length=1)]
    platform: Annotated[list[TargetRingConfig], Field(min_length=1)]
    per_pad: Annotated[int, Field(ge=0, le=100)] = 0
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


class FrameTruthConfig(Section):
    """Where a frame truly lies, against where it should: displacement and rotation vector."""

    position_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    rotation_deg: Vector = Field(default=[0.0, 0.0, 0.0])


class FramesTruthConfig(Section):
    """True frames of the instrument, one per station, and of the tool."""

    base: list[FrameTruthConfig] = Field(default=[])
    tool: FrameTruthConfig = FrameTruthConfig()


class PoseInstrumentConfig(Section):
    """An instrument that hands out poses, or their positions alone."""

    kind: Literal["poses"]
    position_um: Positive
    orientation_arcsec: Positive | None = None
    frames: FramesTruthConfig = FramesTruthConfig()


class PointInstrumentConfig(Section):
    """Stations that see points on the platform by range, azimuth and elevation, each missed now and then."""

    kind: Literal["points"]
    probe: InputFile
    stations: InputFile | None = None
    range_um: NotNegative
    range_ppm: NotNegative = 0.0
    azimuth_arcsec: Positive
    elevation_arcsec: Positive
    missed: Annotated[Number, Field(ge=0.0, lt=1.0)] = 0.0
    frames: FramesTruthConfig = FramesTruthConfig()


type InstrumentConfig = Annotated[PoseInstrumentConfig | PointInstrumentConfig, Field(discriminator="kind")]


class SimulationConfig(ExperimentConfig):
    """Simulated measurements of a machine: targets in a frame that wanders, or readings of an instrument."""

    kind: Literal["simulation"]
    origin: str
    mechanism: InputFile
    model: Annotated[str, ClassMark("MODELS")]
    truth: TruthConfig
    poses: PosesConfig
    noise: NoiseConfig
    targets: TargetsConfig | None = Field(default=None, exclude_if=lambda value: value is None)
    measurement_frame: MeasurementFrameConfig | None = Field(default=None, exclude_if=lambda value: value is None)
    instrument: InstrumentConfig | None = Field(default=None, exclude_if=lambda value: value is None)

    @model_validator(mode="after")
    def _check_measurement(self) -> Self:
        photogrammetry = {
            "targets": self.targets,
            "measurement_frame": self.measurement_frame,
            "noise.target_um": self.noise.target_um,
        }
        for name, value in photogrammetry.items():
            if self.instrument is None and value is None:
                raise ValueError(f"found no {name}, expected it, or [instrument]")
            if self.instrument is not None and value is not None:
                raise ValueError(f"found {name} beside [instrument], expected either")
        return self
