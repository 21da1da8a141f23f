"""What a claim is: a statement of the source, what was found instead, and the verdict."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

HOLDS = "holds"
FAILS = "does not hold"
UNTESTABLE = "not testable"


@dataclass(frozen=True)
class Claim:
    """One statement and what the study's own numbers say of it.

    Attributes
    ----------
    claim : str
        A short name.
    section : str
        Where RR-8096 says it, or "own" for a finding of this project.
    statement, expected, found : str
        The statement in own words, the number it gives and the number that came out, with units.
    value : float
        The number behind ``found``; NaN where there is none.
    unit : str
    verdict : str
        ``holds``, ``does not hold`` or ``not testable``.
    why : str
        How it was tested, and what the verdict depends on.
    """

    claim: str
    section: str
    statement: str
    expected: str
    found: str
    value: float
    unit: str
    verdict: str
    why: str


type ClaimRows = Iterator[Claim]


def judge(holds: object) -> str:
    """Return the verdict of a test."""
    return HOLDS if holds else FAILS


def untestable(claim: str, section: str, statement: str, expected: str, why: str) -> Claim:
    """Return a claim that the data cannot judge."""
    return Claim(claim, section, statement, expected, "", float("nan"), "", UNTESTABLE, why)
