"""The evidence: its estimators, other priors, convergence, and further checks of the posteriors.

These are checked by the ranks of their chains, by left-out poses, and prior and data against each other by weights.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from matplotlib.ticker import FuncFormatter, NullFormatter

from bayescal.experiments.runner.results import Summary
from bayescal.experiments.study.page.results import VARIANT, StudyResults
from bayescal.experiments.study.page.soundness import list_failures, measure_gap
from bayescal.experiments.study.page.styles import Styles, add_legend, assign_styles
from bayescal.limits import (
    AGREEMENT,
    ESS_BULK_LIMIT,
    ESS_BULK_WANTED,
    ESS_TAIL_LIMIT,
    MOVED_LIMIT,
    PARETO_K_LIMIT,
    RHAT_LIMIT,
)
from bayescal.report.blocks import Block, Cell, Column, Figure, Fold, Level, PageSection, Statement, Table, make_table
from bayescal.report.numbers import NO_VALUE, count_decimals, format_estimate, format_fixed, format_plain, join_words
from bayescal.report.style import GREY, LEG_COLOURS, PALE, RED
from bayescal.report.symbols import split_name

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array

EXACT = "Covariance linearised at nominal; importance weights correct it."
WIDTHS = "Left: below each variant's largest log-evidence; right: below the best."
SPREAD = 0.08  # of the axis between the first and the last model at one factor
TIED = 1.0  # nats
LEAD = "scale of τ's prior"

KOLMOGOROV = 1.358  # 95 % of the largest distance of an ECDF, times the root of the number of draws
MOST_NAMED = 80  # poses with a name below the axis
GRID = np.linspace(0.0, 1.0, 101)
SENSITIVE = 0.05
"""Change of a posterior per doubling of a power, as a distance of distributions, from which on it counts."""
RANKS = "ECDF-difference ranks, 95 % band; outside: not mixed."
PARETO_K = f"Pareto k by pose; limit {PARETO_K_LIMIT}. Open: refitted."
POWERS = f"Cumulative Jensen–Shannon distance; threshold {SENSITIVE}. Both high: prior–data conflict."

type Row = list[tuple[Column, str | Cell]]


def show_evidence(study: StudyResults) -> PageSection:
    """Return the evidence for other widths of the priors, and by both estimators."""
    blocks: list[Block] = []
    if study.has("sensitivity"):
        if len(study.ranking) > 1 and len(study.sensitivity_grid) > 1:
            draw = partial(_draw_sensitivity, study.sensitivity_grid, assign_styles(study))
            blocks.append(Figure("sensitivity", WIDTHS, draw))
        blocks.append(_tabulate_widths(study))
    both = Fold("Both log-evidence estimators", (tabulate_evidence(study),))
    return PageSection("Evidence", (*blocks, *show_tau_scale(study), both), anchor="evidence")


def show_diagnostics(study: StudyResults) -> PageSection:
    """Return the convergence of every posterior, open where something failed, and further checks."""
    fold = Fold("Convergence", (_tabulate_diagnostics(study),), bool(list_failures(study)))
    return PageSection("Sampler diagnostics", (fold, *_fold_checks(study)), anchor="diagnostics", short="Checks")


# --- the estimators and their convergence ----------------------------------------------------------------------------


def format_evidence(value: float, se: float) -> str:
    """Return a log-evidence with its standard error, two to three decimals."""
    return format_estimate(value, se, min(3, max(2, count_decimals(se, 1))))


def _tabulate(study: StudyResults, caption: str, describe: Callable[[Summary], Row]) -> Table:
    """Return a table with a row per posterior, of what is to be said of each."""
    rows: list[Row] = [[(VARIANT, study.label(name)), *describe(fit)] for name, fit in study.fits.items()]
    return make_table(caption, [column for column, _ in rows[0]], [[cell for _, cell in row] for row in rows])


def tabulate_evidence(study: StudyResults) -> Table:
    """Return both estimators of the log-evidence side by side."""
    fits = study.fits.values()
    exact = any(fit.get("linearisation_log_shift") is not None for fit in fits)
    checked = any(fit.get("log_evidence_check") is not None for fit in fits)

    def describe(fit: Summary) -> Row:
        gap, k = measure_gap(fit), fit["pareto_k"]
        row = [
            *(_estimate(fit, by) for by in ("importance", "bridge")),
            (Column("Difference", f"nat, limit {AGREEMENT}"), _limited(gap, gap <= AGREEMENT, 3)),
            (Column("efficiency", "%", "Importance sampling"), format_fixed(100 * fit["efficiency"], 0)),
            (Column("Pareto k", f"limit {PARETO_K_LIMIT}", "Importance sampling"), _limited(k, k <= PARETO_K_LIMIT, 2)),
        ]
        row += _describe_correction(fit) if exact else []
        row.append((Column("Reported", kind="text"), str(fit["log_evidence_by"])))
        return row + ([_estimate(fit, "check", "another sampler")] if checked else [])

    caption = "Log-evidence by two estimators."
    return _tabulate(study, f"{caption} {EXACT}" if exact else caption, describe)


def _estimate(fit: Summary, by: str, title: str = "") -> tuple[Column, str | Cell]:
    value, se = fit.get(f"log_evidence_{by}"), fit.get(f"log_evidence_{by}_se")
    return Column(title or by, "nat", "Log-evidence by"), NO_VALUE if value is None or se is None else format_evidence(
        value, se
    )


def _describe_correction(fit: Summary) -> Row:
    """Return by how much the exact density changes the evidence and how many of the moved draws count."""
    columns = Column("shift", "nat", "Exact density"), Column("ESS fraction", "%", "Exact density")
    if fit.get("linearisation_log_shift") is None:
        return [(column, NO_VALUE) for column in columns]
    efficiency = fit["linearisation_efficiency"]
    fine = efficiency >= MOVED_LIMIT and fit["linearisation_pareto_k"] <= PARETO_K_LIMIT
    shift = format_evidence(fit["linearisation_log_shift"], fit["linearisation_log_shift_se"])
    return list(zip(columns, (shift, _limited(100 * efficiency, fine, 0)), strict=True))


def rate_bulk(bulk: float) -> Level:
    """Return how good a bulk effective sample size is."""
    if not bulk > ESS_BULK_LIMIT:
        return "bad"
    return "plain" if bulk >= ESS_BULK_WANTED else "warning"


def _limited(value: float, fine: bool, decimals: int) -> Cell:
    return Cell(format_fixed(value, decimals), "plain" if fine else "bad")


def _tabulate_diagnostics(study: StudyResults) -> Table:
    """Return convergence of every posterior."""

    def describe(fit: Summary) -> Row:
        k, bulk, tail = fit["loo_pareto_k_max"], fit["ess_bulk_min"], fit["ess_tail_min"]
        ess_limits = (f"limit {format_fixed(limit, 0)}" for limit in (ESS_BULK_LIMIT, ESS_TAIL_LIMIT))
        bulk_column, tail_column = (
            Column(title, limit, "Smallest ESS") for title, limit in zip(("bulk", "tail"), ess_limits, strict=True)
        )
        row: Row = [
            (Column("R-hat", f"limit {RHAT_LIMIT}"), _limited(fit["rhat_max"], fit["rhat_max"] < RHAT_LIMIT, 4)),
            (bulk_column, Cell(format_fixed(bulk, 0), rate_bulk(bulk))),
            (tail_column, _limited(tail, tail > ESS_TAIL_LIMIT, 0)),
        ]
        if "acceptance" in fit:
            row.append((Column("Acceptance", "%"), format_fixed(100 * fit["acceptance"], 0)))
        largest = Cell(format_fixed(k, 2), "plain" if k <= PARETO_K_LIMIT else "warning")
        row.append((Column("Largest LOO", "Pareto k"), largest))
        row.append((Column("Exact LOO refits"), str(fit["n_loo_refitted"])))
        if "wall_seconds" in fit:
            row.append((Column("Time", "s", kind="seconds"), format_fixed(fit["wall_seconds"], 1)))
        status = Cell("converged") if fit["converged"] else Cell(fit["problems"] or "not converged", "bad")
        if fit["converged"] and study.is_preliminary:
            status = Cell("preliminary", "warning")
        return [*row, (Column("Status", kind="text"), status)]

    caption = "Convergence."
    return _tabulate(study, caption, describe)


# --- other widths of the priors --------------------------------------------------------------------------------------


def _tabulate_grid(
    study: StudyResults, wide: pd.DataFrame, columns: list[Column], caption: str, marked: pd.DataFrame | None = None
) -> Table:
    """Return the log-evidence and rank of every variant, a column of ``wide`` each, in its rows; some cells marked."""
    ranks = wide.rank(axis=1, ascending=False, method="min")
    rows: list[list[str | Cell]] = []
    for name in wide.columns:
        pairs = zip(wide[name], ranks[name], strict=True)
        texts = [NO_VALUE if pd.isna(x) else f"{format_fixed(x, 1)} ({format_fixed(rank, 0)})" for x, rank in pairs]
        marks = [False] * len(texts) if marked is None else marked[name]
        cells = [Cell(text, "warning" if mark else "plain") for text, mark in zip(texts, marks, strict=True)]
        rows.append([study.label(name), *cells])
    note = Statement(f"Marked: Pareto k > {PARETO_K_LIMIT}.", "warning")
    notes = [note] if marked is not None and marked.to_numpy().any() else []
    return make_table(caption, [VARIANT, *columns], rows, notes)


def _tabulate_widths(study: StudyResults) -> Table:
    """Return the log-evidence and rank of every variant at every factor on the widths of the priors."""
    table = study.table("sensitivity")
    wide, pareto_k = (
        table.pivot(index="factor", columns="variant", values=value).sort_index()[study.names]
        for value in ("log_evidence", "pareto_k")
    )
    columns = [Column(f"{format_plain(one)} ×", "nat (rank)", "Prior widths") for one in wide.index]
    caption = "Log-evidence by prior width."
    return _tabulate_grid(study, wide, columns, caption, pareto_k > PARETO_K_LIMIT)


def _draw_sensitivity(wide: pd.DataFrame, styles: Styles) -> Drawing:
    """Return two panels: each variant's evidence below its own maximum, and its difference to the best variant.

    ``wide`` is log-evidence with a row per factor on the priors and a column per variant.
    """
    figure = Drawing(figsize=(9.4, 3.3))
    left, right = figure.subplots(1, 2)
    _draw_lines(left, wide - wide.max(axis=0), styles)
    left.set_ylabel("below own largest (nat)")
    left.set_title("Width cost")
    _draw_lines(right, wide.sub(wide.max(axis=1), axis=0), styles)
    right.set_yscale("symlog", linthresh=1.0, linscale=0.6)
    right.set_ylim(min(-1.0, 1.6 * float(right.dataLim.y0)), 0.5)
    right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    right.set_ylabel("below the best (nat)")
    right.set_title("Variants")
    add_legend(figure, styles, 1.2)
    return figure


def _draw_lines(axes: Axes, wide: pd.DataFrame, styles: Styles) -> None:
    """Draw a line per variant; models are side by side, so that those that agree are seen."""
    models = list(dict.fromkeys(style.model for style in styles.values()))
    logarithm = np.log(wide.index.to_numpy(dtype=float))
    span = float(np.ptp(logarithm)) or 1.0
    for name, style in styles.items():
        place = (models.index(style.model) + 0.5) / len(models) - 0.5
        factors = np.exp(logarithm + SPREAD * span * place)
        axes.plot(factors, wide[name], color=style.colour, marker=style.marker, markersize=5, linewidth=0.8)
    axes.set_xscale("log")
    axes.set_xticks(list(wide.index))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.minorticks_off()
    axes.set_xlabel("Prior width factor")
    axes.grid()


# --- other scales of the model error's prior -------------------------------------------------------------------------


def show_tau_scale(study: StudyResults) -> list[Block]:
    """Return what to do about the scale of the model error's prior and how certain that is; nothing without it."""
    own = study.tau_scale
    if own is None or study.table("tau_scale")["scale"].nunique() < 2:
        return []
    wide = study.table("tau_scale").pivot(index="scale", columns="variant", values="log_evidence")
    wide = wide[[name for name in study.ranking if name in wide.columns]].sort_index()
    columns = [Column(f"{scale:g} {study.error_unit}", "nat (rank)", "τ prior scale") for scale in wide.index]
    caption = "Log-evidence by τ prior scale."
    return [_state_order(study, wide, own), _tabulate_grid(study, wide, columns, caption)]


