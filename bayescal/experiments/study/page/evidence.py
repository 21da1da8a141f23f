"""The evidence: its two estimators, wider and narrower priors, other scales of the model error, and convergence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from matplotlib.ticker import FuncFormatter, NullFormatter

from bayescal.experiments.study.page.checks import fold_checks
from bayescal.experiments.study.page.results import VARIANT, StudyResults
from bayescal.experiments.study.page.soundness import list_failures, measure_gap
from bayescal.experiments.study.page.styles import Styles, add_legend, assign_styles
from bayescal.limits import AGREEMENT, ESS_BULK_LIMIT, ESS_TAIL_LIMIT, MOVED_LIMIT, PARETO_K_LIMIT, RHAT_LIMIT
from bayescal.report.blocks import Block, Cell, Column, Figure, Fold, Section, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, count_decimals, format_estimate, format_fixed, format_plain

EXACT = (
    "Both explore a density whose covariance is the nominal machine's and are corrected by the exact one, with the "
    "covariance of every machine itself and the errors that all poses share: by how much, and how many of the draws "
    "moved there count."
)
WIDTHS = (
    "Log-evidence against a factor on the widths of all parameters' priors, which keep their "
    "ratios. Left: each variant below its own largest value; right: each variant below the best one at the same "
    "factor, logarithmic beyond 1 nat. Models are shifted a little at each factor, so that equal ones do not overlap. "
    "The ranking is stable where no lines cross on the right (ranks: table below)."
)
SPREAD = 0.08  # of the axis between the first and the last model at one factor
TIED = 1.0  # nats
LEAD = "scale of τ's prior"

type Row = list[tuple[Column, str | Cell]]


def show_evidence(study: StudyResults) -> Section:
    """Return the evidence for other widths of the priors, and by both estimators."""
    blocks: list[Block] = []
    if study.has("sensitivity"):
        if len(study.ranking) > 1 and len(study.sensitivity_grid) > 1:
            draw = partial(_draw_sensitivity, study.sensitivity_grid, assign_styles(study))
            blocks.append(Figure("sensitivity", WIDTHS, draw))
        blocks.append(_tabulate_widths(study))
    both = Fold("Both estimators of every log-evidence", (tabulate_evidence(study),))
    return Section("Evidence", (*blocks, *show_tau_scale(study), both), anchor="evidence")


def show_diagnostics(study: StudyResults) -> Section:
    """Return the convergence of every posterior, open where something failed, and further checks."""
    fold = Fold("Convergence of every posterior", (_tabulate_diagnostics(study),), bool(list_failures(study)))
    return Section("Numerical checks", (fold, *fold_checks(study)), anchor="diagnostics", short="Checks")


# --- the estimators and their convergence ----------------------------------------------------------------------------


def format_evidence(value: float, se: float) -> str:
    """Return a log-evidence with its standard error, two to three decimals."""
    return format_estimate(value, se, min(3, max(2, count_decimals(se, 1))))


def _tabulate(study: StudyResults, caption: str, describe: Callable[[Mapping[str, Any]], Row]) -> Table:
    """Return a table with a row per posterior, of what is to be said of each."""
    rows: list[Row] = [[(VARIANT, study.label(name)), *describe(fit)] for name, fit in study.fits.items()]
    return make_table(caption, [column for column, _ in rows[0]], [[cell for _, cell in row] for row in rows])


def tabulate_evidence(study: StudyResults) -> Table:
    """Return both estimators of the log-evidence side by side."""
    fits = study.fits.values()
    exact = any(fit.get("exact_density_shift") is not None for fit in fits)
    checked = any(fit.get("log_evidence_tempered") is not None for fit in fits)

    def describe(fit: Mapping[str, Any]) -> Row:
        gap, k = measure_gap(fit), fit["pareto_k"]
        row = [
            *(_estimate(fit, by) for by in ("importance", "bridge")),
            (Column("Difference", f"nat, limit {AGREEMENT}"), _limited(gap, gap <= AGREEMENT, 3)),
            (Column("efficiency", "%", "Importance sampling"), format_fixed(100 * fit["efficiency"], 0)),
            (Column("Pareto k", f"limit {PARETO_K_LIMIT}", "Importance sampling"), _limited(k, k <= PARETO_K_LIMIT, 2)),
        ]
        row += _describe_correction(fit) if exact else []
        row.append((Column("Reported", kind="text"), str(fit["log_evidence_by"])))
        return row + ([_estimate(fit, "tempered")] if checked else [])

    caption = "The log-evidence of every posterior by two independent estimators."
    return _tabulate(study, f"{caption} {EXACT}" if exact else caption, describe)


def _estimate(fit: Mapping[str, Any], by: str) -> tuple[Column, str | Cell]:
    value, se = fit.get(f"log_evidence_{by}"), fit.get(f"log_evidence_{by}_se")
    return Column(by, "nat", "Log-evidence by"), NOTHING if value is None or se is None else format_evidence(value, se)


def _describe_correction(fit: Mapping[str, Any]) -> Row:
    """Return by how much the exact density changes the evidence and how many of the moved draws count."""
    columns = Column("shift", "nat", "Exact density"), Column("draws that count", "%", "Exact density")
    if fit.get("exact_density_shift") is None:
        return [(column, NOTHING) for column in columns]
    efficiency = fit["exact_density_efficiency"]
    fine = efficiency >= MOVED_LIMIT and fit["exact_density_pareto_k"] <= PARETO_K_LIMIT
    shift = format_evidence(fit["exact_density_shift"], fit["exact_density_se"])
    return list(zip(columns, (shift, _limited(100 * efficiency, fine, 0)), strict=True))


def _limited(value: float, fine: bool, decimals: int) -> Cell:
    return Cell(format_fixed(value, decimals), "plain" if fine else "bad")


def _tabulate_diagnostics(study: StudyResults) -> Table:
    """Return convergence of every posterior."""

    def describe(fit: Mapping[str, Any]) -> Row:
        k, bulk, tail = fit["loo_pareto_k_max"], fit["ess_bulk_min"], fit["ess_tail_min"]
        ess_limits = (f"limit {format_fixed(limit, 0)}" for limit in (ESS_BULK_LIMIT, ESS_TAIL_LIMIT))
        bulk_column, tail_column = (
            Column(title, limit, "Smallest ESS") for title, limit in zip(("bulk", "tail"), ess_limits, strict=True)
        )
        row: Row = [
            (Column("R-hat", f"limit {RHAT_LIMIT}"), _limited(fit["rhat_max"], fit["rhat_max"] < RHAT_LIMIT, 4)),
            (bulk_column, _limited(bulk, bulk > ESS_BULK_LIMIT, 0)),
            (tail_column, _limited(tail, tail > ESS_TAIL_LIMIT, 0)),
        ]
        if "acceptance" in fit:
            row.append((Column("Acceptance", "%"), format_fixed(100 * fit["acceptance"], 0)))
        largest = Cell(format_fixed(k, 2), "plain" if k <= PARETO_K_LIMIT else "warning")
        row.append((Column("Largest LOO", "Pareto k"), largest))
        row.append((Column("Poses sampled again without"), str(fit["loo_refitted"])))
        if "wall_seconds" in fit:
            row.append((Column("Time", "s", kind="seconds"), format_fixed(fit["wall_seconds"], 1)))
        status = Cell("converged") if fit["converged"] else Cell(fit["problems"] or "not converged", "bad")
        return [*row, (Column("Status", kind="text"), status)]

    caption = "Convergence of every posterior; R-hat is rank-normalised, a chain is one ensemble of walkers."
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
        texts = [NOTHING if pd.isna(x) else f"{format_fixed(x, 1)} ({format_fixed(rank, 0)})" for x, rank in pairs]
        marks = [False] * len(texts) if marked is None else marked[name]
        cells = [Cell(text, "warning" if mark else "plain") for text, mark in zip(texts, marks, strict=True)]
        rows.append([study.label(name), *cells])
    note = Statement(f"Marked where Pareto k exceeds {PARETO_K_LIMIT}.", "warning")
    notes = [note] if marked is not None and marked.to_numpy().any() else []
    return make_table(caption, [VARIANT, *columns], rows, notes)


def _tabulate_widths(study: StudyResults) -> Table:
    """Return the log-evidence and rank of every variant at every factor on the widths of the priors."""
    table = study.table("sensitivity")
    wide, pareto_k = (
        table.pivot(index="factor", columns="variant", values=value).sort_index()[study.names]
        for value in ("log_evidence", "pareto_k")
    )
    columns = [Column(f"{format_plain(one)} ×", "nat (rank)", "Widths of all priors") for one in wide.index]
    caption = "Log-evidence for wider and narrower priors."
    return _tabulate_grid(study, wide, columns, caption, pareto_k > PARETO_K_LIMIT)


def _draw_sensitivity(wide: pd.DataFrame, styles: Styles) -> Drawing:
    """Return two panels: each variant's evidence below its own maximum, and its difference to the best variant.

    ``wide`` is log-evidence with a row per factor on the priors and a column per variant.
    """
    figure = Drawing(figsize=(9.4, 3.3))
    left, right = figure.subplots(1, 2)
    _draw_lines(left, wide - wide.max(axis=0), styles)
    left.set_ylabel("below its own largest (nat)")
    left.set_title("What the width costs each variant")
    _draw_lines(right, wide.sub(wide.max(axis=1), axis=0), styles)
    right.set_yscale("symlog", linthresh=1.0, linscale=0.6)
    right.set_ylim(min(-1.0, 1.6 * float(right.dataLim.y0)), 0.5)
    right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    right.set_ylabel("below the best there (nat, logarithmic)")
    right.set_title("What separates the variants")
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
    axes.set_xlabel("Factor on the widths of all priors")
    axes.grid()


# --- other scales of the model error's prior -------------------------------------------------------------------------


def show_tau_scale(study: StudyResults) -> list[Block]:
    """Return what to do about the scale of the model error's prior and how certain that is; nothing without it."""
    own = study.tau_scale
    if own is None or study.table("tau_scale")["tau_scale_um"].nunique() < 2:
        return []
    wide = study.table("tau_scale").pivot(index="tau_scale_um", columns="variant", values="log_evidence")
    wide = wide[[name for name in study.ranking if name in wide.columns]].sort_index()
    columns = [Column(f"{scale:g} µm", "nat (rank)", "Scale of τ's prior") for scale in wide.index]
    caption = "Log-evidence for other scales of τ's prior, by weighted draws of each posterior."
    return [_state_order(study, wide, own), _tabulate_grid(study, wide, columns, caption)]


