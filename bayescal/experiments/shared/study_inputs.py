"""What a study is asked, whatever was measured: an instrument's poses of a platform on legs, or tables of readings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.experiments.frame.memory import Need
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.experiments.shared.slips import FoundSlip
from bayescal.experiments.shared.study_schema import StudyConfig, stem_of
from bayescal.experiments.shared.variant_tables import FREE, ZERO

if TYPE_CHECKING:
    import pandas as pd

    from bayescal.experiments.frame.parallel import Run
    from bayescal.experiments.shared.estimate import Fit, Subject


PAGE, ROW = 8.0, 2e-3  # s, of tables and a page, and for each row
WIDTHS = 0.15  # of a fit's time, for each factor on the widths of priors


@dataclass(frozen=True)
class Task:
    """A unit of work: a posterior of a variant, with its model error or without."""

    variant: str
    with_model_error: bool = True

    @property
    def setting(self) -> str:
        """The setting of the model error, as tables call it."""
        return FREE if self.with_model_error else ZERO

    @property
    def stem(self) -> str:
        """Name of the posterior's file without its ending."""
        return stem_of(self.variant) + ("" if self.with_model_error else "-tau-zero")


@dataclass(frozen=True, eq=False)
class Described:
    """What was found: each variant's entry of the summary, further entries of it, and tables by their names."""

    variants: dict[str, dict[str, Any]]
    tables: dict[str, pd.DataFrame]
    summary: dict[str, Any] = field(default_factory=dict)


class Inputs(ABC):
    """Config and data of a study, and the posteriors of its variants.

    Attributes
    ----------
    config : StudyConfig
    """

    config: StudyConfig

    @property
    @abstractmethod
    def machine_name(self) -> str:
        """What the summary calls the machine."""

    @property
    @abstractmethod
    def verification(self) -> np.ndarray:
        """Which rows are kept for verification, shape (P,)."""

    @property
    @abstractmethod
    def fit_class(self) -> type[Fit]:
        """What `fit` returns."""

    @property
    @abstractmethod
    def machine_files(self) -> tuple[dict[str, bytes], str]:
        """What the machines are read from, by names in one folder, and where in that folder the config's own one is."""

    @abstractmethod
    def list_commands(self) -> dict[str, str]:
        """Return files of the calibration poses' commands, and of what else was measured of the machine, by name."""

    def list_tasks(self) -> list[Task]:
        """Return all tasks, the long ones first."""
        return [Task(one.name) for one in self.config.variants]

    def name_task(self, task: Task) -> str:
        """Return a task's name, from which its random numbers come."""
        return task.variant

    @abstractmethod
    def subject(self, task: Task, factor: float = 1.0) -> Subject:
        """Return what is fitted; ``factor`` multiplies the widths of the parameters' priors."""

    @abstractmethod
    def fit(self, task: Task) -> Fit:
        """Compute one task; all numbers depend on the inputs, the config's seed and the task's name alone."""

    @abstractmethod
    def describe(self, fits: Mapping[Task, Fit], run: Run) -> Described:
        """Return what the posteriors say of variants, parameters, rows and predictions."""

    def conclude(self, summary: Mapping[str, Any], run: Run) -> dict[str, pd.DataFrame]:
        """Return tables that need the summary; none by default."""
        del summary, run
        return {}

    @abstractmethod
    def estimate_memory(self) -> Need:
        """Return what the posteriors take."""

    def estimate_seconds(self, workers: int) -> float:
        """Return about how long posteriors and pages take with so many processes, s."""
        from bayescal.experiments.shared.estimate import time_fit

        config = self.config
        widths = 1.0 + WIDTHS * sum(factor != 1.0 for factor in config.sensitivity.factor)
        each = [widths * time_fit(self.subject(task), config.sampler, config.evidence) for task in self.list_tasks()]
        return PAGE + ROW * len(self.verification) + max(max(each), sum(each) / workers)

    @abstractmethod
    def outlook(self) -> list[str]:
        """Return what each variant's data can determine, in lines."""

    @abstractmethod
    def find_slip(self) -> FoundSlip | None:
        """Return what may have happened to data that no variant's machine comes near; None where one does."""

    @cached_property
    def slip(self) -> FoundSlip | None:
        """The same, looked for once."""
        return self.find_slip()

    def doubt(self) -> list[str]:
        """Return what is probably wrong with the data, in words."""
        slip = self.slip
        return [] if slip is None else [slip.say()]

    @abstractmethod
    def measure(self, names: Sequence[str], path: Path, with_model_error: bool) -> dict[str, MeasuredReadings]:
        """Return variants as measured, all that are named are there; ``path`` is the config's file."""
