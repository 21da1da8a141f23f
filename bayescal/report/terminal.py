"""What a run says on the terminal: the ranking, what speaks against it, and where the report is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table


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
