"""What studies of any readings show besides: sensors' errors, accuracy, held-back readings, other values."""

from __future__ import annotations

import math
from functools import partial

from bayescal.experiments.frame.results import Row
from bayescal.experiments.shared import function_page, knowledge_page
from bayescal.experiments.study.page.figures.readings import draw_predictions
from bayescal.experiments.study.page.results import NOISE, StudyResults, get_number
from bayescal.experiments.study.page.variants import VARIANT, label_variant
from bayescal.report.blocks import Block, Cell, Column, Figure, Section, Statement, make_table
from bayescal.report.numbers import (
    NOTHING,
    format_estimate,
    format_fixed,
    format_percent,
    format_significant,
    join_words,
)

COVERAGE, FAR = 0.90, 2.5  # what intervals should hold, and binomial deviations from it that are no chance
MANY = 8
FEW = 40  # held-back readings, from which little can be said of coverage


# --- errors of sensors, accuracy, next poses -------------------------------------------------------------------------


def show_functions(study: StudyResults) -> Section | None:
    """Return errors of sensors that are functions; None where no variant has any."""
    return next(iter(function_page.show_functions(study.tables)), None)


def state_functions(study: StudyResults) -> list[Statement]:
    """Say which sensors have such errors."""
    return function_page.judge_functions(study.tables)


def show_accuracy(study: StudyResults) -> Section | None:
    """Return how accurate the tool is; None where that was not computed."""
    return knowledge_page.show_accuracy(study.tables, study.units)


def show_undetermined(study: StudyResults) -> Section | None:
    """Return the combinations that the data leave undetermined."""
    return next(iter(knowledge_page.show_ridges(study.tables, study.chosen)), None)


def show_next(study: StudyResults) -> Section | None:
    """Return the candidate poses that reduce the error most."""
    return next(iter(knowledge_page.show_next(study.tables, study.chosen, study.units)), None)


def state_next(study: StudyResults) -> list[Statement]:
    """Say which pose to measure next."""
    return knowledge_page.state_next(study.tables, study.chosen, study.units)


# --- what the data are -----------------------------------------------------------------------------------------------


def state_data(study: StudyResults) -> list[Statement]:
    """Say that there is no tool, which readings are not used, that they are few, and how noise was found."""
    found = [] if study.summary.get("states_tool", True) else [Statement(knowledge_page.NO_TOOL, "warning", "Tool")]
    if "unused" in study.summary:
        found.append(Statement(study.summary["unused"], "warning", "Data"))
    fit = study.fit(study.chosen)
    if get_number(fit, "n_equations") < fit["n_parameters"]:
        text = f"{fit['n_equations']} equations for {fit['n_parameters']} unknowns: what the readings do not determine"
        found.append(Statement(f"{text} rests on the stated tolerances.", "warning", "Data"))
    for row in study.rows("parameters", study.chosen):
        kind, _, what = str(row["parameter"]).rstrip(")").partition("(")
        factor, unit = study.shown_in(row["unit"])
        amount = format_estimate(factor * row["mean"], factor * row["sd"])
        if kind == "noise_factor":
            found.append(Statement(f"The noise of {what} is {amount} times the stated one (± 1 sd).", lead="Noise"))
        elif kind == "model_error":
            text = f"Beyond its noise, {what} errs by {amount} {unit} (± 1 sd)."
            found.append(Statement(text, lead="Model error"))
    return found


def state_undetermined(study: StudyResults) -> list[Statement]:
    """Say of which parameters the data do not halve the uncertainty."""
    if study.has("pose_errors"):
        return []
    rows = [row for row in study.rows("parameters", study.chosen) if row["verdict"] != NOISE]
    weak = [str(row["parameter"]) for row in rows if row["verdict"] != "identifiable"]
    if not weak:
        return [Statement("The uncertainty of every free parameter is at least halved.", "good", "Parameters")]
    words = join_words(weak[:MANY] + ([f"{len(weak) - MANY} more"] if len(weak) > MANY else []))
    it = "it is" if len(weak) == 1 else "they are"
    text = f"{words}: uncertainty not halved; {it} poorly determined by these data."
    return [Statement(text, "warning", "Parameters")]


# --- held-back readings ----------------------------------------------------------------------------------------------


