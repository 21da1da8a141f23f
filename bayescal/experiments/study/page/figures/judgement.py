"""Whether chains agree, and whether poses that were left out lie where a posterior expects them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from arviz_stats.base import array_stats
from arviz_stats.ecdf_utils import ecdf_pit
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayescal.experiments.study.page.styles import Styles, count_columns, list_keys
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import MICROMETRES
from bayescal.report.style import GREY, INK, LEG_COLOURS, PALE, RED
from bayescal.report.symbols import Asked, shown_in

KOLMOGOROV = 1.358  # 95 % of the largest distance of an ECDF, times the root of the number of draws
SIMULATIONS = 500
MOST_NAMED = 80  # poses with a name below the axis
MANY = 600
"""Values from which on a band is not simulated."""
GRID = np.linspace(0.0, 1.0, 101)


def draw_ranks(draws: Mapping[str, Array], n_chains: int, effective: float) -> Figure:
    """Return the rank plot of all parameters: each chain's share of the ranks, less what it should be.

    Parameters
    ----------
    draws : mapping of str to ndarray, shape (S,)
        Chains laid end to end.
    n_chains : int
    effective : float
        Smallest effective number of draws, of all chains together.
    """
    figure = Figure(figsize=(4.6, 2.6))
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


def draw_pits(pits: Mapping[str, Array]) -> Figure:
    """Return ΔECDF of PITs, a panel per setting, each with a simultaneous 95 % band of uniform numbers."""
    figure = Figure(figsize=(4.6 * len(pits), 2.6))
    panels = figure.subplots(1, len(pits), squeeze=False, sharey=True)[0]
    for axes, (title, values) in zip(panels, pits.items(), strict=True):
        points, share, low, high = _band(values)
        _shade(axes, points, low - points, high - points)
        axes.plot(points, share - points, color=INK, linewidth=1.1)
        axes.set_title(title)
        axes.set_xlabel("Where the measured value lies in its prediction (LOO-PIT)")
    panels[0].set_ylabel("share below − expected")
    return figure


def _band(values: Array) -> tuple[Array, Array, Array, Array]:
    """Return points, the share of values (n,) below them, and the band that holds that of uniform numbers.

    By simulation, whose time grows with n²; Kolmogorov's, which many values reach, beyond.
    """
    if len(values) <= MANY:
        points, share, low, high = ecdf_pit(values, 0.95, SIMULATIONS)
        return points, share, low, high
    share = np.searchsorted(np.sort(values), GRID, side="right") / len(values)
    width = KOLMOGOROV / np.sqrt(len(values))
    return GRID, share, np.clip(GRID - width, 0.0, 1.0), np.clip(GRID + width, 0.0, 1.0)


def _shade(axes: Axes, points: Array, low: Array, high: Array) -> None:
    axes.fill_between(points, low, high, color=PALE, alpha=0.6, linewidth=0)
    axes.axhline(0.0, color=GREY, linewidth=0.7)
    axes.set_xlim(0, 1)


def draw_replicates(misfit: Array, asked: Asked = None) -> Figure:
    """Return the distribution of the poses' errors beside those of replicates, from measured minus replicated poses.

    Parameters
    ----------
    misfit : ndarray, shape (S, P, 6)
        mm and rad.
    asked : mapping or None
        Units of the config.
    """
    angle, unit = shown_in("rad", asked)
    turned = (f"Orientation error ({unit})", slice(3, 6), angle)
    kinds = (("Position error (µm)", slice(0, 3), MICROMETRES), turned)
    mean = misfit.mean(axis=0)
    known = [one for one in kinds if np.isfinite(misfit[..., one[1]]).any()]
    figure = Figure(figsize=(4.6 * len(known), 2.6))
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
    panels[0].legend(
        handles=[
            Line2D([], [], color=INK, marker="o", markersize=2.5, label="measured"),
            Line2D([], [], color=PALE, linewidth=6, label="replicates, 95 %"),
        ],
        loc="lower right",
    )
    return figure


def _measure(vector: Array) -> Array:
    """Return the lengths of vectors (..., 3) along what was measured."""
    return np.asarray(np.sqrt(np.nansum(vector**2, axis=-1)))


def draw_pareto_k(left_out: pd.DataFrame, variants: list[str], styles: Styles) -> Figure:
    """Return Pareto k of every calibration pose and variant; open where a run left the pose out."""
    figure = Figure(figsize=(9.4, 2.6))
    axes = figure.subplots()
    poses = list(dict.fromkeys(left_out["pose"]))
    place = {pose: k for k, pose in enumerate(poses)}
    for k, name in enumerate(variants):
        own, style = left_out[left_out["variant"] == name], styles[name]
        shift = 0.6 * ((k + 0.5) / len(variants) - 0.5)
        face = np.where(own["refitted"].astype(bool), "none", style.colour)
        axes.scatter(
            own["pose"].map(place) + shift,
            own["pareto_k"],
            s=11,
            marker=style.marker,
            facecolors=face,
            edgecolors=style.colour,
            linewidths=0.7,
        )
    axes.axhline(PARETO_K_LIMIT, color=RED, linewidth=0.8)
    step = -(-len(poses) // MOST_NAMED)
    axes.set_xticks(range(0, len(poses), step), poses[::step], rotation=90 if len(poses) > 12 else 0)
    axes.tick_params(axis="x", labelsize=7)
    axes.set_xlim(-0.7, len(poses) - 0.3)
    axes.set_ylabel("Pareto k")
    axes.grid(axis="y")
    figure.legend(
        handles=list_keys(styles, 1.2), loc="outside upper left", ncols=count_columns(styles, 8), borderaxespad=0.2
    )
    return figure
