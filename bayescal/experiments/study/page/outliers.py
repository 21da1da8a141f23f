"""Poses that the others contradict: outliers where a variant allows them, residuals too large where it does not."""

from __future__ import annotations

import math
from functools import partial

from bayescal.experiments.frame.results import Row
from bayescal.experiments.study.page.figures.readings import draw_poses
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.variants import label_variant
from bayescal.limits import BLUNDER
from bayescal.report.blocks import Block, Cell, Column, Figure, Level, Section, Statement, make_table
from bayescal.report.numbers import format_fixed, format_percent, format_significant, join_words

SHOWN = 10
MANY = 8
OUTLIERS = (
    "Each pose may be an outlier: it has nothing to do with where the machine was, because it was named wrongly, the "
    "machine had not settled or something was in the way. An outlier counts for nothing in the posterior. The "
    "probability is that of the best variant."
)


def _read(study: StudyResults) -> list[Row]:
    """Return the rows of the best variant's poses, the most improbable first."""
    rows = [row for row in study.rows("poses", study.best_name) if row["model_error"] == "free"]
    if "outlier_probability" in study.table("poses"):
        return sorted(rows, key=lambda row: -row["outlier_probability"])
    if "square" in study.table("poses"):
        return sorted((row for row in rows if row["contradicting"]), key=lambda row: row["trust"])
    return []


def state_outliers(study: StudyResults) -> list[Statement]:
    """Say which poses the others contradict, or that none is an outlier."""
    rows, lead = _read(study), "Outliers"
    if not rows:
        return []
    if "outlier_probability" not in rows[0]:
        names = [str(row["pose"]) for row in rows]
        words = join_words(names[:MANY] + ([f"{len(names) - MANY} more"] if len(names) > MANY else []))
        verb = "pose disagrees" if len(names) == 1 else "poses disagree"
        return [Statement(f"Check the readings of {words}: {len(names)} {verb} with the others.", "warning", lead)]
    bad = [
        f"{row['pose']} ({format_percent(row['outlier_probability'])})"
        for row in rows
        if row["outlier_probability"] > BLUNDER
    ]
    if not bad:
        most = f"the most probable is {rows[0]['pose']}, with {format_percent(rows[0]['outlier_probability'])}"
        return [Statement(f"No pose is probably an outlier; {most}.", "good", lead)]
    verb, rest = ("pose is an outlier", "it counts") if len(bad) == 1 else ("poses are outliers", "they count")
    text = f"Measure again or leave out: {len(bad)} of {len(rows)} {verb}, {join_words(bad)}; {rest} for nothing here."
    return [Statement(text, "warning", lead)]


def show_outliers(study: StudyResults) -> Section | None:
    """Return the residuals of the poses, and those that the others contradict; None where nothing says which."""
    rows, blocks = _read(study), list[Block]()
    if "square" in study.table("poses"):
        mine = study.table("poses", study.best_name)
        caption = f"Residuals of {label_variant(study, study.best_name)} at each pose, in units of their noise."
        blocks.append(Figure("poses", caption, partial(draw_poses, mine)))
        columns = [Column("Pose", kind="text"), Column("Equations"), Column("Residual / noise"), Column("Weight")]
        cells: list[list[str | Cell]] = [
            [
                str(row["pose"]),
                str(row["equations"]),
                format_significant(math.sqrt(row["square"] / max(1, row["equations"])), 2),
                format_fixed(row["trust"], 2),
            ]
            for row in rows
        ]
        none = "No pose contradicts the others."
        blocks.append(make_table("Poses that the others contradict.", columns, cells) if rows else none)
    elif rows:
        columns = [Column("Pose", kind="text"), Column("Use", kind="text"), Column("P(outlier)", "%")]
        cells = []
        for row in rows[:SHOWN]:
            p = row["outlier_probability"]
            level: Level = "bad" if p > BLUNDER else "plain"
            cells.append([str(row["pose"]), str(row["use"]), Cell(format_fixed(100 * p, 1), level)])
        caption = f"The {len(cells)} most probable outliers of {len(rows)} poses."
        blocks += [OUTLIERS, make_table(caption, columns, cells)]
    return Section("Poses", tuple(blocks), anchor="outliers") if blocks else None
