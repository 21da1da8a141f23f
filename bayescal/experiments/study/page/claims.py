"""What a publication states, and whether this study bears it out."""

from __future__ import annotations

import re
from dataclasses import replace

import pandas as pd

from bayescal.experiments.study.page.results import VERDICTS, StudyResults
from bayescal.report.blocks import Cell, Column, Counts, Level, Section, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_significant, join_words

LEVELS: dict[str, Level] = dict(zip(VERDICTS, ("good", "bad", "plain"), strict=True))
PLURAL = {"holds": "hold", "does not hold": "do not hold", "not testable": "are not testable"}
OWN = "own"  # section of findings that the publication does not state
EXPLANATION = (
    "A claim opens to say how it was tested and what its verdict depends on. “Not testable”: these data cannot decide."
)


def list_counts(results: StudyResults) -> list[tuple[str, tuple[Cell, ...]]]:
    """Return how many claims have each verdict, as marks: those of the publication, and findings of the project."""
    if not results.has("claims"):
        return []
    claims = results.table("claims")
    own = claims["section"] == OWN
    counted = [("Stated by the publication", claims[~own]), ("Found beyond it", claims[own])]
    return [(title, tuple(_count(rows))) for title, rows in counted if len(rows)]


def _count(claims: pd.DataFrame) -> list[Cell]:
    counts = {verdict: int((claims["verdict"] == verdict).sum()) for verdict in LEVELS}
    return [
        Cell(f"{n} {verdict if n == 1 else PLURAL[verdict]}", LEVELS[verdict], badge=True)
        for verdict, n in counts.items()
        if n
    ]


def state_claims(results: StudyResults) -> list[Statement]:
    """Say in one sentence how the publication's claims fared."""
    if not results.has("claims"):
        return []
    claims = results.table("claims")[results.table("claims")["section"] != OWN]
    if claims.empty:
        return []
    counts = join_words([cell.text for cell in _count(claims)])
    words = f"{len(claims)} {'claim' if len(claims) == 1 else 'claims'}"
    return [Statement(f"Of {words} of the publication, {counts}.", lead="Publication")]


def show_claims(results: StudyResults) -> Section | None:
    """Return the section of the claims, counted and one by one; None where the study tests none."""
    if not results.has("claims") or results.publication is None:
        return None
    counts = (Counts(title, marks) for title, marks in list_counts(results))
    return Section(
        f"Claims of {results.publication.source}",
        (*counts, EXPLANATION, tabulate_claims(results.table("claims"))),
        anchor="claims",
        short="Claims",
    )


def tabulate_claims(claims: pd.DataFrame) -> Table:
    """Return the claims by the publication's sections in their order; other findings come last."""
    columns = [Column(title, kind="text") for title in ("Verdict", "Claim", "Expected", "Found")]
    rows: list[list[str | Cell]] = []
    headings = {}
    for section in sorted(dict.fromkeys(claims["section"]), key=_order):
        headings[len(rows)] = _title(section)
        rows += [_row(claim) for _, claim in claims[claims["section"] == section].iterrows()]
    return replace(make_table("Claims and findings.", columns, rows, style="claims"), headings=headings)


def _order(section: str) -> tuple[bool, list[int], str]:
    return not section[:1].isdigit(), [int(number) for number in re.findall(r"\d+", section)], section


def _title(section: str) -> str:
    if section == OWN:
        return "Beyond the publication: findings of this project"
    if not section[:1].isdigit():
        return section or "Without section"
    return f"{'Sections' if ',' in section else 'Section'} {section}"


def _row(claim: pd.Series) -> list[str | Cell]:
    found = claim["found"]
    if not found and claim["value"] == claim["value"]:  # NaN where there is no number
        found = f"{format_significant(float(claim['value']))} {'' if claim['unit'] == '1' else claim['unit']}".strip()
    return [
        Cell(claim["verdict"], LEVELS[claim["verdict"]], badge=True),
        Cell(claim["statement"], more=f"{claim['why']} ({claim['claim']})".strip()),
        claim["expected"] or NOTHING,
        found or NOTHING,
    ]
