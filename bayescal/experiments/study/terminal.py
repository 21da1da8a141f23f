"""What a study says on the terminal: the ranking, and what speaks against it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from bayescal.report.blocks import Statement
from bayescal.report.numbers import MICROMETRES, format_estimate, format_fixed

DOUBTS = ("Data", "Noise", "Tolerances", "Bounds")


def show_ranking(summary: Mapping[str, Any], console: Console) -> None:
    """Print the ranking of a study, and what did not converge."""
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
            str(rank) if fit["converged"] else "not ranked",
            name,
            format_estimate(fit["log_evidence"], fit["log_evidence_se"], 2),
            format_fixed(fit["log_evidence"] - best, 1),
            format_estimate(fit["elpd_loo"], fit["elpd_loo_se"], 1),
            format_fixed(held["elpd"] if held else None, 1),
            " / ".join(_format_size(error[which]) for which in ("mean", "max")) + " µm",
            "yes" if fit["converged"] else "NO",
        )
    console.print(table)
    use = "verification" if summary["n_poses"]["verification"] else "calibration"
    console.print(f"position error: mean / largest on the {use} poses; log-evidence in nats")
    for name in summary["ranking"]:
        fit = summary["variants"][name]
        for setting, one in (("", fit), (" without model error", fit["without_model_error"])):
            if "log_evidence_check" in one:
                console.print(_describe_check(f"{name}{setting}", one))
            for problem in one["problems"]:
                console.print(f"NOT CONVERGED {name}{setting}: {problem}")


def _describe_check(name: str, fit: Mapping[str, Any]) -> str:
    """Return both log-evidences of a posterior that was checked by tempering."""
    own = format_estimate(fit["log_evidence"], fit["log_evidence_se"], 3)
    check = fit["log_evidence_check"]
    return f"checked {name}: log-evidence {own}, by tempering {format_estimate(check['log_evidence'], check['se'], 3)}"


def show_doubts(verdict: Sequence[Statement], console: Console) -> None:
    """Print what contradicts the stated noise and tolerances."""
    for statement in verdict:
        if statement.lead in DOUBTS and statement.level in ("warning", "bad"):
            console.print(f"{statement.lead.upper()}: {statement.text}", soft_wrap=True)


def _format_size(size: float | None) -> str:
    return format_fixed(None if size is None else MICROMETRES * size, 1)


def show_comparison(comparison: pd.DataFrame, console: Console) -> None:
    """Print variants of several studies ranked together."""
    table = Table()
    for heading in ("results", "variant", "free", "log-evidence", "difference", "elpd LOO", "elpd verif.", "converged"):
        table.add_column(heading, justify="left" if heading in ("results", "variant") else "right", overflow="fold")
    for row in comparison.to_dict("records"):
        table.add_row(
            str(row["results"]),
            str(row["variant"]),
            str(row["n_parameters"]),
            format_estimate(row["log_evidence"], row["se"], 2),
            format_fixed(row["difference"], 1),
            format_fixed(row["elpd_loo"], 1),
            format_fixed(row["elpd_verification"], 1),
            str(row["converged"]),
        )
    console.print(table)
