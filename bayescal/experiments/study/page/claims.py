"""What the publication states, and whether this study bears it out."""

from __future__ import annotations

import re

import pandas as pd

from bayescal.experiments.study.page.results import VERDICTS, Results
from bayescal.report.blocks import Cell, Column, Level, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_significant, join_words

LEVELS: dict[str, Level] = dict(zip(VERDICTS, ("good", "bad", "plain"), strict=True))
PLURAL = {"holds": "hold", "does not hold": "do not hold", "not testable": "are not testable"}
OWN = "own"  # section of findings that the publication does not state
TEXTS = ("section", "statement", "expected", "found", "unit", "why")


def list_counts(results: Results) -> list[tuple[str, tuple[Cell, ...]]]:
    """Return how many claims have each verdict, as marks: those of the publication, and findings of the project."""
    if results.claims is None:
        return []
    own = results.claims["section"] == OWN
    counted = [("Stated by the publication", results.claims[~own]), ("Found beyond it", results.claims[own])]
    return [(title, tuple(_count(rows))) for title, rows in counted if len(rows)]


def _count(claims: pd.DataFrame) -> list[Cell]:
    counts = {verdict: int((claims["verdict"] == verdict).sum()) for verdict in VERDICTS}
    return [
        Cell(f"{n} {verdict if n == 1 else PLURAL[verdict]}", LEVELS[verdict], badge=True)
        for verdict, n in counts.items()
        if n
    ]


def state_claims(results: Results) -> list[Statement]:
    """Say in one sentence how the publication's claims fared."""
    if results.claims is None:
        return []
    claims = results.claims[results.claims["section"] != OWN]
    if claims.empty:
        return []
    counts = join_words([cell.text for cell in _count(claims)])
    words = f"{len(claims)} {'claim' if len(claims) == 1 else 'claims'}"
    return [Statement(f"Of {words} of the publication, {counts}.", lead="Publication")]


def tabulate_claims(results: Results) -> list[Table]:
    """Return a table of claims for every section of the publication, in their order; other findings come last."""
    if results.claims is None:
        return []
    columns = [Column(title, kind="text") for title in ("Verdict", "Claim", "Expected", "Found")]
    frame = results.claims.fillna(dict.fromkeys(TEXTS, ""))
    sections = sorted(dict.fromkeys(frame["section"]), key=_order)
    return [
        make_table(
            _title(section), columns, [_row(claim) for _, claim in frame[frame["section"] == section].iterrows()]
        )
        for section in sections
    ]


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
