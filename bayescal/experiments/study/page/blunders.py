"""Poses that are blunders more likely than not: said in the verdict, with all that may be in a table."""

from __future__ import annotations

from bayescal.experiments.study.page.results import StudyResults
from bayescal.limits import BLUNDER
from bayescal.report.blocks import Cell, Column, Section, Statement, make_table
from bayescal.report.numbers import format_fixed, format_percent, join_words

SHOWN = 10
EXPLAINED = (
    "Each pose may be a blunder: it has nothing to do with where the machine stood, because it was named wrongly, the "
    "machine had not settled or something was in the way. What is a blunder counts for nothing in the posterior. The "
    "probability is that of the best variant."
)


def _read(results: StudyResults) -> list[tuple[str, str, float]]:
    """Return pose, use and probability of the best variant, the most doubtful pose first; none where none may be."""
    table = results.blunders
    if table is None:
        return []
    mine = table[(table["variant"] == results.ranking[0]) & (table["model_error"] == "free")]
    rows = zip(mine["pose"].astype(str), mine["use"].astype(str), mine["probability"].astype(float), strict=True)
    return sorted(rows, key=lambda row: -row[2])


def state_blunders(results: StudyResults) -> list[Statement]:
    """Say which poses are blunders, or that none is."""
    mine = _read(results)
    if not mine:
        return []
    bad = [f"{pose} ({format_percent(p)})" for pose, _, p in mine if p > BLUNDER]
    if not bad:
        worst = f"the most doubtful is {mine[0][0]}, with {format_percent(mine[0][2])}"
        return [Statement(f"No pose is a blunder more likely than not; {worst}.", lead="Blunders", level="good")]
    words, rest = ("pose is a blunder", "it counts") if len(bad) == 1 else ("poses are blunders", "they count")
    text = f"Measure again or leave out: {len(bad)} of {len(mine)} {words}, {join_words(bad)}; {rest} for nothing here."
    return [Statement(text, lead="Blunders", level="warning")]


def show_blunders(results: StudyResults) -> Section | None:
    """Return the most doubtful poses; None where none may be a blunder."""
    mine = _read(results)
    if not mine:
        return None
    columns = [Column("Pose", kind="text"), Column("Use", kind="text"), Column("P(blunder)", "%")]
    rows: list[list[str | Cell]] = [
        [pose, use, Cell(format_fixed(100 * p, 1), "bad" if p > BLUNDER else "plain")] for pose, use, p in mine[:SHOWN]
    ]
    caption = f"The {len(rows)} most doubtful poses of {len(mine)}."
    return Section("Blunders", (EXPLAINED, make_table(caption, columns, rows)), anchor="blunders")
