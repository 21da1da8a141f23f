"""A study of tables of readings of any machine's channels: poses are eliminated from the readings of each row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayescal.experiments.frame.memory import Need
from bayescal.experiments.shared.knowledge_page import NO_TOOL
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.outlook import join_outlooks
from bayescal.experiments.shared.readings.inputs import ReadingInputs, read_inputs
from bayescal.experiments.shared.readings.memory import estimate_calibration
from bayescal.experiments.shared.slip_search import find_slip
from bayescal.experiments.shared.slips import FoundSlip
from bayescal.experiments.shared.study_inputs import Described, Inputs, Task
from bayescal.experiments.shared.study_schema import StudyConfig

if TYPE_CHECKING:
    from bayescal.experiments.frame.parallel import Run
    from bayescal.experiments.shared.estimate import Fit
    from bayescal.experiments.study.readings import ReadingFit, ReadingSubject


@dataclass(frozen=True, eq=False)
class ReadingStudy(ReadingInputs, Inputs):
    """Readings and variants, as a study is asked for them."""

    @classmethod
    def load(cls, config: StudyConfig, folder: Path) -> ReadingStudy:
        """Return machine, readings and variants."""
        return cls(**vars(read_inputs(config, folder)))

    @property
    def machine_name(self) -> str:
        """The machine's own name."""
        return self.machine

    @property
    def verification(self) -> np.ndarray:
        """Which rows are kept for verification, of the variant that takes in most."""
        return max((one.verification for one in self.variants.values()), key=len)

    @property
    def machine_files(self) -> tuple[dict[str, bytes], str]:
        """What the machines are read from, by names in one folder, and where in that folder the config's own one is."""
        return self.files, self.machine_folder

    def list_commands(self) -> dict[str, str]:
        """Return the commands of each variant's poses as files."""
        from bayescal.experiments.study.calibrated import format_variants_commands

        return format_variants_commands(self)

    @property
    def fit_class(self) -> type[ReadingFit]:
        """A fit with residuals and what its machine determines."""
        from bayescal.experiments.study.readings import ReadingFit

        return ReadingFit

    def subject(self, task: Task, factor: float = 1.0) -> ReadingSubject:
        """Return the posterior of a variant to be fitted."""
        from bayescal.experiments.study.readings import ReadingSubject

        return ReadingSubject(self.variants[task.variant].posterior(factor=factor).anchored())

    def fit(self, task: Task) -> ReadingFit:
        """Return all that is found of a variant."""
        from bayescal.experiments.study.readings import fit_variant

        return fit_variant(self, task.variant)

    def describe(self, fits: Mapping[Task, Fit], run: Run) -> Described:
        """Return variants, parameters, residuals, predictions, accuracy of the tool and where to measure next."""
        from bayescal.experiments.study.readings import describe_readings

        return describe_readings(self, fits, run)

    def estimate_memory(self) -> Need:
        """Return what the largest variant's posterior takes, and all that is saved of each."""
        return estimate_calibration(self)

    def outlook(self) -> list[str]:
        """Return what each variant's readings can determine, and in lines what is not used or not there."""
        stated = all(one.model.states_tool for one in self.variants.values())
        said = join_outlooks({name: one.tell_outlook() for name, one in self.variants.items()})
        return [*said, *filter(None, (self.unused, self.missing, "" if stated else NO_TOOL))]

    def find_slip(self) -> FoundSlip | None:
        """Return what may have happened to readings that no machine within its priors comes near."""
        return find_slip(one.list_readings() for one in self.variants.values())

    def measure(self, names: Sequence[str], path: Path, with_model_error: bool) -> dict[str, MeasuredReadings]:
        """Return the posteriors of the calibration poses."""
        del path, with_model_error
        origin, chosen = name_origin(self.config.origin.model_dump()), {name: self.variants[name] for name in names}
        return {
            name: MeasuredReadings(
                name,
                origin,
                one.posterior(),
                one.workspace.low,
                one.workspace.high,
                one.internal,
                n_held_back=int(one.verification.sum()),
            )
            for name, one in chosen.items()
        }
