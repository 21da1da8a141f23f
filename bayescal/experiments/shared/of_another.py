"""Kinds of experiment whose config names the file of another one: what that reads and runs, they do."""

from __future__ import annotations

import os
from pathlib import Path
from typing import ClassVar

from bayescal.config.sections import ExperimentConfig
from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.load import load


class OfAnother[C: ExperimentConfig, I](Experiment[C, I]):
    """A kind about another experiment.

    Attributes
    ----------
    another : str
        The key that names its file.
    """

    another: ClassVar[str] = "study"

    def files(self, config: C, folder: Path) -> list[str]:
        """Return its own files, that of the other experiment among them, and that one's."""
        file = getattr(config, self.another)
        experiment, other = load(folder / file)
        beside = Path(file).parent
        own = [os.path.normpath(beside / name) for name in experiment.files(other, folder / beside)]
        return list(dict.fromkeys([*super().files(config, folder), *own]))

    def modules(self, config: C, folder: Path) -> dict[str, str]:
        """Return the hashes of others' modules that the other experiment's classes stand in."""
        path = folder / getattr(config, self.another)
        experiment, other = load(path)
        return experiment.modules(other, path.parent)