def _state_order(study: StudyResults, wide: pd.DataFrame, own: float) -> Statement:
    """Say whether a variant that is ahead at the stated scale falls behind at another."""
    known, total = int(wide.notna().to_numpy().sum()), wide.size
    reliable = (
        f" {known} of {total} evidences are reliable: the draws of the others weigh too unevenly (Pareto k above "
        f"{PARETO_K_LIMIT}), since a posterior with that scale lies elsewhere."
        if known < total
        else ""
    )
    overtaken = _find_overtaken(wide, own)
    if overtaken is None:
        text = (
            f"Keep the scale of τ's prior, {own:g} µm, and the order of the variants: from {wide.index[0]:g} to "
            f"{wide.index[-1]:g} µm none that is ahead by more than {format_fixed(TIED, 0)} nat falls behind by as "
            f"much.{reliable}"
        )
        return Statement(text, "plain" if reliable else "good", LEAD)
    scale, ahead, behind = overtaken
    lead = wide[ahead] - wide[behind]
    text = (
        f"State the scale of τ's prior with the order of the variants: at {own:g} µm "
        f"{study.label(ahead)} is ahead of {study.label(behind)} by {format_fixed(lead[own], 1)} nat, at {scale:g} µm "
        f"behind by {format_fixed(-lead[scale], 1)} nat.{reliable}"
    )
    return Statement(text, "warning", LEAD)


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
