"""How the posteriors are checked: chains by their ranks, predictions by left-out poses, prior and data by weights."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from arviz_stats.base import array_stats
from arviz_stats.ecdf_utils import ecdf_pit
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D

from bayescal.experiments.study.page.results import SETTINGS, StudyResults
from bayescal.experiments.study.page.styles import Styles, add_legend, assign_styles
from bayescal.limits import PARETO_K_LIMIT
from bayescal.report.blocks import Block, Cell, Column, Figure, Fold, Statement, Table, make_table
from bayescal.report.numbers import MICROMETRES, format_fixed, join_words
from bayescal.report.style import GREY, INK, LEG_COLOURS, PALE, RED
from bayescal.report.symbols import Asked, shown_in, split_name

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array

COMPONENT_PITS = ("x_pit", "y_pit", "z_pit", "rx_pit", "ry_pit", "rz_pit")
KOLMOGOROV = 1.358  # 95 % of the largest distance of an ECDF, times the root of the number of draws
SIMULATIONS = 500
MOST_NAMED = 80  # poses with a name below the axis
MANY = 600
"""Values from which on a band is not simulated."""
GRID = np.linspace(0.0, 1.0, 101)
SENSITIVE = 0.05
"""Change of a posterior per doubling of a power, as a distance of distributions, from which on it counts."""
RANKS = (
    "Each chain's share of the draws below a rank, less the expected share, a line for each parameter and chain. "
    "Band: 95 % of as many independent draws as the smallest bulk ESS says, one parameter at a time. A chain that "
    "leaves it together with others of its colour has not seen what the others have."
)
PITS = (
    "Share of the measured components (x, y, z and three angles of every calibration pose, each pose left out) "
    "below a quantile of their predictions, less the expected share. Band: 95 % of "
    "independent uniform numbers. An S that falls first and rises then means predictions too wide, the other way "
    "round too narrow, a hump to one side a bias."
)
REPLICATES = (
    "Errors of the calibration poses against the mean prediction, sorted, with those that replicates of the "
    "measurement would have (band: 95 %; line: median), with model error. A posterior that has seen a "
    "pose fits it somewhat better than a replicate. Poses far left of the band: noise or model error too large; "
    "right of it: too small, at the upper end single poses that are outliers."
)
PARETO_K = (
    "Pareto k of the weights that leave a calibration pose out, with model error. Above the line "
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
    poses = study.table("poses")
    poses = poses[poses["use"] == "calibration"]
    if "x_pit" in poses:
        title = f"Poses left out: where they lie in the predictions of {best} (LOO-PIT)"
        shown.append((title, _illustrate_pits(poses[poses["variant"] == study.best_name])))
        figure = Figure("replicates", REPLICATES, None, study.say_missing())
        if study.replicates is not None:
            figure = Figure("replicates", REPLICATES, partial(_draw_replicates, study.replicates, study.units))
        shown.append((f"Errors of poses and of their replicates, {best} (posterior predictive check)", figure))
    draw = partial(_draw_pareto_k, poses[poses["model_error"] == "free"], study.ranking, assign_styles(study))
    shown.append(("Pareto k of every pose left out", Figure("pareto_k", PARETO_K, draw)))
    shown.append((f"Chains of {best} (rank plot)", _illustrate_ranks(study)))
    own = study.table("parameters", study.best_name)
    own = own[(own["model_error"] == "free") & own["prior_sensitivity"].notna()]
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
    _shade(axes, GRID, np.full_like(GRID, -width), np.full_like(GRID, width))
    axes.set_xlabel("Rank among all draws, as a share")
    axes.set_ylabel("share of a chain − expected")
    axes.set_title(f"Ranks, {len(draws)} parameters, {n_chains} chains")
    return figure


def _illustrate_pits(poses: pd.DataFrame) -> Figure:
    pits = {}
    for setting in (one for one in SETTINGS if (poses["model_error"] == one).any()):
        words, chosen = SETTINGS[setting], poses[poses["model_error"] == setting]
        values = chosen[list(COMPONENT_PITS)].to_numpy(dtype=float).ravel()
        pits[words[0].upper() + words[1:]] = values[pd.notna(values)]
    if not all(len(values) > 2 for values in pits.values()):
        return Figure("loo_pit", PITS, None, "no component of a pose is measured")
    return Figure("loo_pit", PITS, partial(_draw_pits, pits))


def _draw_pits(pits: Mapping[str, Array]) -> Drawing:
    """Return ΔECDF of PITs, a panel per setting, each with a simultaneous 95 % band of uniform numbers.

    By simulation, whose time grows with the square of their number; Kolmogorov's, which many values reach, beyond.
    """
    figure = Drawing(figsize=(4.6 * len(pits), 2.6))
    panels = figure.subplots(1, len(pits), squeeze=False, sharey=True)[0]
    for axes, (title, values) in zip(panels, pits.items(), strict=True):
        if len(values) <= MANY:
            points, share, low, high = ecdf_pit(values, 0.95, SIMULATIONS)
        else:
            points, width = GRID, KOLMOGOROV / np.sqrt(len(values))
            share = np.searchsorted(np.sort(values), GRID, side="right") / len(values)
            low, high = np.clip(GRID - width, 0.0, 1.0), np.clip(GRID + width, 0.0, 1.0)
        _shade(axes, points, low - points, high - points)
        axes.plot(points, share - points, color=INK, linewidth=1.1)
        axes.set_title(title)
        axes.set_xlabel("Where the measured value lies in its prediction (LOO-PIT)")
    panels[0].set_ylabel("share below − expected")
    return figure


def _shade(axes: Axes, points: Array, low: Array, high: Array) -> None:
    axes.fill_between(points, low, high, color=PALE, alpha=0.6, linewidth=0)
    axes.axhline(0.0, color=GREY, linewidth=0.7)
    axes.set_xlim(0, 1)


def _draw_replicates(misfit: Array, asked: Asked) -> Drawing:
    """Return the distribution of the poses' errors and that of replicates.

    ``misfit``, shape (S, P, 6), mm and rad, is measured less replicated poses.
    """
    angle, unit = shown_in("rad", asked)
    turned = (f"Orientation error ({unit})", slice(3, 6), angle)
    kinds = (("Position error (µm)", slice(0, 3), MICROMETRES), turned)
    mean = misfit.mean(axis=0)
    known = [one for one in kinds if np.isfinite(misfit[..., one[1]]).any()]
    figure = Drawing(figsize=(4.6 * len(known), 2.6))
    panels = figure.subplots(1, len(known), squeeze=False, sharey=True)[0]
    for axes, (label, part, factor) in zip(panels, known, strict=True):
        seen = factor * np.sort(_measure(mean[:, part]))
        made = factor * np.sort(_measure((mean - misfit)[..., part]), axis=-1)
        share = (np.arange(len(seen)) + 0.5) / len(seen)
        axes.fill_betweenx(share, *np.quantile(made, [0.025, 0.975], axis=0), color=PALE, linewidth=0)
        axes.plot(np.median(made, axis=0), share, color=GREY, linewidth=0.9)
        axes.plot(seen, share, color=INK, marker="o", markersize=2.5, linewidth=0.7)
        axes.set_xlim(left=0)
        axes.set_xlabel(label)
    panels[0].set_ylabel("share of the poses below")
    measured = Line2D([], [], color=INK, marker="o", markersize=2.5, label="measured")
    replicates = Line2D([], [], color=PALE, linewidth=6, label="replicates, 95 %")
    panels[0].legend(handles=[measured, replicates], loc="lower right")
    return figure


def _measure(vector: Array) -> Array:
    """Return the lengths of vectors (..., 3) along what was measured."""
    return np.asarray(np.sqrt(np.nansum(vector**2, axis=-1)))


def _draw_pareto_k(left_out: pd.DataFrame, variants: list[str], styles: Styles) -> Drawing:
    """Return Pareto k of every calibration pose and variant; open where a run left the pose out."""
    figure = Drawing(figsize=(9.4, 2.6))
    axes = figure.subplots()
    poses = list(dict.fromkeys(left_out["pose"]))
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
