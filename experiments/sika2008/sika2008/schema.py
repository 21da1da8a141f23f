"""The schema of an experiment of simulated self-calibrations of a planar platform on sliding legs.

Keys carry their units.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from bayescal.config.sections import ExperimentConfig, InputFile, Names, Number, Positive, Section, check_once

type Count = Annotated[int, Field(ge=1, le=100_000)]
type Repeats = Annotated[int, Field(ge=2, le=100_000)]
type SetName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_. +-]+$")]


def _ordered(values: list[float]) -> list[float]:
    if values[0] > values[1]:
        raise ValueError(f"found {values}, expected the lower end first")
    return values


def _within(largest: float, values: list[float]) -> list[float]:
    if max(map(abs, values)) > largest:
        raise ValueError(f"found {values}, expected at most {largest:g} in size")
    return values


type Span = Annotated[list[Number], Field(min_length=2, max_length=2), AfterValidator(_ordered)]
type PositiveSpan = Annotated[list[Positive], Field(min_length=2, max_length=2), AfterValidator(_ordered)]


class SensorConfig(Section):
    """A sensor, or one on every leg: its noise, in µm or arcsec."""

    noise_um: Positive | None = None
    """Standard deviation of a reading of length."""
    noise_arcsec: Positive | None = None
    """Standard deviation of a reading of an angle."""

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        if (self.noise_um is None) == (self.noise_arcsec is None):
            raise ValueError("expected either noise_um or noise_arcsec")
        return self


class TolerancesConfig(Section):
    """Standard deviations beforehand: of lengths, of guide angles, of the zeros of angle sensors."""

    length_mm: Positive
    """Standard deviation of lengths and places about nominal."""
    angle_deg: Positive
    """Standard deviation of the guides' angles about nominal."""
    zero_deg: Positive
    """Standard deviation of the zeros of angle sensors."""


class PosesConfig(Section):
    """Poses spread evenly at random about home: tool's centre and angle within half widths."""

    n_poses: Count = 100
    """Number of poses."""
    position_mm: Positive
    """Half width about home of the tool's centre, in x and in y."""
    angle_deg: Annotated[float, Field(gt=0.0, le=180.0)]
    """Half width about home of the platform's angle."""


class SensorSetConfig(Section):
    """Sensors that are used together, single ones such as ``s[2]`` or a kind such as ``s`` on all legs."""

    name: SetName
    """What tables call the set."""
    sensors: Annotated[Names, Field(min_length=1)]
    """Sensors of the set, single ones or kinds."""


class PathConfig(Section):
    """A circle of the tool's centre about home, along which the platform swings once to each side."""

    radius_mm: Positive
    """Radius of the circle."""
    angle_deg: Annotated[float, Field(ge=0.0, le=180.0)]
    """How far the platform swings to each side."""
    n_poses: Annotated[int, Field(ge=8, le=10_000)] = 72
    """Number of poses on it."""


class PlausibleMachinesConfig(Section):
    """Machines of the same kind drawn evenly from ranges; those that fail to reach all poses are dropped.

    The guides lie evenly about a circle of ``guide_radius_mm``, turned from its tangents by ``guide_turn_deg``; the
    platform's joints lie on another, turned against the guides' points by ``platform_turn_deg``; poses lie within
    ``position_mm`` and ``angle_deg`` of home.
    """

    count: Repeats = 200
    """Number of machines."""
    calibrations: Repeats = 8
    """Calibrations of each."""
    guide_radius_mm: PositiveSpan
    """Smallest and largest radius of the circle that the guides lie about."""
    guide_turn_deg: Annotated[Span, AfterValidator(partial(_within, 90.0))]
    """How far guides are turned from its tangents."""
    leg_length_mm: PositiveSpan
    """Smallest and largest length of the legs."""
    platform_radius_mm: PositiveSpan
    """Smallest and largest radius of the platform's joints."""
    platform_turn_deg: Annotated[Span, AfterValidator(partial(_within, 180.0))]
    """How far they are turned against the guides' points."""
    position_mm: PositiveSpan
    """Smallest and largest half width of the poses."""
    angle_deg: Annotated[PositiveSpan, AfterValidator(partial(_within, 180.0))]
    """Smallest and largest half width of their angle."""


class NoiseSweepConfig(Section):
    """Other noise of all angle sensors, and how many calibrations with each."""

    angle_noise_arcsec: Annotated[list[Positive], Field(min_length=2), AfterValidator(check_once)]
    """Standard deviations of all angle sensors."""
    calibrations: Repeats = 50
    """Calibrations with each."""


class PublishedSetsConfig(Section):
    """What was printed: of each set its number of parameters and C, from set to set the factors of improvement."""

    source: str
    """What the page calls the source."""
    calibrability: InputFile
    """CSV file of printed numbers of parameters and C, by set."""
    improvements: InputFile
    """CSV file of printed factors from set to set."""


class SelfCalibrationsConfig(ExperimentConfig):
    """Simulated self-calibrations with different sets of sensors, as in Šika et al. (2008)."""

    machine: InputFile
    """The machine's TOML file."""
    calibrations: Repeats = 200
    """Number of simulated calibrations of the documented machine."""
    sensors: dict[str, SensorConfig]
    """Noise of each sensor, or of all of a kind."""
    tolerances: TolerancesConfig
    """How far dimensions may be off."""
    poses: PosesConfig
    """Poses to calibrate with."""
    verification_poses: Count = 50
    """Poses at which the tool's error is judged."""
    path: PathConfig
    """A path along which it is drawn."""
    sets: Annotated[list[SensorSetConfig], Field(min_length=1)]
    """Sets of sensors to compare."""
    machines: PlausibleMachinesConfig | None = None
    """Other plausible machines."""
    noise_sweep: NoiseSweepConfig | None = None
    """Other noise of the angle sensors."""
    published: PublishedSetsConfig | None = None
    """Printed values to compare with."""

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        names = [one.name for one in self.sets]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"found two sets of the name {name!r}, expected a name for each")
        return self
