"""Instruments that a config names in [instruments]: the machine before them, and what is left without them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from bayescal.config.classes import choose, name_failures
from bayescal.experiments.shared.readings.schema import InstrumentConfig
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig
from bayescal.machines.read import read_reading_model
from bayescal.machines.readings import Instrument, ReadingModel, place


class Instrumented(Protocol):
    """A config that names instruments."""

    @property
    def instruments(self) -> Mapping[str, InstrumentConfig]:
        """By name: instruments beside the machine."""


def read_instruments(config: Instrumented, folder: Path) -> dict[str, Instrument]:
    """Return a config's instruments by their names; InputError for faults of an instrument's section or class."""
    instruments = {}
    for one, section in config.instruments.items():
        field = f"instruments.{one}"
        choice = choose("INSTRUMENTS", section.kind, Instrument, f"{field}.kind", folder, section.options)  # type: ignore[type-abstract]
        with name_failures(choice.found, field, folder):
            instruments[one] = choice.found(choice.options)
    return instruments


def read_machine(config: StudyConfig, folder: Path, name: str = "") -> ReadingModel:
    """Return the machine of a file, by default the config's, before the config's instruments.

    Raises
    ------
    InputError
        For faults of the machine's file, of an instrument's section or class, and where one does not fit the other.
    """
    return place(read_reading_model(folder / (name or config.machine)), read_instruments(config, folder))


def leave_instruments(
    config: StudyConfig, variant: VariantConfig, machine: ReadingModel
) -> tuple[StudyConfig, VariantConfig]:
    """Return a config that has run, and a variant of it, without what is not the machine's own."""
    if not config.instruments:
        return config, variant
    own = {*machine.layout.symbols, *machine.layout.names, *machine.names, *(one.kind for one in machine.channels)}
    kept = {name: {k: v for k, v in getattr(config, name).items() if k in own} for name in ("sensors", "parameters")}
    common = [one for one in variant.common if own.issuperset([one] if isinstance(one, str) else one)]
    free = None if variant.free is None else [one for one in variant.free if one in own]
    return (
        config.model_copy(update={"instruments": {}, **kept}),
        variant.model_copy(update={"free": free, "common": common}),
    )
