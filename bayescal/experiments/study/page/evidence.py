"""Tables of the evidence: its two estimators, other priors, and the convergence of the posteriors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayescal.experiments.study.page.checks import measure_gap
from bayescal.experiments.study.page.results import SHORT_SETTINGS, StudyResults
from bayescal.experiments.study.page.variants import VARIANT, label_variant
from bayescal.limits import AGREEMENT, ESS_BULK_LIMIT, ESS_TAIL_LIMIT, MOVED_LIMIT, PARETO_K_LIMIT, RHAT_LIMIT
from bayescal.report.blocks import Cell, Column, Table, make_table
from bayescal.report.numbers import NOTHING, count_decimals, format_count, format_estimate, format_fixed

EXACT = (
    "Both explore a density whose covariance is the nominal machine's and are corrected by the exact one, with the "
    "covariance of every machine itself and the errors that all poses share: what it is worth, and how many of the "
    "draws moved there count."
)


def format_evidence(value: float, se: float) -> str:
    """Return a log-evidence with its standard error, two to three decimals."""
    return format_estimate(value, se, min(3, max(2, count_decimals(se, 1))))


def tabulate_evidence(results: StudyResults) -> Table:
    """Return both estimators of the log-evidence side by side."""
    columns = [
        VARIANT,
        Column("Model error", kind="text"),
        Column("importance", "nat", "Log-evidence by"),
        Column("bridge", "nat", "Log-evidence by"),
        Column("Difference", f"nat, limit {AGREEMENT}"),
        Column("draws", "", "Importance sampling"),
        Column("efficiency", "%", "Importance sampling"),
        Column("Pareto k", f"limit {PARETO_K_LIMIT}", "Importance sampling"),
        Column("worth", "nat", "Exact density"),
        Column("draws kept", "%", "Exact density"),
        Column("Reported", kind="text"),
    ]
    checked = any("log_evidence_check" in fit for _, _, fit in results.fits())
    if checked:
        columns.append(Column("tempering", "nat", "Checked by"))
    rows = []
    for name, setting, fit in results.fits():
        methods, errors, quality = fit["log_evidence_methods"], fit["log_evidence_method_se"], fit["importance"]
        rows.append(
            [
                label_variant(results, name),
                SHORT_SETTINGS[setting],
                format_evidence(methods["importance"], errors["importance"]),
                format_evidence(methods["bridge"], errors["bridge"]),
                Cell(format_fixed(measure_gap(fit), 3), "plain" if fit["log_evidence_agrees"] else "bad"),
                format_count(quality["n_draws"]),
                format_fixed(100 * quality["efficiency"], 0),
                _limited(quality["pareto_k"], quality["pareto_k"] <= PARETO_K_LIMIT, 2),
                *_describe_correction(fit.get("exact_density")),
                fit["log_evidence_primary"],
                *([_format_check(fit.get("log_evidence_check"))] if checked else []),
            ]
        )
    caption = "The log-evidence of every posterior by two independent estimators."
    if any("exact_density" in fit for _, _, fit in results.fits()):
        caption += f" {EXACT}"
    return make_table(caption, columns, rows)


def _describe_correction(exact: dict[str, float] | None) -> list[str | Cell]:
    """Return what the exact density is worth and how many of the moved draws count, dashes without one."""
    if exact is None:
        return [NOTHING, NOTHING]
    fine = exact["efficiency"] >= MOVED_LIMIT and exact["pareto_k"] <= PARETO_K_LIMIT
    worth = format_evidence(exact["log_evidence_shift"], exact["standard_error"])
    return [worth, _limited(100 * exact["efficiency"], fine, 0)]


def _format_check(check: Mapping[str, Any] | None) -> str:
    return NOTHING if check is None else format_evidence(check["log_evidence"], check["se"])


def _limited(value: float, fine: bool, decimals: int) -> Cell:
    return Cell(format_fixed(value, decimals), "plain" if fine else "bad")


def tabulate_diagnostics(results: StudyResults) -> Table:
    """Return convergence of every posterior."""
    columns = [
        VARIANT,
        Column("Model error", kind="text"),
        Column("R-hat", f"limit {RHAT_LIMIT}"),
        Column("bulk", f"limit {format_fixed(ESS_BULK_LIMIT, 0)}", "Smallest ESS"),
        Column("tail", f"limit {format_fixed(ESS_TAIL_LIMIT, 0)}", "Smallest ESS"),
        Column("Acceptance", "%"),
        Column("Largest LOO", "Pareto k"),
        Column("Time", "s", kind="seconds"),
        Column("Status", kind="text"),
    ]
    rows: list[list[str | Cell]] = []
    for name, setting, fit in results.fits():
        problems = "; ".join(str(p) for p in fit["problems"]) or "not converged"
        k = fit["elpd_loo_pareto_k_max"]
        rows.append(
            [
                label_variant(results, name),
                SHORT_SETTINGS[setting],
                _limited(fit["rhat_max"], fit["rhat_max"] < RHAT_LIMIT, 4),
                _limited(fit["ess_bulk_min"], fit["ess_bulk_min"] > ESS_BULK_LIMIT, 0),
                _limited(fit["ess_tail_min"], fit["ess_tail_min"] > ESS_TAIL_LIMIT, 0),
                format_fixed(100 * fit["acceptance"], 0),
                Cell(format_fixed(k, 2), "plain" if k <= PARETO_K_LIMIT else "warning"),
                format_fixed(fit["wall_seconds"], 1),
                Cell("converged") if fit["converged"] else Cell(problems, "bad"),
            ]
        )
    caption = "Convergence of every posterior; R-hat is rank-normalised, a chain is one ensemble of walkers."
    return make_table(caption, columns, rows)
