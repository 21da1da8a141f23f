"""What a publication says of a study: its claims are tested, and the page refers to its figures and symbols.

A class of one's own supplies these; the study's config attaches it: ``claims = "file.py:Class"``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import pandas as pd

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
    """

    source: ClassVar[str]
    citation: ClassVar[str]
    figures: ClassVar[Mapping[str, str]]
    notation: ClassVar[Mapping[str, str]]

    @abstractmethod
    def tabulate(self, inputs: StudyInputs, summary: Mapping[str, Any]) -> dict[str, pd.DataFrame]:
        """Return tables for the study's results, by name: ``claims`` has a row for each claim that the study allows.

        Its columns are ``claim``, ``section``, ``statement``, ``expected``, ``found``, ``value``, ``unit``, ``verdict``
        (holds, does not hold, not testable) and ``why``.
        """

    def describe(self) -> dict[str, Any]:
        """Return what the page needs, JSON-ready."""
        return {
            "source": self.source,
            "citation": self.citation,
            "figures": dict(self.figures),
            "notation": dict(self.notation),
        }
