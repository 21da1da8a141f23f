"""The evidence: its two estimators, other priors, and the convergence of the posteriors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayescal.experiments.shared.judgement_page import tabulate_widths
from bayescal.experiments.study.page.checks import list_failures, measure_gap
from bayescal.experiments.study.page.illustrations import illustrate_sensitivity
from bayescal.experiments.study.page.predictive_checks import fold_checks
from bayescal.experiments.study.page.results import SHORT_SETTINGS, StudyResults
from bayescal.experiments.study.page.tau_scale import show_tau_scale
from bayescal.experiments.study.page.variants import VARIANT, label_variant
from bayescal.limits import AGREEMENT, ESS_BULK_LIMIT, ESS_TAIL_LIMIT, MOVED_LIMIT, PARETO_K_LIMIT, RHAT_LIMIT
from bayescal.report.blocks import Block, Cell, Column, Fold, Section, Table, make_table
from bayescal.report.numbers import count_decimals, format_estimate, format_fixed

EXACT = (
    "Both explore a density whose covariance is the nominal machine's and are corrected by the exact one, with the "
    "covariance of every machine itself and the errors that all poses share: by how much, and how many of the draws "
    "moved there count."
)


def show_evidence(study: StudyResults) -> Section:
    """Return the evidence for other widths of the priors, and by both estimators."""
    blocks: list[Block] = []
    if study.has("sensitivity"):
        labels = {name: label_variant(study, name) for name in study.names}
        caption = "Log-evidence for wider and narrower priors."
        blocks += [illustrate_sensitivity(study)] if len(study.ranking) > 1 and len(study.sensitivity_grid) > 1 else []
        blocks.append(tabulate_widths(study.table("sensitivity"), labels, VARIANT, caption))
    both = Fold("Both estimators of every log-evidence", (tabulate_evidence(study),))
    return Section("Evidence", (*blocks, *show_tau_scale(study), both), anchor="evidence")


def show_diagnostics(study: StudyResults) -> Section:
    """Return the convergence of every posterior, open where something failed, and further checks."""
    fold = Fold("Convergence of every posterior", (tabulate_diagnostics(study),), bool(list_failures(study)))
    return Section("Numerical checks", (fold, *fold_checks(study)), anchor="diagnostics", short="Checks")


def format_evidence(value: float, se: float) -> str:
    """Return a log-evidence with its standard error, two to three decimals."""
    return format_estimate(value, se, min(3, max(2, count_decimals(se, 1))))


def _name(study: StudyResults, name: str, setting: str) -> list[tuple[Column, str | Cell]]:
    """Return the columns that say which posterior a row is of."""
    found: list[tuple[Column, str | Cell]] = [(VARIANT, label_variant(study, name))]
    if len(study.settings) > 1:
        found.append((Column("Model error", kind="text"), SHORT_SETTINGS[setting]))
    return found


def _make(caption: str, rows: list[list[tuple[Column, str | Cell]]]) -> Table:
    return make_table(caption, [column for column, _ in rows[0]], [[cell for _, cell in row] for row in rows])


def tabulate_evidence(study: StudyResults) -> Table:
    """Return both estimators of the log-evidence side by side."""
    fits = list(study.fits())
    exact = any(fit.get("exact_density_shift") is not None for *_, fit in fits)
    checked = any(fit.get("log_evidence_tempered") is not None for *_, fit in fits)
    rows = []
    for name, setting, fit in fits:
        row = [*_name(study, name, setting), *(_estimate(fit, by) for by in ("importance", "bridge"))]
        gap = Cell(format_fixed(measure_gap(fit), 3), "plain" if measure_gap(fit) <= AGREEMENT else "bad")
        efficiency = format_fixed(100 * fit["efficiency"], 0)
        row += [
            (Column("Difference", f"nat, limit {AGREEMENT}"), gap),
            (Column("efficiency", "%", "Importance sampling"), efficiency),
            (
                Column("Pareto k", f"limit {PARETO_K_LIMIT}", "Importance sampling"),
                _limited(fit["pareto_k"], fit["pareto_k"] <= PARETO_K_LIMIT, 2),
            ),
        ]
        row += _describe_correction(fit) if exact else []
        row.append((Column("Reported", kind="text"), str(fit["log_evidence_by"])))
        row += [_estimate(fit, "tempered")] if checked else []
        rows.append(row)
    caption = "The log-evidence of every posterior by two independent estimators."
    return _make(f"{caption} {EXACT}" if exact else caption, rows)


def _estimate(fit: Mapping[str, Any], by: str) -> tuple[Column, str | Cell]:
    value, se = fit.get(f"log_evidence_{by}"), fit.get(f"log_evidence_{by}_se")
    text = format_fixed(None, 2) if value is None or se is None else format_evidence(value, se)
    return Column(by, "nat", "Log-evidence by"), text


def _describe_correction(fit: Mapping[str, Any]) -> list[tuple[Column, str | Cell]]:
    """Return by how much the exact density changes the evidence and how many of the moved draws count."""
    columns = Column("shift", "nat", "Exact density"), Column("draws that count", "%", "Exact density")
    if fit.get("exact_density_shift") is None:
        return [(column, format_fixed(None, 0)) for column in columns]
    efficiency = fit["exact_density_efficiency"]
    fine = efficiency >= MOVED_LIMIT and fit["exact_density_pareto_k"] <= PARETO_K_LIMIT
    shift = format_evidence(fit["exact_density_shift"], fit["exact_density_se"])
    return list(zip(columns, (shift, _limited(100 * efficiency, fine, 0)), strict=True))


def _limited(value: float, fine: bool, decimals: int) -> Cell:
    return Cell(format_fixed(value, decimals), "plain" if fine else "bad")


def tabulate_diagnostics(study: StudyResults) -> Table:
    """Return convergence of every posterior."""
    rows = []
    for name, setting, fit in study.fits():
        k, bulk, tail = fit["loo_pareto_k_max"], fit["ess_bulk_min"], fit["ess_tail_min"]
        row = _name(study, name, setting)
        row += [
            (Column("R-hat", f"limit {RHAT_LIMIT}"), _limited(fit["rhat_max"], fit["rhat_max"] < RHAT_LIMIT, 4)),
            (_limit("bulk", ESS_BULK_LIMIT), _limited(bulk, bulk > ESS_BULK_LIMIT, 0)),
            (_limit("tail", ESS_TAIL_LIMIT), _limited(tail, tail > ESS_TAIL_LIMIT, 0)),
        ]
        if "acceptance" in fit:
            row.append((Column("Acceptance", "%"), format_fixed(100 * fit["acceptance"], 0)))
        row += [
            (
                Column("Largest LOO", "Pareto k"),
                Cell(format_fixed(k, 2), "plain" if k <= PARETO_K_LIMIT else "warning"),
            ),
            (Column("Poses sampled again without"), str(fit["loo_refitted"])),
        ]
        if "wall_seconds" in fit:
            row.append((Column("Time", "s", kind="seconds"), format_fixed(fit["wall_seconds"], 1)))
        status = Cell("converged") if fit["converged"] else Cell(fit["problems"] or "not converged", "bad")
        rows.append([*row, (Column("Status", kind="text"), status)])
    return _make("Convergence of every posterior; R-hat is rank-normalised, a chain is one ensemble of walkers.", rows)


def _limit(title: str, limit: float) -> Column:
    return Column(title, f"limit {format_fixed(limit, 0)}", "Smallest ESS")
