"""How the posteriors are checked: chains by their ranks, predictions by left-out poses, prior and data by weights."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from arviz_stats.base import array_stats
from matplotlib.figure import Figure as Drawing

from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.styles import Styles, add_legend, assign_styles
from bayescal.limits import PARETO_K_LIMIT
from bayescal.report.blocks import Block, Cell, Column, Figure, Fold, Statement, Table, make_table
from bayescal.report.numbers import format_fixed, join_words
from bayescal.report.style import GREY, LEG_COLOURS, PALE, RED
from bayescal.report.symbols import split_name

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array

KOLMOGOROV = 1.358  # 95 % of the largest distance of an ECDF, times the root of the number of draws
MOST_NAMED = 80  # poses with a name below the axis
GRID = np.linspace(0.0, 1.0, 101)
SENSITIVE = 0.05
"""Change of a posterior per doubling of a power, as a distance of distributions, from which on it counts."""
RANKS = (
    "Each chain's share of the draws below a rank, less the expected share, a line for each parameter and chain. "
    "Band: 95 % of as many independent draws as the smallest bulk ESS says, one parameter at a time. A chain that "
    "leaves it together with others of its colour has not seen what the others have."
)
PARETO_K = (
    "Pareto k of the weights that leave a calibration pose out. Above the line "
    f"({PARETO_K_LIMIT}) the weights fail; such a pose (open) was left out by a run of its own, unless more than "
    "ten poses of a posterior are as bad."
)
POWERS = (
    "How far the distribution of a parameter moves when the prior, or the density of the measurements, is raised "
    f"to a power near one; it counts from {SENSITIVE} on. Sensitive to the prior alone: the measurements say "
    "little. Sensitive to both: they pull apart."
)


def fold_checks(study: StudyResults) -> list[Block]:
    """Return the checks of the best variant, and those of all, each behind a line."""
    best = study.label(study.best_name)
    shown: list[tuple[str, Figure | Table]] = []
    draw = partial(_draw_pareto_k, study.table("poses"), study.ranking, assign_styles(study))
    shown.append(("Pareto k of every pose left out", Figure("pareto_k", PARETO_K, draw)))
    shown.append((f"Chains of {best} (rank plot)", _illustrate_ranks(study)))
    own = study.table("parameters", study.best_name)
    own = own[own["prior_sensitivity"].notna()]
    if len(own):
        shown.append((f"Sensitivity of {best} to prior and data (power scaling)", tabulate_power_scaling(own)))
    return [Fold(title, (block,)) for title, block in shown]


def _illustrate_ranks(study: StudyResults) -> Figure:
    if study.best_name not in study.draws:
        return Figure("ranks", RANKS, None, study.say_missing())
    draws = study.draws[study.best_name]
    effective = min(float(study.fit(study.best_name)["ess_bulk_min"]), float(len(next(iter(draws.values())))))
    return Figure("ranks", RANKS, partial(_draw_ranks, draws, study.n_chains, effective))


def _draw_ranks(draws: Mapping[str, Array], n_chains: int, effective: float) -> Drawing:
    """Return the rank plot of all parameters: each chain's share of the ranks, less what it should be.

    Of each parameter (S,) draws, chains laid end to end; ``effective`` is their smallest effective number.
    """
    figure = Drawing(figsize=(4.6, 2.6))
    axes = figure.subplots()
    ranks = array_stats.compute_ranks(np.stack(list(draws.values())), axis=-1, relative=True)
    for chain, own in enumerate(np.split(ranks, n_chains, axis=-1)):
        share = np.stack([np.searchsorted(np.sort(one), GRID, side="right") / len(one) for one in own])
        axes.plot(GRID, (share - GRID).T, color=LEG_COLOURS[chain % len(LEG_COLOURS)], linewidth=0.4, alpha=0.6)
    width = KOLMOGOROV * np.sqrt((1 - 1 / n_chains) * n_chains / effective)
    axes.fill_between(GRID, -width, width, color=PALE, alpha=0.6, linewidth=0)
    axes.axhline(0.0, color=GREY, linewidth=0.7)
    axes.set_xlim(0, 1)
    axes.set_xlabel("Rank among all draws, as a share")
    axes.set_ylabel("share of a chain − expected")
    axes.set_title(f"Ranks, {len(draws)} parameters, {n_chains} chains")
    return figure


def _draw_pareto_k(left_out: pd.DataFrame, variants: list[str], styles: Styles) -> Drawing:
    """Return Pareto k of every calibration pose and variant; open where a run left the pose out."""
    figure = Drawing(figsize=(9.4, 2.6))
    axes = figure.subplots()
    poses = list(dict.fromkeys(left_out[left_out["variant"].isin(variants)]["pose"]))
    place = {pose: k for k, pose in enumerate(poses)}
    for k, name in enumerate(variants):
        own, style = left_out[left_out["variant"] == name], styles[name]
        shift = 0.6 * ((k + 0.5) / len(variants) - 0.5)
        face = np.where(own["refitted"].astype(bool), "none", style.colour)
        shape: dict[str, Any] = {
            "marker": style.marker,
            "facecolors": face,
            "edgecolors": style.colour,
            "linewidths": 0.7,
        }
        axes.scatter(own["pose"].map(place) + shift, own["pareto_k"], s=11, **shape)
    axes.axhline(PARETO_K_LIMIT, color=RED, linewidth=0.8)
    step = -(-len(poses) // MOST_NAMED)
    axes.set_xticks(range(0, len(poses), step), poses[::step], rotation=90 if len(poses) > 12 else 0)
    axes.tick_params(axis="x", labelsize=7)
    axes.set_xlim(-0.7, len(poses) - 0.3)
    axes.set_ylabel("Pareto k")
    axes.grid(axis="y")
    add_legend(figure, styles, 1.2)
    return figure


def tabulate_power_scaling(own: pd.DataFrame) -> Table:
    """Return by symbol how much a posterior depends on prior and measurements.

    Parameters
    ----------
    own : DataFrame
        ``parameter``, ``prior_sensitivity`` and ``likelihood_sensitivity`` of one variant.
    """
    split = [split_name(name) for name in own["parameter"]]
    own = own.assign(symbol=[symbol for symbol, _ in split], leg=[leg for _, leg in split])
    columns = [
        Column("Parameter", kind="symbol"),
        Column("Prior", "smallest to largest", "Sensitivity to"),
        Column("measurements", "smallest to largest", "Sensitivity to"),
        Column("What it means", kind="text"),
    ]
    rows: list[list[str | Cell]] = []
    for symbol, group in own.groupby("symbol", sort=False):
        values = [group[f"{one}_sensitivity"] for one in ("prior", "likelihood")]
        spans = (dict.fromkeys(format_fixed(float(x), 3) for x in (one.min(), one.max())) for one in values)
        prior, data = (one >= SENSITIVE for one in values)
        words = []
        for chosen, text in ((prior & data, "prior and measurements pull apart"), (prior & ~data, "the prior decides")):
            legs = [str(leg) for leg in group.loc[chosen, "leg"] if leg]
            if chosen.any():
                words.append(text + ("" if chosen.all() or not legs else f" in leg {join_words(legs)}"))
        in_conflict = bool((prior & data).any())
        meaning = Cell("; ".join(words) or "the measurements decide", "warning" if in_conflict else "plain")
        rows.append([str(symbol), *(" to ".join(span) for span in spans), meaning])
    caption = "Sensitivity to prior and measurements by power scaling, over the entries of each symbol."
    return make_table(caption, columns, rows, [Statement(POWERS)])
