"""Instruments that a config names in [instruments]: the machine before them, and what is left without them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from bayescal.config.classes import choose, name_failures
from bayescal.config.load import read_toml
from bayescal.config.registry import list_sources
from bayescal.errors import InputError
from bayescal.experiments.shared.design import read_machine
from bayescal.experiments.shared.readings.schema import InstrumentConfig
from bayescal.experiments.shared.schema import DeformationConfig, ModelConfig
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig
from bayescal.machines.read import keep_machines, read_reading_model
from bayescal.machines.readings import Instrument, Legs, ReadingModel
from bayescal.machines.readings.legs import TILTS
from bayescal.numerics.geometry import Array


def read_instruments(sections: Mapping[str, InstrumentConfig], folder: Path) -> dict[str, Instrument]:
    """Return instruments by their names; InputError for faults of an instrument's section or class."""
    instruments = {}
    for one, section in sections.items():
        field = f"instruments.{one}"
        choice = choose("INSTRUMENTS", section.kind, Instrument, f"{field}.kind", folder, section.options)  # type: ignore[type-abstract]
        with name_failures(choice.found, field):
            instruments[one] = choice.found(choice.options)
    return instruments


class HasInstruments(Protocol):
    """A config of a machine by its channels."""

    @property
    def sensors(self) -> Mapping[str, Any]:
        """By channel or kind of channels."""

    @property
    def parameters(self) -> Mapping[str, Any]:
        """By symbol; optional ones of a machine are there where they are named."""

    @property
    def deformation(self) -> DeformationConfig:
        """Nominal deformation of the platform of a machine on legs."""


class HasModel(Protocol):
    """A variant that may name how a machine on legs is seen."""

    @property
    def model(self) -> str | None:
        """Kinematic model of a mechanism's file."""

    @property
    def deformation(self) -> str:
        """Deformation of its platform."""


def read_model(
    config: HasInstruments, variant: HasModel, path: Path, folder: Path, matrix: Callable[[], Array] | None = None
) -> ReadingModel:
    """Return the machine of a file; a mechanism by the channels of its legs, as a variant sees them.

    It has inclinometers where the config has any, and the matrix K of ``matrix`` where that was measured.

    Raises
    ------
    InputError
        For faults of the machine's file, a mechanism without a model and a model of another machine.
    """
    if "kind" in read_toml(path)[0]:
        if variant.model is not None:
            raise InputError(f"model: found {variant.model!r}, expected none for {path}")
        return read_reading_model(path).with_optional(config.parameters)
    if variant.model is None:
        raise InputError(f"model: missing, expected the kinematic model of {path}")
    seen = ModelConfig(model=variant.model, deformation=variant.deformation)
    inclined = any(name.partition("[")[0] in TILTS for name in config.sensors)
    machine = read_machine(path, seen, config.deformation, folder, matrix)
    return Legs(machine, inclined=inclined).with_optional(config.parameters)


def _list_seen(config: StudyConfig, folder: Path) -> list[Path]:
    """Return what machines are seen by besides their files: K, and user-defined classes, instruments' among them."""
    seen = [one for one in config.variants if one.model is not None]
    files = [
        folder / file
        for one in seen
        for what, name in zip(("MODELS", "DEFORMATIONS"), one.seen, strict=True)
        for file in list_sources(what, name, folder)
    ]
    for one in config.instruments.values():
        files += [folder / file for file in list_sources("INSTRUMENTS", one.kind, folder)]
    if config.deformation.matrix != "targets" and any(one.deformation == "matrix" for one in seen):
        files.append(folder / config.deformation.matrix)
    return list(dict.fromkeys(files))


def list_machines(config: StudyConfig) -> list[str]:
    """Return the files of the machine, those of single variants too."""
    return list(dict.fromkeys(one.machine or config.machine for one in config.variants))


def keep_files(config: StudyConfig, folder: Path) -> tuple[dict[str, bytes], str]:
    """Return what the machines are read from, by names in one folder, and where in that folder the config's own is."""
    files, places = keep_machines([folder / name for name in list_machines(config)], _list_seen(config, folder), folder)
    return files, places[folder]


def leave_instruments(
    config: StudyConfig, variant: VariantConfig, machine: ReadingModel
) -> tuple[StudyConfig, VariantConfig]:
    """Return a config that has run, and a variant of it, without what is not the machine's own."""
    if not config.instruments:
        return config, variant
    own = {*machine.layout.symbols, *machine.layout.names}
    read = {*machine.names, *(one.kind for one in machine.channels)}  # an instrument may be called as a symbol is
    kept = {
        "sensors": {name: one for name, one in config.sensors.items() if name in read},
        "parameters": {name: one for name, one in config.parameters.items() if name in own},
    }
    common = [one for one in variant.tied if own.issuperset([one] if isinstance(one, str) else one)]
    free = None if variant.free is None else [one for one in variant.free if one in own]
    return (
        config.model_copy(update={"instruments": {}, **kept}),
        variant.model_copy(update={"free": free, "tied": common}),
    )