def _state_order(study: StudyResults, wide: pd.DataFrame, own: float) -> Statement:
    """Return whether a variant that is ahead at the stated scale falls behind at another."""
    overtaken = _find_overtaken(wide, own)
    unit = study.error_unit
    if overtaken is None:
        text = f"Ranking independent of τ's prior scale ({wide.index[0]:g} to {wide.index[-1]:g} {unit})."
        return Statement(text, "plain" if wide.isna().any(axis=None) else "good", LEAD)
    scale, ahead, behind = overtaken
    text = f"Ranking depends on τ's prior scale: {study.label(ahead)} leads at {own:g} {unit}, {study.label(behind)} "
    return Statement(f"{text}at {scale:g} {unit}.", "warning", LEAD)


def _find_overtaken(wide: pd.DataFrame, own: float) -> tuple[float, str, str] | None:
    """Return a scale, and which variant falls furthest behind which other there, against the stated scale."""
    found: list[tuple[float, float, str, str]] = []
    values = {str(name): dict(zip(wide.index.astype(float), wide[name], strict=True)) for name in wide.columns}
    for pair in combinations(values, 2):
        ahead, behind = sorted(pair, key=lambda name: -values[name][own])
        lead = {scale: values[ahead][scale] - values[behind][scale] for scale in values[ahead]}
        if lead[own] > TIED:
            found += [(-value, scale, ahead, behind) for scale, value in lead.items() if value < -TIED]
    return max(found)[1:] if found else None


