"""Kinds of experiment whose config names the file of another one: what that reads and runs, they do."""

from __future__ import annotations

import os
from pathlib import Path

from bayescal.config.load import list_extended
from bayescal.config.sections import ExperimentConfig, InputFile
from bayescal.experiments.runner.experiment import Experiment
from bayescal.experiments.runner.load import load


def list_study_files(file: str, folder: Path) -> list[str]:
    """Return another experiment's config, those that it extends, and the files that it reads; relative to a folder."""
    experiment, other = load(folder / file)
    beside = Path(file).parent
    read = [os.path.normpath(beside / name) for name in experiment.files(other, folder / beside)]
    return [*list_extended(file, folder), *read]


class OfAnotherConfig(ExperimentConfig):
    """What the config of every such kind has."""

    study: InputFile
    """The study's TOML file."""


class DerivedExperiment[C: OfAnotherConfig, I](Experiment[C, I]):
    """A kind about another experiment."""

    def files(self, config: C, folder: Path) -> list[str]:
        """Return its own files, that of the other experiment among them, and that one's."""
        return list(dict.fromkeys([*super().files(config, folder), *list_study_files(config.study, folder)]))

    def modules(self, config: C, folder: Path) -> dict[str, str]:
        """Return the hashes of others' modules that the other experiment's classes stand in."""
        path = folder / config.study
        experiment, other = load(path)
        return experiment.modules(other, path.parent)
