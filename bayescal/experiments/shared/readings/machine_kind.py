"""What kinds of experiment on a machine have in common: its files and classes are of their identity; a first look."""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path

from bayescal.config.load import read_toml
from bayescal.config.registry import hash_modules
from bayescal.config.sections import ExperimentConfig
from bayescal.errors import InputError
from bayescal.experiments.runner.experiment import Experiment
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import find_machine_classes, list_machine_sources, load_mechanism, read_reading_model


class MachineExperiment[C: ExperimentConfig, I](Experiment[C, I]):
    """A kind of experiment whose config names machines' files; these name the machines' classes."""

    @abstractmethod
    def machines(self, config: C) -> list[str]:
        """Return the files of the machines, relative to the config's folder."""

    def files(self, config: C, folder: Path) -> list[str]:
        """Return the input files, those that machines' files name and the sources of their classes among them."""
        sources = [
            os.path.normpath(Path(name).parent / one)
            for name in self.machines(config)
            for one in list_machine_sources(folder / name)
        ]
        return [*super().files(config, folder), *sources]

    def modules(self, config: C, folder: Path) -> dict[str, str]:
        """Return the hashes of installed modules that the machines' classes stand in."""
        own = [one for name in self.machines(config) for one in find_machine_classes(folder / name)]
        return super().modules(config, folder) | hash_modules(own)


def look_at_machine(content: Mapping[str, object], folder: Path) -> tuple[Mechanism | None, list[str]]:
    """Return the mechanism that a config names, None for another machine, and what is wrong with the file, in lines.

    Whatever else is wrong with the config.
    """
    name = content.get("machine", content.get("mechanism"))
    if not isinstance(name, str):
        return None, []
    try:
        if "kind" in read_toml(folder / name)[0]:
            read_reading_model(folder / name)
            return None, []
        return load_mechanism(folder / name), []
    except InputError as error:
        return None, list(error.lines)
