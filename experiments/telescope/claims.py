"""What RR-8096 claims in its sections 2 to 8, tested on the study's own machine, poses and posteriors.

A claim is a function of a `ClaimEvidence` that yields none, one or several rows; a new one is added to its module's
tuple. A study whose mechanism or variants say nothing of a claim leaves it out; one of struts, which the report has
not, all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import pandas as pd

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.study.claims import Claims
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.rows import ClaimRow
from rr8096 import accuracy, geometry, identifiability, identification
from rr8096.evidence import FAILS, HOLDS, UNTESTABLE, ClaimEvidence, ClaimRows, untestable
from rr8096.identified import identify_variants, read_tables, tabulate_least_squares
from rr8096.published import LETTERS, NUMBERS

CLAIMS: tuple[Callable[[ClaimEvidence], ClaimRows], ...] = (
    *geometry.CLAIMS,
    *identifiability.CLAIMS,
    *identification.CLAIMS,
    *accuracy.CLAIMS,
    *identification.FINDINGS,
)

__all__ = ["CLAIMS", "FAILS", "HOLDS", "UNTESTABLE", "ClaimEvidence", "ClaimRow", "judge_claims", "tabulate_claims"]


def judge_claims(evidence: ClaimEvidence) -> list[ClaimRow]:
    """Return all claims that the study allows, in the order of the report's sections, own findings last."""
    if evidence.mechanism.drive == "strut":
        return []
    found: list[ClaimRow] = []
    for function in CLAIMS:
        try:
            found += function(evidence)
        except (NumericalError, ArithmeticError, ValueError) as error:  # one claim is not worth a whole run
            what = (function.__doc__ or "").splitlines()[0]
            found.append(untestable(function.__name__, "", what, "", f"the computation failed: {error}"))
    return sorted(found, key=lambda claim: _section_order(claim.section))


def _section_order(section: str) -> tuple[bool, list[int]]:
    numbers = section.split(",")[0].split(".")
    known = all(number.isdigit() for number in numbers)
    return not known, [int(number) for number in numbers] if known else []


class Rr8096(Claims):
    """RR-8096 on the active space telescope: its claims, and where its figures and symbols stand."""

    source = "RR-8096"
    citation = "Equations and sections are those of the INRIA research report RR-8096 (Gayral and Daney, 2012)."
    figures = MappingProxyType(
        {
            "errors_all": "figures 15 to 17",
            "errors_none": "figure 15",
            "errors_linear": "figure 16",
            "errors_matrix": "figure 17",
            "hardpoints": "figure 18",
            "deflections": "figure 7",
            "flexure": "figure 9, circle: eq. 13",
        }
    )
    notation = MappingProxyType(
        {
            "a": "section 2.2",
            "b": "section 2.2",
            "u": "eq. 5",
            "l": "eqs. 5, 7, 30",
            "rho": "eqs. 5, 7",
            "rho0": "eq. 9",
            "kappa": "eq. 1",
            "K": "eqs. 2 to 4",
        }
    )

    tables = MappingProxyType(
        {
            f"{model}/{deformation}": f"table {number}({letter})"
            for model, letter in LETTERS.items()
            for deformation, number in NUMBERS.items()
        }
    )

    def check(self, inputs: StudyInputs) -> None:
        """Refuse a study without targets, and printed tables that cannot be read."""
        if inputs.pads is None:
            found = inputs.config.published_claims
            raise InputError(f"{inputs.folder}: claims: found {found!r} without targets, expected measured targets")
        read_tables(inputs)

    def tabulate(self, inputs: StudyInputs, summary: Mapping[str, Any]) -> dict[str, pd.DataFrame]:
        """Return a row for each claim that the study allows, and least squares beside the report's tables."""
        fits = identify_variants(inputs)
        return {
            "claims": tabulate_claims(ClaimEvidence.from_study(inputs, summary, fits)),
            "least_squares": tabulate_least_squares(inputs, fits),
        }


def tabulate_claims(evidence: ClaimEvidence) -> pd.DataFrame:
    """Return one row per claim."""
    return ClaimRow.collect(judge_claims(evidence))
