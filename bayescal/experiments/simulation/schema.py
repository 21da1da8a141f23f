"""The schema of simulated measurements: readings of channels, photogrammetry, poses, tracked points."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.classes import ClassMark
from bayescal.config.sections import (
    ExperimentConfig,
    InputFile,
    Name,
    NotNegative,
    Number,
    PerLeg,
    Positive,
    Section,
    Vector,
)
from bayescal.density.schema import PriorConfig
from bayescal.experiments.shared.readings.schema import ChannelConfig, FreeConfig, InstrumentConfig, ProvenanceConfig
from bayescal.experiments.shared.schema import Bounds, Range, RotationNoiseConfig, UnitsConfig
from bayescal.machines.schema import TargetRingConfig


class TruthConfig(Section):
    """A given true machine, instead of one drawn within [parameters]: nominal plus offsets, or of a file."""

    deformation_matrix: InputFile | None = None
    """CSV file of the true deformation matrix K of a machine on legs; rigid without one."""
    offsets: dict[str, PerLeg] | None = None
    """True minus nominal value by symbol, one for all or one each [as tolerances]."""
    parameters: InputFile | None = None
    """CSV file of the true parameters, as a simulation writes it; instead of offsets."""

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        if (self.offsets is None) == (self.parameters is None):
            raise ValueError("expected offsets or parameters")
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
    actuator_um: NotNegative | None = Field(default=None, exclude_if=lambda value: value is None)
    """Standard deviation of an actuator's position about what it reads, with [poses]; elsewhere [sensors] have it."""


class TargetsConfig(Section):
    """Targets on the rigid parts of both bodies and, where there are any, on the pads that carry the legs' joints."""

    base: Annotated[list[TargetRingConfig], Field(min_length=1)]
    """Circles of targets on the base."""
    platform: Annotated[list[TargetRingConfig], Field(min_length=1)]
    """Circles of targets on the rigid part of the platform."""
    targets_per_pad: Annotated[int, Field(ge=0, le=100)] = 0
    """Targets on the pad of each leg's joint."""
    pad_radius_mm: Positive | None = None
    """Radius of the circle that the targets of a pad lie on."""

    @model_validator(mode="after")
    def _check_pads(self) -> Self:
        if self.targets_per_pad and self.pad_radius_mm is None:
            raise ValueError(f"targets_per_pad {self.targets_per_pad}: expected pad_radius_mm with it")
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


class PoseInstrumentConfig(RotationNoiseConfig):
    """An instrument that hands out poses, or their positions alone."""

    kind: Literal["poses"]
    """`"poses"`."""
    position_um: Positive
    """Standard deviation of a position, each axis."""
    frames: FramesTruthConfig = FramesTruthConfig()
    """True frames of instrument and probe."""


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
    missing_fraction: Annotated[Number, Field(ge=0.0, lt=1.0)] = 0.0
    """Fraction of points that are not seen [1]."""
    frames: FramesTruthConfig = FramesTruthConfig()
    """True frames of stations and probe."""


type PlatformInstrumentConfig = Annotated[PoseInstrumentConfig | PointInstrumentConfig, Field(discriminator="kind")]


class SimulatedProvenanceConfig(ProvenanceConfig):
    """What the files say of where the data come from: not measured."""

    status: Literal["simulated", "reconstructed"]
    """`simulated`, or `reconstructed` from what somebody printed."""


OF_CHANNELS = ("sensors", "n_poses", "n_verification_poses", "instruments", "parameters", "workspace", "conditions")
OF_PLANS = ("truth", "poses", "noise")
"""Sections of random poses, the first two needed, and of planned ones of a machine on legs, all needed."""
OF_TARGETS = ("noise", "measurement_frame")
"""Sections that only targets need, but for the noise of planned poses."""


