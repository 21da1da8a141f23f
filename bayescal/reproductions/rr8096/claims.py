"""What RR-8096 claims in its sections 2 to 8, tested on the study's own machine, poses and posteriors.

A claim is a function of a `Subject` that yields none, one or several rows; a new one is added to its module's tuple. A
study whose mechanism or variants say nothing of a claim leaves it out; one of struts, which the report has not, all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

import pandas as pd

from bayescal.errors import NumericalError
from bayescal.reproductions.rr8096 import accuracy, geometry, identifiability, identification, tables
from bayescal.reproductions.rr8096.claim import FAILS, HOLDS, UNTESTABLE, Claim, Claims, untestable
from bayescal.reproductions.rr8096.evidence import Subject

CLAIMS: tuple[Callable[[Subject], Claims], ...] = (
    *geometry.CLAIMS,
    *identifiability.CLAIMS,
    *identification.CLAIMS,
    *accuracy.CLAIMS,
    *tables.CLAIMS,
)

__all__ = ["CLAIMS", "FAILS", "HOLDS", "UNTESTABLE", "Claim", "Subject", "judge_claims", "tabulate_claims"]


def judge_claims(subject: Subject) -> list[Claim]:
    """Return all claims that the study allows, in the order of the report's sections, own findings last."""
    if subject.mechanism.drive == "strut":
        return []
    found: list[Claim] = []
    for function in CLAIMS:
        try:
            found += function(subject)
        except (NumericalError, ArithmeticError, ValueError) as error:  # one claim is not worth a whole run
            what = (function.__doc__ or "").splitlines()[0]
            found.append(untestable(function.__name__, "", what, "", f"the computation failed: {error}"))
    return sorted(found, key=lambda claim: _section_order(claim.section))


def _section_order(section: str) -> tuple[bool, list[int]]:
    numbers = section.split(",")[0].split(".")
    known = all(number.isdigit() for number in numbers)
    return not known, [int(number) for number in numbers] if known else []


def tabulate_claims(subject: Subject) -> pd.DataFrame:
    """Return one row per claim."""
    return pd.DataFrame([asdict(claim) for claim in judge_claims(subject)])
