"""What differs between studies of an instrument's poses and of tables of readings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.experiments.frame.memory import Need
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.experiments.shared.study_schema import StudyConfig


class Route(ABC):
    """How a study of some data is computed; see `bayescal.experiments.frame.experiment.Experiment`."""

    @abstractmethod
    def read(self, config: StudyConfig, folder: Path) -> Any:
        """Return inputs, whose ``config`` this is."""

    @abstractmethod
    def estimate_memory(self, inputs: Any) -> Need:
        """Return what computing with inputs will hold at once."""

    @abstractmethod
    def outlook(self, inputs: Any) -> list[str]:
        """Return what the inputs can determine, in lines."""

    @abstractmethod
    def doubt(self, inputs: Any) -> list[str]:
        """Return what is probably wrong with the inputs, in words."""

    @abstractmethod
    def compute(self, inputs: Any, run: Run) -> Results:
        """Return the results."""

    @abstractmethod
    def calibrate(
        self, results: Results, config: StudyConfig, variant: str | None, experiment: Path | None, trust: bool
    ) -> CalibratedMachine:
        """Return the machine of a variant; see `bayescal.experiments.shared.calibrating.Calibrating`."""

    @abstractmethod
    def measure(
        self, config: StudyConfig, path: Path, names: Sequence[str], with_model_error: bool
    ) -> dict[str, MeasuredReadings]:
        """Return variants as measured, all that are named are there."""