class SimulationConfig(FreeConfig, ExperimentConfig):
    """Simulated measurements of any machine: readings of its channels, poses or points that an instrument sees.

    [sensors] and n_poses make readings at random poses of the workspace, of a machine drawn within [parameters] or of
    [truth]; with [instrument] the poses or points that it sees of the tool, with [targets] a survey of these on base
    and tool. [poses] plan the actuator positions of a machine on legs at which either is done.
    """

    kind: Literal["simulation"]
    """`"simulation"`."""
    provenance: SimulatedProvenanceConfig
    """What is written into all files about where they come from."""
    machine: InputFile
    """The machine's TOML file, as nominal; a mechanism's is one."""
    model: Annotated[str, ClassMark("MODELS")] | None = None
    """Kinematic model that a mechanism is seen through; needed of a mechanism alone."""
    units: UnitsConfig = UnitsConfig()
    """Units of tolerances, of the truth's offsets and of the workspace."""
    truth: TruthConfig | None = None
    """A given true machine instead of a drawn one."""
    instruments: dict[Name, InstrumentConfig] = Field(default={})
    """By name: instruments beside the machine."""
    sensors: dict[str, ChannelConfig] = Field(default={})
    """Noise of each channel that is read, or of all of a kind."""
    parameters: dict[str, PriorConfig] = Field(default={})
    """Tolerance of each symbol, within which the true machine is drawn."""
    workspace: dict[str, Bounds] = Field(default={})
    """By coordinate: smallest and largest value of the poses [unit of the coordinate]."""
    conditions: dict[str, Range] = Field(default={})
    """By column: smallest and largest value of what the machine has to know of a row [unit of the column]."""
    n_poses: Annotated[int, Field(ge=1, le=100_000)] | None = None
    """Number of random poses to calibrate with."""
    n_verification_poses: Annotated[int, Field(ge=0, le=100_000)] = 0
    """Number of random poses that are held back."""
    poses: PosesConfig | None = None
    """At which actuator positions an instrument sees the platform."""
    noise: NoiseConfig | None = None
    """Noise of targets and actuators."""
    targets: TargetsConfig | None = None
    """Targets on the base and on what carries the tool, for photogrammetry."""
    measurement_frame: MeasurementFrameConfig | None = None
    """How far the frame of photogrammetry wanders from pose to pose."""
    instrument: PlatformInstrumentConfig | None = None
    """An instrument that sees the tool, instead of photogrammetry."""

    @property
    def is_planned(self) -> bool:
        """Whether the poses are planned ones of a machine on legs."""
        return self.poses is not None

    @model_validator(mode="after")
    def _check_poses(self) -> Self:
        planned = self.is_planned
        needed, strange = (OF_PLANS, OF_CHANNELS) if planned else (OF_CHANNELS[:2], OF_TARGETS)
        for name in needed:
            if not getattr(self, name):
                expected = "it" if planned else "it, or [poses] with legs"
                raise ValueError(f"{name}: found none, expected {expected}")
        for name in strange if planned or self.targets is None else ():
            if name in self.model_fields_set:
                raise ValueError(f"{name}: found beside {'poses' if planned else 'sensors'}, expected either")
        if self.noise is not None and (self.noise.actuator_um is None) == planned:
            found = "missing, expected it with poses" if planned else "found beside sensors, expected either"
            raise ValueError(f"noise.actuator_um: {found}")
        if self.poses is not None and self.targets is None and self.instrument is None:
            raise ValueError("poses: found no [targets] or [instrument], expected either")
        return self

    @model_validator(mode="after")
    def _check_photogrammetry(self) -> Self:
        parts = {"measurement_frame": self.measurement_frame, "noise.target_um": self.noise and self.noise.target_um}
        for name, value in parts.items():
            if self.targets is not None and value is None:
                raise ValueError(f"{name}: missing, expected it with targets")
            if self.targets is None and value is not None:
                raise ValueError(f"{name}: found without targets, expected them")
        if self.targets is not None and self.instrument is not None:
            raise ValueError("instrument: found with targets, expected either")
        return self