# --- further checks ---------------------------------------------------------------------------------------------------


def _fold_checks(study: StudyResults) -> list[Block]:
    """Return the checks of the best variant, and those of all, each behind a line."""
    best, own = study.label(study.best_name), study.table("parameters", study.best_name)
    draw = partial(_draw_pareto_k, study.table("poses"), study.ranking, assign_styles(study))
    ranks = Figure("ranks", RANKS, None, study.say_missing())
    if draws := study.draws.get(study.best_name):
        effective = min(float(study.fit(study.best_name)["ess_bulk_min"]), float(len(next(iter(draws.values())))))
        ranks = Figure("ranks", RANKS, partial(_draw_ranks, draws, study.n_chains, effective))
    shown: list[tuple[str, Figure | Table]] = [
        ("Pareto k by pose", Figure("pareto_k", PARETO_K, draw)),
        (f"Chains of {best} (rank plot)", ranks),
    ]
    own = own[own["prior_sensitivity"].notna()]
    if len(own):
        shown.append((f"Power-scaling sensitivity of {best}", tabulate_power_scaling(own)))
    return [Fold(title, (block,)) for title, block in shown]


def _draw_ranks(draws: Mapping[str, Array], n_chains: int, effective: float) -> Drawing:
    """Return the rank plot of all parameters: each chain's share of the ranks, less what it should be.

    Of each parameter (S,) draws, chains laid end to end; ``effective`` is their smallest effective number.
    """
    from arviz_stats.base import array_stats  # a third of a second with xarray, for pages with draws

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
    axes.set_xlabel("Rank")
    axes.set_ylabel("share − expected")
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
        face = np.where(own["loo_refitted"].astype(bool), "none", style.colour)
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
    """Return by symbol how much a posterior depends on prior and measurements, from one variant's parameters."""
    split = [split_name(name) for name in own["parameter"]]
    own = own.assign(symbol=[symbol for symbol, _ in split], leg=[leg for _, leg in split])
    columns = [
        Column("Parameter", kind="symbol"),
        Column("Prior", "smallest to largest", "Sensitivity to"),
        Column("measurements", "smallest to largest", "Sensitivity to"),
        Column("Meaning", kind="text"),
    ]
    rows: list[list[str | Cell]] = []
    for symbol, group in own.groupby("symbol", sort=False):
        values = [group[f"{one}_sensitivity"] for one in ("prior", "likelihood")]
        spans = (dict.fromkeys(format_fixed(float(x), 3) for x in (one.min(), one.max())) for one in values)
        prior, data = (one >= SENSITIVE for one in values)
        words = []
        for chosen, text in ((prior & data, "prior–data conflict"), (prior & ~data, "prior-dominated")):
            legs = [str(leg) for leg in group.loc[chosen, "leg"] if leg]
            if chosen.any():
                words.append(text + ("" if chosen.all() or not legs else f" in leg {join_words(legs)}"))
        in_conflict = bool((prior & data).any())
        meaning = Cell("; ".join(words) or "data-dominated", "warning" if in_conflict else "plain")
        rows.append([str(symbol), *(" to ".join(span) for span in spans), meaning])
    caption = "Power-scaling sensitivity by symbol."
    return make_table(caption, columns, rows, [Statement(POWERS)])
