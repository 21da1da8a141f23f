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
from bayescal.numerics.units import choose_arcseconds


class TruthConfig(Section):
    """The machine behind the simulated data, and a deformation matrix; rigid without one.

    Its parameters are nominal plus offsets, or those of a file as a simulation writes it.
    """

    deformation_matrix: InputFile | None = None
    """CSV file of the true deformation matrix K; rigid without one."""
    offsets: dict[str, PerLeg] | None = None
    """True minus nominal value by symbol, one for all legs or one per leg [units of the parameters]."""
    parameters: InputFile | None = None
    """CSV file of the true parameters, as a simulation writes it; in place of offsets."""

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        if (self.offsets is None) == (self.parameters is None):
            raise ValueError("expected either offsets or parameters")
        return self


class PosesConfig(Section):
    """Actuator configurations as CSV tables in units of ``unit_mm`` about the initial position."""

    calibration: InputFile
    """CSV file of actuator displacements to calibrate with, a row a pose."""
    verification: InputFile
    """CSV file of actuator displacements that are held back."""
    unit_mm: Positive
    """Unit of the numbers in both files."""


class NoiseConfig(Section):
    """Standard deviations."""

    target_um: NotNegative | None = Field(default=None, exclude_if=lambda value: value is None)
    """Standard deviation of a target's coordinates."""
    actuator_um: NotNegative
    """Standard deviation of an actuator's position about what it reads."""


class TargetRingConfig(Section):
    """Targets evenly on a circle of a body."""

    count: Annotated[int, Field(ge=1, le=1000)]
    """Number of targets, evenly on the circle."""
    radius_mm: Positive
    """Radius of the circle."""
    height_mm: Number
    """Height of the circle above the body's origin."""
    azimuth_deg: Number = 0.0
    """Where the first target lies."""


class TargetsConfig(Section):
    """Targets on the rigid parts of both bodies and, where there are any, on the pads that carry the legs' joints."""

    base: Annotated[list[TargetRingConfig], Field(min_length=1)]
    """Circles of targets on the base."""
    platform: Annotated[list[TargetRingConfig], Field(min_length=1)]
    """Circles of targets on the rigid part of the platform."""
    per_pad: Annotated[int, Field(ge=0, le=100)] = 0
    """Targets on the pad of each leg's joint."""
    pad_radius_mm: Positive | None = None
    """Radius of the circle that the targets of a pad lie on."""

    @model_validator(mode="after")
    def _check_pads(self) -> Self:
        if self.per_pad and self.pad_radius_mm is None:
            raise ValueError(f"found per_pad {self.per_pad} without pad_radius_mm, expected both")
        return self


class MeasurementFrameConfig(Section):
    """How far the measurement frame wanders from pose to pose."""

    distance_mm: NotNegative
    """Standard deviation of its origin, along each axis."""
    angle_deg: NotNegative
    """Standard deviation of its rotation, about each axis."""


class FrameTruthConfig(Section):
    """Where a frame truly lies, against where it should: displacement and rotation vector."""

    position_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    """Displacement."""
    rotation_deg: Vector = Field(default=[0.0, 0.0, 0.0])
    """Rotation vector."""


class FramesTruthConfig(Section):
    """True frames of the instrument, one per station, and of the tool."""

    base: list[FrameTruthConfig] = Field(default=[])
    """True frames of the instrument against where they should be, one per station."""
    tool: FrameTruthConfig = FrameTruthConfig()
    """True frame of the probe on the platform."""


class PoseInstrumentConfig(Section):
    """An instrument that hands out poses, or their positions alone."""

    kind: Literal["poses"]
    """`"poses"`."""
    position_um: Positive
    """Standard deviation of a position, each axis."""
    orientation_arcsec: Positive | None = None
    """Standard deviation of a rotation, each axis; positions alone without it."""
    orientation_urad: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """The same in microradians, in place of arcseconds."""
    frames: FramesTruthConfig = FramesTruthConfig()
    """True frames of instrument and probe."""

    @model_validator(mode="after")
    def _check_one_unit(self) -> Self:
        choose_arcseconds(self.orientation_arcsec, self.orientation_urad)
        return self

    @property
    def arcseconds(self) -> float | None:
        """The noise of a rotation in arcseconds, whichever unit states it."""
        return choose_arcseconds(self.orientation_arcsec, self.orientation_urad)


class PointInstrumentConfig(Section):
    """Stations that see points on the platform by range, azimuth and elevation, each missed now and then."""

    kind: Literal["points"]
    """`"points"`."""
    probe: InputFile
    """CSV file of the points on the platform."""
    stations: InputFile | None = None
    """CSV file of where stations stand; one in the base frame without it."""
    range_um: NotNegative
    """Standard deviation of a range."""
    range_ppm: NotNegative = 0.0
    """What is added to it, in millionths of the range."""
    azimuth_arcsec: Positive
    """Standard deviation of an azimuth."""
    elevation_arcsec: Positive
    """Standard deviation of an elevation."""
    missed: Annotated[Number, Field(ge=0.0, lt=1.0)] = 0.0
    """Share of points that are not seen [1]."""
    frames: FramesTruthConfig = FramesTruthConfig()
    """True frames of stations and probe."""


type InstrumentConfig = Annotated[PoseInstrumentConfig | PointInstrumentConfig, Field(discriminator="kind")]


class SimulationConfig(ExperimentConfig):
    """Simulated measurements of a machine: targets in a frame that wanders, or readings of an instrument."""

    kind: Literal["simulation"]
    """`"simulation"`."""
    origin: str
    """What is written into all files about where they come from."""
    mechanism: InputFile
    """The machine's TOML file, as nominal."""
    model: Annotated[str, ClassMark("MODELS")]
    """Kinematic model of the true machine."""
    truth: TruthConfig
    """How the true machine differs from the nominal one."""
    poses: PosesConfig
    """At which actuator positions it is measured."""
    noise: NoiseConfig
    """Noise of targets and actuators."""
    targets: TargetsConfig | None = Field(default=None, exclude_if=lambda value: value is None)
    """Targets on the bodies, for photogrammetry."""
    measurement_frame: MeasurementFrameConfig | None = Field(default=None, exclude_if=lambda value: value is None)
    """How far the frame of photogrammetry wanders from pose to pose."""
    instrument: InstrumentConfig | None = Field(default=None, exclude_if=lambda value: value is None)
    """An instrument in place of photogrammetry."""

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
