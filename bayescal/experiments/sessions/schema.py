"""The schema of sessions."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, FiniteFloat, model_validator

from bayescal.config.sections import InputFile, Number, Positive, Section, check_once
from bayescal.experiments.shared.derived import OfAnotherConfig
from bayescal.experiments.shared.readings.schema import ProvenanceConfig
from bayescal.experiments.shared.schema import IgnoredDataErrors

type Temperature = Annotated[FiniteFloat, Field(ge=-273.15, le=2000.0)]
type Expansion = Annotated[FiniteFloat, Field(ge=-1000.0, le=1000.0)]
type ExpansionSd = Annotated[FiniteFloat, Field(gt=0.0, le=1000.0)]


class SessionTableConfig(Section):
    """The files of a session's table, instead of those of the study's; what it does not name is the study's."""

    file: InputFile
    """File of the measurements."""
    actuators: InputFile | None = None
    """CSV file of actuator positions."""
    reference: InputFile | None = None
    """CSV file of the targets on their bodies."""
    probe: InputFile | None = None
    """CSV file of where points sit on the platform."""
    stations: InputFile | None = None
    """CSV file of where stations stand."""


class SessionConfig(Section):
    """One session: what was measured, when, and how warm it was."""

    label: Annotated[str, Field(min_length=1, max_length=60)]
    """Name of the session, or of the machine."""
    time_days: Number | None = None
    """Time of the session, counted from any day; a random walk needs it [d]."""
    data: Annotated[list[SessionTableConfig], Field(min_length=1)]
    """Its tables, one for each `[[data]]` of the study, in their order."""
    temperature_celsius: Temperature | None = None
    """Temperature of the machine in the whole session [deg C]."""
    temperatures: InputFile | None = None
    """CSV file with a temperature for each pose: pose, temperature_celsius."""
    ignored_data_errors: IgnoredDataErrors = Field(default=[], exclude_if=lambda value: not value)
    """Kinds of slips that its data look like and are not, as somebody says who looked: `unit`, `legs`, `rows`, `poses`,
    `channel`, `frame`."""

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        if self.temperature_celsius is not None and self.temperatures is not None:
            raise ValueError("found temperature_celsius and temperatures, expected either")
        return self


class DriftConfig(Section):
    """What may move between sessions, and how much of it is expected."""

    model: Literal["random_walk", "population"] = "random_walk"
    """`"random_walk"`: of the parameters of one machine; `"population"`: several machines of a design, each off its
    mean.
    """
    symbols: Annotated[list[str], AfterValidator(check_once), Field(min_length=1)] = Field(default=["l"])
    """Symbols of free lengths that may move."""
    scale_um: Positive | None = None
    """Half-normal prior of each scale of a length: of a walk over the root of a month, of machines the spread between
    them.
    """
    scale_arcsec: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """The same of an angle."""
    separate_by_leg: bool = True
    """Whether every leg has a scale of its own for every symbol, or all legs share one."""


class BodyConfig(Section):
    """Expansion of a body, normal under the prior."""

    ppm: Expansion
    """Expected coefficient [1e-6 / K]."""
    sd_ppm: ExpansionSd
    """Standard deviation of the coefficient about it [1e-6 / K]."""


class OwnBodyConfig(BodyConfig):
    """Expansion of the lengths of a machine of any channels."""

    symbols: Annotated[list[str], AfterValidator(check_once), Field(min_length=1)]
    """Symbols of its lengths."""


class ThermalConfig(Section):
    """Lengths by temperature: L (1 + α (T - reference))."""

    reference_celsius: Temperature
    """Temperature at which the parameters are what they are called [deg C]."""
    struts: BodyConfig | None = None
    """The legs' lengths l."""
    base: BodyConfig | None = None
    """The base points a; they stay where they are without it."""
    platform: BodyConfig | None = None
    """The platform points b; they stay where they are without it."""
    bodies: dict[str, OwnBodyConfig] = Field(default={}, exclude_if=lambda value: not value)
    """Bodies of any machine by their names, each with the symbols of its lengths."""


class SessionsConfig(OfAnotherConfig):
    """Sessions of one machine, or of machines of one design."""

    kind: Literal["sessions"]
    """`"sessions"`."""
    variant: str | None = Field(default=None, exclude_if=lambda value: value is None)
    """Its variant, by its name; needed where it has several."""
    provenance: ProvenanceConfig
    """Where the data come from, in words: measured or simulated."""
    sessions: Annotated[list[SessionConfig], Field(min_length=2, max_length=60)]
    """The sessions, in the order of their days."""
    drift: DriftConfig
    """What may move between them."""
    thermal: ThermalConfig | None = None
    """What the temperature does; nothing without it."""
    motion_limit_arcsec: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """The same of a channel that reads an angle; 20 where nothing is said."""
    motion_limit_um: Positive = 20.0
    """A motion of a leg from which on it counts: the probability that it moved further is told."""
    draws: Annotated[int, Field(ge=500, le=200_000)] = 3000
    """Draws for every evidence, a third of which stand for the posterior."""

    @model_validator(mode="after")
    def _check_sessions(self) -> Self:
        check_once([one.label for one in self.sessions])
        if self.drift.model == "random_walk":
            for one, before in zip(self.sessions, [None, *self.sessions], strict=False):
                if one.time_days is None:
                    raise ValueError(f"session {one.label!r}: found no time_days, expected it where parameters drift")
                if before is not None and before.time_days is not None and one.time_days <= before.time_days:
                    raise ValueError(
                        f"session {one.label!r}: found time_days {one.time_days:g} after "
                        f"{before.time_days:g} of {before.label!r}, expected ascending days"
                    )
        if self.thermal is not None:
            for one in self.sessions:
                if one.temperature_celsius is None and one.temperatures is None:
                    raise ValueError(
                        f"session {one.label!r}: found no temperature, expected temperature_celsius "
                        "or temperatures for [thermal]"
                    )
        return self
