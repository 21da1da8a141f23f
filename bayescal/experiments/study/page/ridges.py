"""Ridges of the posteriors: which parameters the measurements cannot tell apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from bayescal.experiments.shared import knowledge_page
from bayescal.experiments.study.page.results import FRAME, NOISE, VARIANT, StudyResults
from bayescal.experiments.study.rows import ParameterRow
from bayescal.report.blocks import Block, Column, Figure, Fold, PageSection, Statement, make_table
from bayescal.report.numbers import NO_VALUE, format_fixed, join_words
from bayescal.report.style import INK
from bayescal.report.symbols import MODEL_ERROR, set_mathematics, split_name

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array

SHOWN_PAIRS = 3
SHOWN_RIDGES = 8
NO_PAIRS = "Correlations within a {}."
RETAINED, REMOVED = 0.5, 0.01  # share of the prior variance of a combination that is hardly, or well, measured
SHOWN_DRAWS = 1500
MAX_LEVEL_LABEL = 8  # letters of a name that has room below its column
MAX_NUMBERED_CORRELATIONS = 10  # parameters of which the correlations are written as numbers


def show_ridges(study: StudyResults) -> PageSection | None:
    """Return undetermined combinations, and the most correlated parameters; None without either."""
    stated = knowledge_page.state_ridges(study.tables, study.chosen)
    blocks: list[Block] = [*stated[:SHOWN_RIDGES]]
    if others := stated[SHOWN_RIDGES:]:
        blocks.append(Fold(f"{len(others)} more undetermined combinations", tuple(others)))
    blocks += state_ridges(study)
    if study.has_members:
        blocks.append(_illustrate(study))
    if not blocks:
        return None
    rows = []
    for name in study.ranking:
        if name in study.draws:
            pairs = rank_pairs(study.draws_of_machine(name))[:SHOWN_PAIRS]
            texts = [
                f"{study.name_parameter(a)}, {study.name_parameter(b)}: {format_fixed(r, 3, sign=True)}"
                for a, b, r in pairs
            ]
            rows.append([study.label(name), *texts, *[NO_VALUE] * (SHOWN_PAIRS - len(texts))])
    columns = [VARIANT, *(Column(title, kind="text") for title in ("Strongest", "second", "third"))]
    table = make_table("Most correlated parameter pairs.", columns, rows)
    blocks += [Fold("Correlated pairs by variant", (table,))] if rows else []
    return PageSection("Unidentifiable combinations", tuple(blocks), anchor="ridges", short="Ridges")


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


def state_ridges(study: StudyResults) -> list[Statement]:
    """Say in words which pairs of the best variant the measurements cannot tell apart."""
    best = study.best_name
    if best not in study.draws:
        return []
    pairs = rank_pairs(study.draws_of_machine(best))
    if not pairs:
        return []
    strong = [p for p in pairs if abs(p[2]) > 0.9]
    named = [
        f"{study.name_parameter(a)} with {study.name_parameter(b)} ({format_fixed(r, 2, sign=True)})"
        for a, b, r in pairs[:SHOWN_PAIRS]
    ]
    text = f"Most correlated pairs of {study.label(best)}: {join_words(named)}; "
    text += f"{len(strong)} of {len(pairs)} above 0.9."
    return [Statement(text), *_state_combinations(study, best)]


def _state_combinations(study: StudyResults, variant: str) -> list[Statement]:
    """Say how many combinations of parameters keep their tolerance: ridges of three and more show in no pair."""
    draws, rows = study.draws_of_machine(variant), study.rows(ParameterRow, variant)
    prior = {row.parameter: row.prior_sd for row in rows if row.verdict != NOISE}
    names = [name for name in draws if name in prior]
    if len(names) < 2:
        return []
    left = np.linalg.eigvalsh(np.cov(np.stack([draws[name] / prior[name] for name in names])))
    retained, removed = int((left > RETAINED).sum()), int((left < REMOVED).sum())
    text = (
        f"Of {len(left)} principal axes {retained} retain more than half of their prior variance, "
        f"{removed} less than 1 %."
    )
    return [Statement(text)]


def _illustrate(study: StudyResults) -> Figure:
    """Return the correlations within a leg of the best variant."""
    best, name, nothing = study.best_name, "ridges", NO_PAIRS.format(study.member)
    if best not in study.draws:
        return Figure(name, nothing, None, study.say_missing())
    draws = {name: x for name, x in study.draws_of_machine(best).items() if not FRAME.fullmatch(name)}
    leg, pairs = choose_leg(rank_pairs(draws))
    if not pairs:
        return Figure(name, nothing, None, f"no {study.member} has two parameters")
    table = pd.DataFrame({split_name(n)[0]: x for n, x in draws.items() if split_name(n)[1] == leg})
    if len(table.columns.drop(MODEL_ERROR, errors="ignore")) < 2:
        return Figure(name, nothing, None, f"one geometry parameter per {study.member}")
    rows = study.parameters
    one = rows[(rows["variant"] == best) & (rows["leg"] == leg)].set_index("symbol")
    nominal = one["nominal"].where(one.index != MODEL_ERROR, 0.0)
    caption = (
        f"{study.label(best)}, {study.member} {leg}: parameter correlations (red +1, blue −1), draws "
        "of the strongest pairs."
    )
    scales = {str(symbol): study.scale_of(str(symbol), str(unit)) for symbol, unit in one["unit"].items()}
    return Figure(name, caption, partial(_draw, table, nominal, scales, pairs))


def _draw(
    draws: pd.DataFrame, nominal: pd.Series, scales: Mapping[str, tuple[float, str]], pairs: Sequence[tuple[str, str]]
) -> Drawing:
    """Return the correlations of one leg's parameters, a column of draws each, and the draws of chosen pairs.

    Offsets from nominal are shown by factor and name of the unit, by symbol.
    """
    figure = Drawing(figsize=(9.4, 3.9))
    grid = figure.add_gridspec(2, 4, width_ratios=(1.25, 1.25, 1.0, 1.0))
    _draw_matrix(figure.add_subplot(grid[:, :2]), draws)
    step = max(1, len(draws) // SHOWN_DRAWS)
    shown = (draws - nominal).iloc[::step]
    places = ((0, 2), (0, 3), (1, 2), (1, 3))
    for pair, (row, column) in zip(pairs, places, strict=False):
        axes = figure.add_subplot(grid[row, column])
        x, y = (scales[symbol][0] * shown[symbol] for symbol in pair)
        axes.plot(x, y, linestyle="none", marker=".", markersize=1.6, color=INK, alpha=0.45)
        x_label, y_label = (f"{set_mathematics(symbol, 'Δ')} ({scales[symbol][1]})" for symbol in pair)
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        axes.locator_params(nbins=4)
        axes.grid()
    return figure


def _draw_matrix(axes: Axes, draws: pd.DataFrame) -> None:
    symbols = list(draws.columns)
    matrix = draws.corr().to_numpy()
    axes.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
    labels = [set_mathematics(symbol) for symbol in symbols]
    long = max(map(len, symbols)) > MAX_LEVEL_LABEL
    axes.set_xticks(range(len(symbols)), labels, rotation=90 if long else 0)
    axes.set_yticks(range(len(symbols)), labels)
    axes.tick_params(length=0)
    for i, j in np.ndindex(*matrix.shape):
        if i != j and len(symbols) <= MAX_NUMBERED_CORRELATIONS:
            colour = "white" if abs(matrix[i, j]) > 0.6 else INK
            text = format_fixed(float(matrix[i, j]), 2)
            axes.text(j, i, text, ha="center", va="center", fontsize=8, color=colour)
    axes.spines[:].set_visible(False)
    axes.set_title("Correlation")
