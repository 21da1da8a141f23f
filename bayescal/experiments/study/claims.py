"""What a publication says of a study: its claims are tested, and the page refers to its figures and symbols.

A user-defined class supplies these; the study's config attaches it: ``published_claims = "file.py:Class"``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

import pandas as pd

from bayescal.experiments.runner.results import Summary
from bayescal.experiments.study.inputs import StudyInputs


class Claims(ABC):
    """A publication's claims on a study.

    Attributes
    ----------
    source : str
        What the page calls the publication.
    citation : str
        A sentence by which it is found.
    figures : mapping of str to str
        By the names of the page's figures, what each is after.
    notation : mapping of str to str
        By symbol, where it is defined.
    tables : mapping of str to str
        By variant, where its printed values are; none by default.
    """

    source: ClassVar[str]
    citation: ClassVar[str]
    figures: ClassVar[Mapping[str, str]]
    notation: ClassVar[Mapping[str, str]]
    tables: ClassVar[Mapping[str, str]] = MappingProxyType({})

    def check(self, inputs: StudyInputs) -> None:  # noqa: B027
        """Raise InputError where a study lacks what the claims are put to, before anything is computed."""

    @abstractmethod
    def tabulate(self, inputs: StudyInputs, summary: Summary) -> dict[str, pd.DataFrame]:
        """Return tables for the study's results, by name: ``claims`` has a row for each claim that the study allows.

        Its rows are `ClaimRow`. Where values are printed, ``least_squares`` has a `PublishedParameterRow` for each
        parameter and leg.
        """

    def describe(self) -> Summary:
        """Return what the page needs, JSON-ready."""
        return {
            "source": self.source,
            "citation": self.citation,
            "figures": dict(self.figures),
            "notation": dict(self.notation),
            "tables": dict(self.tables),
        }