def state_held_back(study: StudyResults) -> list[Statement]:
    """Say how many held-back readings of the machine's own sensors lie in their 90 % intervals."""
    mine = study.table("predictions", study.chosen)
    mine = mine[~mine["external"].astype(bool)] if len(mine) else mine
    if mine.empty:
        return []
    share, n, lead = float(mine["inside"].mean()), len(mine), "Prediction"
    words = (
        f"{int(mine['inside'].sum())} of {n} held-back readings of the machine's own sensors ({format_percent(share)}) "
        "lie in their 90 % intervals"
    )
    if abs(share - COVERAGE) <= FAR * math.sqrt(COVERAGE * (1.0 - COVERAGE) / n):
        return [Statement(f"{words}, as expected{'' if n >= FEW else '; small sample'}.", "good", lead)]
    tendency = "too small" if share < COVERAGE else "too large"
    return [Statement(f"{words}: the stated uncertainty is {tendency}.", "warning", lead)]


def show_held_back(study: StudyResults) -> Section | None:
    """Return how held-back readings compare with their predictions; None without any."""
    if not study.has("predictions"):
        return None
    table = study.table("predictions")
    table = table.assign(kind=table["channel"].str.partition("[")[0])
    kinds = list(dict.fromkeys(str(kind) for kind in table["kind"]))
    columns = [VARIANT, *(Column(kind, group="in their 90 % intervals") for kind in kinds)]
    rows: list[list[str | Cell]] = []
    for name in study.names:
        mine = table[table["variant"] == name]
        counts = [mine[mine["kind"] == kind]["inside"] for kind in kinds]
        cells = [f"{int(one.sum())} of {len(one)}" if len(one) else NOTHING for one in counts]
        rows.append([label_variant(study, name), *cells])
    text = (
        "Each reading of a held-back pose, predicted from the other readings there and from a calibration that has not "
        "seen the pose."
    )
    blocks: list[Block] = [text, make_table("Coverage.", columns, rows)]
    mine = table[table["variant"] == study.chosen]
    if len(mine):
        caption = f"Held-back readings, {label_variant(study, study.chosen)}."
        blocks.append(Figure("predictions", caption, partial(draw_predictions, mine)))
    return Section("Held-back readings", tuple(blocks), anchor="held-back")


# --- values of others ------------------------------------------------------------------------------------------------


def state_comparison(study: StudyResults) -> list[Statement]:
    """Say how values of others, which stay out of the fit, compare with the posterior."""
    found, mine = [], study.table("beside", study.chosen)
    for title, _ in mine.groupby("beside", sort=False):
        rows = [row for row in study.rows("beside", study.chosen) if row["beside"] == title]
        away = [abs(_measure_distance(row)) for row in rows]
        worst = rows[max(range(len(rows)), key=lambda k: away[k])]
        factor, unit = study.shown_in(str(worst["unit"]))
        text = (
            f"{title}: {sum(z <= 2.0 for z in away)} of {len(rows)} values within two standard deviations; farthest "
            f"{worst['quantity']}, {format_fixed(factor * worst['value'], 2)} {unit} against "
            f"{format_estimate(factor * worst['mean'], factor * worst['sd'])} {unit} (± 1 sd)."
        )
        found.append(Statement(text, lead="Comparison"))
    return found


def show_comparison(study: StudyResults) -> Section | None:
    """Return the values of others with the posterior; None without any."""
    mine = study.table("beside", study.chosen)
    if mine.empty:
        return None
    columns = [Column("Quantity", kind="text"), Column("Unit", kind="text"), Column("calibrated"), Column("other")]
    columns += [Column("Difference"), Column("in standard deviations")]
    blocks: list[Block] = []
    for title, _ in mine.groupby("beside", sort=False):
        rows = [row for row in study.rows("beside", study.chosen) if row["beside"] == title]
        source = f" ({rows[0]['source']})" if rows[0]["source"] else ""
        lines = [_list_comparison(study, row) for row in rows]
        blocks.append(make_table(f"{title}{source}. These values stay out of the fit.", columns, lines))
    return Section("Comparison with other values", tuple(blocks), anchor="comparison", short="Comparison")


def _measure_distance(row: Row) -> float:
    """Return how far a value lies from the posterior mean, in standard deviations of both; 0 where neither has any."""
    value_sd = row["value_sd"] if row["value_sd"] == row["value_sd"] else 0.0
    spread = math.hypot(row["sd"], value_sd)
    return float((row["value"] - row["mean"]) / spread) if spread > 0.0 else 0.0


def _list_comparison(study: StudyResults, row: Row) -> list[str | Cell]:
    factor, unit = study.shown_in(row["unit"])
    return [
        str(row["quantity"]),
        unit,
        format_estimate(factor * row["mean"], factor * row["sd"]),
        format_significant(factor * row["value"], 6),
        format_significant(factor * (row["value"] - row["mean"])),
        format_fixed(_measure_distance(row), 1, sign=True),
    ]
