"""What a run says on the terminal: the ranking or the verdict, what speaks against it, and where the report is."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.tables import name_verdict
from bayescal.experiments.audit.page.verdict import list_failures, state_headline, state_verdict
from bayescal.experiments.audit.page.wording import (
    format_contraction,
    format_probability,
    format_range,
    format_sd,
    format_share,
    name_requirement,
    name_unit,
)
from bayescal.report.symbols import write_symbol

MARKS = {"good": "+", "plain": " ", "warning": "!", "bad": "x"}
LEAST_WIDTH, MOST_WIDTH = 80, 120


def print_ranking(summary: dict[str, Any], out: Path) -> None:
    """Print the ranking of a study and the place of its report."""
    console = Console(width=None if Console().is_terminal else 120, highlight=False, markup=False)
    table = Table(title=f"{summary['title']} ({summary['data_origin']})", title_justify="left", title_style="")
    for heading in (
        *("rank", "variant", "log-evidence", "difference"),
        *("elpd LOO", "elpd verif.", "position error", "converged"),
    ):
        table.add_column(heading, justify="left" if heading == "variant" else "right")
    best = summary["variants"][summary["ranking"][0]]["log_evidence"]
    for rank, name in enumerate(summary["ranking"], start=1):
        fit = summary["variants"][name]
        held = fit["verification"]
        error = (held or fit["calibration"])["position_error_mm"]
        table.add_row(
            str(rank),
            name,
            f"{fit['log_evidence']:.2f} ± {fit['log_evidence_se']:.2f}",
            f"{fit['log_evidence'] - best:.1f}",
            f"{fit['elpd_loo']:.1f} ± {fit['elpd_loo_se']:.1f}",
            f"{held['elpd']:.1f}" if held else "-",
            f"{1e3 * error['mean']:.1f} / {1e3 * error['max']:.1f} µm",
            "yes" if fit["converged"] else "NO",
        )
    console.print(table)
    use = "verification" if summary["n_poses"]["verification"] else "calibration"
    console.print(f"position error: mean / largest on the {use} poses; log-evidence in nats")
    for name in summary["ranking"]:
        fit = summary["variants"][name]
        for setting, one in (("", fit), (" without model error", fit["without_model_error"])):
            for problem in one["problems"]:
                console.print(f"NOT CONVERGED {name}{setting}: {problem}")
    console.print(f"report: {out / 'report.html'}", soft_wrap=True)


def print_comparison(comparison: pd.DataFrame) -> None:
    """Print variants of several studies ranked together."""
    console = Console(width=None if Console().is_terminal else 160, highlight=False, markup=False)
    table = Table()
    for heading in ("results", "variant", "free", "log-evidence", "difference", "elpd LOO", "elpd verif.", "converged"):
        table.add_column(heading, justify="left" if heading in ("results", "variant") else "right", overflow="fold")
    for row in comparison.to_dict("records"):
        table.add_row(
            str(row["results"]),
            str(row["variant"]),
            str(row["n_parameters"]),
            f"{row['log_evidence']:.2f} ± {row['se']:.2f}",
            f"{row['difference']:.1f}",
            f"{row['elpd_loo']:.1f}",
            f"{row['elpd_verification']:.1f}",
            str(row["converged"]),
        )
    console.print(table)


def print_audit(summary: dict[str, Any], out: Path) -> None:
    """Print the verdict of an audit, what is known of each symbol, the requirements and the place of the report."""
    found = Console()
    width = min(MOST_WIDTH, max(LEAST_WIDTH, found.width)) if found.is_terminal else 100
    console = Console(width=width, highlight=False, markup=False)
    results = AuditResults(summary, {})
    console.print(summary["title"])
    for failure in list_failures(results):
        console.print(f"DO NOT RELY ON THIS: {failure.text}")
    console.print(state_headline(results))
    for statement in state_verdict(results):
        grid = Table.grid(padding=(0, 1))
        grid.add_row(MARKS[statement.level], f"{statement.lead}: {_write_symbols(statement.text, results.symbols)}")
        console.print(grid)
    console.print(_tabulate_symbols(results))
    if results.requirements:
        console.print(_tabulate_requirements(results))
    console.print(f"report: {out / 'audit.html'}", soft_wrap=True)


def _write_symbols(text: str, symbols: list[str]) -> str:
    """Return text with Greek letters as such."""
    written = {symbol: write_symbol(symbol) for symbol in symbols}
    return re.sub(r"(?<![\w.])[A-Za-z]\w*", lambda found: written.get(found[0], found[0]), text)


def _tabulate_symbols(results: AuditResults) -> Table:
    table = Table()
    for heading in ("symbol", "unit", "tolerance", "remains", "contraction", "verdict", "to do"):
        table.add_column(heading, justify="left" if heading in ("symbol", "unit", "verdict", "to do") else "right")
    for symbol, group in results.parameters.groupby("symbol", sort=False):
        counts = group["verdict"].value_counts()
        several = len(counts) > 1
        verdicts = [f"{n} {name_verdict(str(v))}" if several else name_verdict(str(v)) for v, n in counts.items()]
        free = group["recommended"]
        table.add_row(
            write_symbol(str(symbol)),
            name_unit(str(group["unit"].iloc[0])),
            format_range(list(group["prior_sd"]), format_sd),
            format_range(list(group["posterior_sd"]), format_sd),
            format_range(list(group["contraction"]), format_contraction),
            ", ".join(verdicts),
            "free" if free.all() else "partly" if free.any() else "fix",
        )
    return table


def _tabulate_requirements(results: AuditResults) -> Table:
    table = Table()
    for heading in ("requirement", "limit", "predicted sd", "of limit", "probability", "before"):
        table.add_column(heading, justify="left" if heading == "requirement" else "right")
    for r in results.requirements:
        unit = name_unit(r.unit)
        table.add_row(
            name_requirement(r.name),
            f"{r.limit:g} {unit}",
            f"{format_sd(r.predicted_sd)} {unit}",
            format_share(r.predicted_sd / r.limit),
            format_probability(r.probability),
            format_probability(r.prior_probability),
        )
    return table
