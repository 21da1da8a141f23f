"""The schema of an experiment of simulated self-calibrations of a planar platform on sliding legs.

Keys carry their units.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from bayescal.config.sections import ExperimentConfig, InputFile, Names, Number, Positive, Section, check_once
from bayescal.machines.readings.schema import (
    Count,
    PlanarPosesConfig,
    ReadingSensorConfig,
    ReadingTolerancesConfig,
)

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


class SensorSetConfig(Section):
    """Sensors that are used together, single ones such as ``s[2]`` or a kind such as ``s`` on all legs."""

    name: SetName
    sensors: Annotated[Names, Field(min_length=1)]


class PathConfig(Section):
    """A circle of the tool's centre about home, along which the platform swings once to each side."""

    radius_mm: Positive
    angle_deg: Annotated[float, Field(ge=0.0, le=180.0)]
    n_poses: Annotated[int, Field(ge=8, le=10_000)] = 72


class PlausibleMachinesConfig(Section):
    """Machines of the same kind drawn evenly from ranges; those that fail to reach all poses are dropped.

    The guides lie evenly about a circle of ``guide_radius_mm``, turned from its tangents by ``guide_turn_deg``; the
    platform's joints lie on another, turned against the guides' points by ``platform_turn_deg``; poses lie within
    ``position_mm`` and ``angle_deg`` of home.
    """

    count: Repeats = 200
    calibrations: Repeats = 8
    guide_radius_mm: PositiveSpan
    guide_turn_deg: Annotated[Span, AfterValidator(partial(_within, 90.0))]
    leg_length_mm: PositiveSpan
    platform_radius_mm: PositiveSpan
    platform_turn_deg: Annotated[Span, AfterValidator(partial(_within, 180.0))]
    position_mm: PositiveSpan
    angle_deg: Annotated[PositiveSpan, AfterValidator(partial(_within, 180.0))]


class NoiseSweepConfig(Section):
    """Other noise of all angle sensors, and how many calibrations with each."""

    angle_noise_arcsec: Annotated[list[Positive], Field(min_length=2), AfterValidator(check_once)]
    calibrations: Repeats = 50


class PublishedSetsConfig(Section):
    """What was printed: of each set its number of parameters and C, from set to set the factors of improvement."""

    source: str
    calibrability: InputFile
    improvements: InputFile


class SelfCalibrationsConfig(ExperimentConfig):
    """Simulated self-calibrations with different sets of sensors, as in Šika et al. (2008)."""

    kind: Literal["self_calibrations"]
    machine: InputFile
    calibrations: Repeats = 200
    sensors: dict[str, ReadingSensorConfig]
    tolerances: ReadingTolerancesConfig
    poses: PlanarPosesConfig
    verification_poses: Count = 50
    path: PathConfig
    sets: Annotated[list[SensorSetConfig], Field(min_length=1)]
    machines: PlausibleMachinesConfig | None = None
    noise_sweep: NoiseSweepConfig | None = None
    published: PublishedSetsConfig | None = None

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        names = [one.name for one in self.sets]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"found two sets of the name {name!r}, expected a name for each")
        return self
