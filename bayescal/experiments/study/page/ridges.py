"""Ridges of the posteriors: which parameters the measurements cannot tell apart."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bayescal.experiments.study.page.figures.ridges import draw_ridges
from bayescal.experiments.study.page.results import FRAME, NOISE, StudyResults
from bayescal.experiments.study.page.variants import VARIANT, label_variant
from bayescal.report.blocks import Block, Column, Figure, Fold, Section, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_fixed, join_words
from bayescal.report.symbols import MODEL_ERROR, name_parameter, split_name, write_symbol

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array

SHOWN_PAIRS = 3
NO_PAIRS = "Correlations within a leg."
KEPT, LOST = 0.5, 0.01  # share of the prior variance of a combination that is hardly, or well, measured


def show_ridges(study: StudyResults) -> Section | None:
    """Return the most correlated parameters; None without draws."""
    if not study.draws or not study.has("pose_errors"):
        return None
    blocks: list[Block] = [*state_ridges(study), illustrate_ridges(study)]
    table = tabulate_ridges(study)
    if table is not None:
        blocks.append(Fold("The most correlated pairs of every variant", (table,)))
    return Section("Correlations of parameters", tuple(blocks), anchor="ridges", short="Ridges")


def rank_pairs(draws: dict[str, Array]) -> list[tuple[str, str, float]]:
    """Return all pairs of parameters with their correlation, the strongest first."""
    names = list(draws)
    matrix = np.atleast_2d(np.corrcoef(np.stack([draws[name] for name in names])))
    pairs = [(names[i], names[j], float(matrix[i, j])) for i in range(len(names)) for j in range(i + 1, len(names))]
    return sorted((p for p in pairs if np.isfinite(p[2])), key=lambda pair: -abs(pair[2]))


def choose_leg(pairs: list[tuple[str, str, float]]) -> tuple[int, list[tuple[str, str]]]:
    """Return the leg with the most correlated pair and its most correlated pairs of symbols; leg 0 without any."""
    within = [(split_name(a), split_name(b)) for a, b, _ in pairs]
    leg = next((a[1] for a, b in within if a[1] == b[1] and a[1] > 0), 0)
    return leg, [(a[0], b[0]) for a, b in within if a[1] == b[1] == leg][:4]


def tabulate_ridges(results: StudyResults) -> Table | None:
    """Return the most correlated pairs of every variant whose draws are there."""
    rows = []
    for name in results.ranking:
        if name in results.draws:
            pairs = rank_pairs(results.draws[name])[:SHOWN_PAIRS]
            texts = [f"{name_parameter(a)}, {name_parameter(b)}: {format_fixed(r, 3, sign=True)}" for a, b, r in pairs]
            rows.append([label_variant(results, name), *texts, *[NOTHING] * (SHOWN_PAIRS - len(texts))])
    if not rows:
        return None
    columns = [VARIANT]
    columns += [Column(title, kind="text") for title in ("Strongest", "second", "third")]
    return make_table("Most correlated pairs of parameters, correlation of the draws.", columns, rows)


def state_ridges(results: StudyResults) -> list[Statement]:
    """Say in words which pairs of the best variant the measurements cannot tell apart."""
    best = results.ranking[0]
    if best not in results.draws:
        return []
    pairs = rank_pairs(results.draws[best])
    strong = [p for p in pairs if abs(p[2]) > 0.9]
    named = [
        f"{name_parameter(a)} with {name_parameter(b)} ({format_fixed(r, 2, sign=True)})"
        for a, b, r in pairs[:SHOWN_PAIRS]
    ]
    text = f"In {label_variant(results, best)} the most correlated pairs are {join_words(named)}." if named else ""
    if strong:
        kinds = dict.fromkeys(" with ".join(write_symbol(split_name(x)[0]) for x in p[:2]) for p in strong)
        text += (
            f" {len(strong)} of {len(pairs)} pairs exceed 0.9 in size (kinds: {join_words(list(kinds)[:6])}): only a "
            "combination of the two is well measured, along the ridge the prior decides."
        )
    else:
        text += f" None of the {len(pairs)} pairs exceeds 0.9 in size."
    return [Statement(text), *_state_combinations(results, best)]


def _state_combinations(results: StudyResults, variant: str) -> list[Statement]:
    """Say how many combinations of parameters keep their tolerance: ridges of three and more show in no pair."""
    draws, rows = results.draws[variant], results.rows("parameters", variant)
    prior = {row["parameter"]: row["prior_sd"] for row in rows if row["verdict"] != NOISE}
    names = [name for name in draws if name in prior]
    if len(names) < 2:
        return []
    left = np.linalg.eigvalsh(np.cov(np.stack([draws[name] / prior[name] for name in names])))
    kept, lost = int((left > KEPT).sum()), int((left < LOST).sum())
    text = (
        f"Of the {len(left)} independent combinations of its geometry (principal axes of the draws in prior standard "
        f"deviations) {kept or 'none'} retain more than half of their prior variance, {lost or 'none'} less than 1 %."
    )
    if kept and lost:
        text += " So a parameter may stay uncertain by itself while the poses fix a combination of several."
    return [Statement(text)]


def illustrate_ridges(results: StudyResults) -> Figure:
    """Return the correlations within a leg of the best variant."""
    best, name = results.ranking[0], "ridges"
    if best not in results.draws:
        reason = f"it needs the draws of {label_variant(results, best)}, whose file is not there"
        return Figure(name, NO_PAIRS, None, reason)
    draws = {name: x for name, x in results.draws[best].items() if not FRAME.fullmatch(name)}
    leg, pairs = choose_leg(rank_pairs(draws))
    if not pairs:
        return Figure(name, NO_PAIRS, None, "no leg has two parameters")
    table = pd.DataFrame({split_name(n)[0]: x for n, x in draws.items() if split_name(n)[1] == leg})
    if len(table.columns.drop(MODEL_ERROR, errors="ignore")) < 2:
        return Figure(name, NO_PAIRS, None, "each leg has one parameter of its geometry")
    frame = results.parameters[results.parameters["model_error"] == "free"]
    one = frame[(frame["variant"] == best) & (frame["leg"] == leg)].set_index("symbol")
    nominal = one["nominal"].where(one.index != MODEL_ERROR, 0.0)
    caption = (
        f"{label_variant(results, best)}, leg {leg} (the one with the most correlated pair): correlation of its "
        "parameters (red +1, blue −1), and the draws of its most correlated pairs as offsets from nominal. A thin "
        "slanting cloud is a ridge: the measurements fix only what lies across it."
    )
    scales = {str(symbol): results.scale_of(str(symbol), str(unit)) for symbol, unit in one["unit"].items()}
    return Figure(name, caption, partial(draw_ridges, table, nominal, scales, pairs))
