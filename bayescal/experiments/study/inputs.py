"""A study's config, data and posteriors, and what it is asked before and while it is computed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayescal.config.registry import find_class
from bayescal.errors import name_faults
from bayescal.experiments.shared.knowledge_page import NO_TOOL, TOOL_ACTION
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.experiments.shared.misstated import find_misstated
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.outlook import join_outlooks
from bayescal.experiments.shared.readings.errors import drop_model_error
from bayescal.experiments.shared.readings.inputs import ReadingInputs, read_inputs
from bayescal.experiments.shared.readings.priors import check_ranges
from bayescal.experiments.shared.requirements import read_requirements
from bayescal.experiments.shared.slip_search import find_slip, find_suspects
from bayescal.experiments.shared.slip_verdict import Rival
from bayescal.experiments.shared.slips import FoundSlip, MisstatedInput
from bayescal.experiments.shared.study_schema import StudyConfig

if TYPE_CHECKING:
    from bayescal.experiments.study.claims import Claims

TRIED = 3  # variants of which some densities are timed
PAGE, ROW = 4.0, 2e-3  # s, of tables and a page, and for each row
WIDTHS = 0.15  # of a fit's time, for each factor on the widths of priors


@dataclass(frozen=True, eq=False)
class StudyInputs(ReadingInputs):
    """Readings and variants, as a study is asked for them."""

    folder: Path = Path()

    @classmethod
    def load(cls, config: StudyConfig, folder: Path, only: Collection[str] | None = None) -> StudyInputs:
        """Return machine, readings and variants, or some of these.

        Raises
        ------
        InputError
            For faults of files, and other widths of priors that no machine has.
        """
        found = cls(**vars(read_inputs(config, folder, only)), folder=folder)
        for name, variant in found.variants.items():
            for factor in config.sensitivity.prior_width_factors:
                with name_faults(f"variant {name!r}: sensitivity.prior_width_factors {factor:g}"):
                    wide = variant.posterior(factor=factor).priors
                    check_ranges(wide, variant.model.layout, variant.common)
        return found

    @property
    def verification(self) -> np.ndarray:
        """Which rows are kept for verification, of the variant that takes in most."""
        return max((one.verification for one in self.variants.values()), key=len)

    @cached_property
    def claims(self) -> Claims | None:
        """What a publication claims of the study; InputError for a class that is none, or wants what is not there."""
        if self.config.published_claims is None:
            return None
        from bayescal.experiments.study.claims import Claims

        kind = Claims
        found = find_class("CLAIMS", self.config.published_claims, kind, "published_claims", None, self.folder)()  # type: ignore[type-abstract]
        found.check(self)
        return found

    def estimate_seconds(self) -> float:
        """Return about how long posteriors and page take on one core, s."""
        from bayescal.experiments.shared.estimate import time_fit
        from bayescal.experiments.study.readings import ReadingSubject

        config, every = self.config, list(self.variants.values())
        some = every[:: -(-len(every) // TRIED)]  # what one takes tells about what others take
        posteriors = [one.posterior().with_pose_guesses() for one in some]
        widths = 1.0 + WIDTHS * sum(factor != 1.0 for factor in config.sensitivity.prior_width_factors)
        each = [widths * time_fit(ReadingSubject(one), config.sampler, config.evidence) for one in posteriors]
        return PAGE + ROW * len(self.verification) + sum(each) * len(every) / len(some)

    def outlook(self) -> list[str]:
        """Return what each variant's readings can determine, and in lines what is not used or not there."""
        stated = all(one.model.states_tool for one in self.variants.values())
        said = join_outlooks({name: one.describe_determinacy() for name, one in self.variants.items()})
        return [
            *said,
            *filter(None, (self.found, self.unused, self.missing, "" if stated else f"{NO_TOOL} {TOOL_ACTION}")),
        ]

    @cached_property
    def slip(self) -> FoundSlip | None:
        """What may have happened to readings that no machine within its priors comes near, looked for once."""
        return self._suspects[0]

    @cached_property
    def denied(self) -> FoundSlip | None:
        """The slip that the data look like and the config denies; None where they look like none."""
        denied = self.config.ignored_data_errors
        found = find_slip(one.list_readings() for one in self.variants.values()) if denied else None
        return found if found is not None and found.fault in denied else None

    @cached_property
    def _suspects(self) -> tuple[FoundSlip | None, list[Rival]]:
        return find_suspects((one.list_readings() for one in self.variants.values()), self.config.ignored_data_errors)

    @cached_property
    def misstated(self) -> MisstatedInput | None:
        """What is stated wrong or needs large errors, looked for once; None where the data themselves are suspected."""
        return self.find_misstated(list(self.variants))

    def find_misstated(self, names: Sequence[str]) -> MisstatedInput | None:
        """Return the same by some variants."""
        if self.slip is not None:
            return None
        config, model = self.config, self.variants[names[0]].model
        required = read_requirements(config.requirements, model, config.units)
        return find_misstated([self.variants[name].list_readings() for name in names], required, self._suspects[1])

    def measure(self, names: Sequence[str], with_model_error: bool = True) -> dict[str, MeasuredReadings]:
        """Return the posteriors of variants' calibration poses, without terms of [model_error] where not wanted."""
        origin, chosen = name_origin(self.config.provenance.model_dump()), {name: self.variants[name] for name in names}
        return {
            name: MeasuredReadings(
                name,
                origin,
                one.posterior() if with_model_error else drop_model_error(one.posterior()),
                one.region.low,
                one.region.high,
                one.internal,
                int(one.verification.sum()),
                self.described,
                one.aligned,
                tuple(self.config.ignored_data_errors),
            )
            for name, one in chosen.items()
        }
