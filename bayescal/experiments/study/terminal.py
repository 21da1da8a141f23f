"""What a study says on the terminal: the ranking, and what speaks against it."""

from __future__ import annotations

import math
from pathlib import PurePath
from typing import TYPE_CHECKING

from rich.console import Console

from bayescal.experiments.runner.results import PRELIMINARY, Summary
from bayescal.experiments.runner.terminal import TerminalColumn, print_table, print_text
from bayescal.experiments.shared.headline import (
    describe_candidate,
    order_candidates,
    read_rows,
)
from bayescal.experiments.shared.origin import name_origin
from bayescal.report.numbers import MICROMETRES, NO_VALUE, format_estimate, format_fixed

if TYPE_CHECKING:
    import pandas as pd

RANKING = (
    TerminalColumn("rank"),
    TerminalColumn("variant", justify="left"),
    TerminalColumn("log-evidence", 2),
    TerminalColumn("difference"),
    TerminalColumn("elpd LOO", 3),
    TerminalColumn("elpd held back", 4),
    TerminalColumn("position error"),
    TerminalColumn("converged"),
)
COMPARED = (
    TerminalColumn("results", justify="left"),
    TerminalColumn("variant", justify="left"),
    TerminalColumn("free", 3),
    TerminalColumn("log-evidence", 1),
    TerminalColumn("difference"),
    TerminalColumn("elpd LOO", 2),
    TerminalColumn("elpd verif.", 4),
    TerminalColumn("converged"),
)


def show_ranking(summary: Summary, console: Console) -> None:
    """Print the variants of a study, those of one set of data together, and what did not converge."""
    from bayescal.experiments.study.page.solutions import say_solutions  # pandas, for those who show results

    summary = {**summary, "variants": read_rows(summary)}
    console.print(f"{summary['title']} ({name_origin(summary['origin'])})")
    use = "verification" if summary["n_poses"]["verification"] else "calibration"
    of_poses = any(fit.get(use) for fit in summary["variants"].values())
    shown = [one for one in RANKING if of_poses or one.title != "position error"]
    rows = []
    for ranking in summary["rankings"]:
        of_data = {name: summary["variants"][name] for name in ranking}
        candidates = [describe_candidate(*one) for one in of_data.items()]
        fits = {one.name: of_data[one.name] for one in order_candidates(candidates)}
        best = max((one.log_evidence for one in candidates if one.converged), default=math.nan)
        for rank, (name, fit) in enumerate(fits.items(), start=1):
            row = [
                str(rank) if fit["converged"] else "not ranked",
                name,
                format_estimate(fit["log_evidence"], fit["log_evidence_se"], 2),
                format_fixed(fit["log_evidence"] - best if fit["converged"] else math.nan, 1),
                format_estimate(fit["elpd_loo"], fit["elpd_loo_se"], 1),
                format_fixed(fit["elpd"], 1),
            ]
            if of_poses:
                row.append(_format_errors(fit.get(use)))
            passed = "preliminary" if summary.get(PRELIMINARY) else "yes"
            rows.append((*row, passed if fit["converged"] else "NO"))
    print_table(console, tuple(shown), rows)
    errors = f"position error, {use} poses: mean / largest " if of_poses else ""
    print_text(console, f"{errors}log-evidence in nats")
    for name, fit in summary["variants"].items():
        if fit.get("log_evidence_check") is not None:
            own, check = (
                format_estimate(fit[f"log_evidence{by}"], fit[f"log_evidence{by}_se"], 3) for by in ("", "_check")
            )
            print_text(console, f"checked {name}: log-evidence {own}, by another sampler {check}")
        if several := say_solutions(fit):
            print_text(console, f"{name}: {several}")
        if fit["problems"]:
            print_text(console, f"NOT CONVERGED {name}: {fit['problems']}")


def _format_errors(errors: Summary | None) -> str:
    """Return mean and largest position error; a dash of a variant whose poses no instrument saw."""
    if not errors:
        return NO_VALUE
    sizes = (errors["position_error_mm"][which] for which in ("mean", "max"))
    return " / ".join(format_fixed(None if one is None else MICROMETRES * one, 1) for one in sizes) + " µm"


def show_comparison(comparison: pd.DataFrame, console: Console) -> None:
    """Print variants of several studies ranked together, their directories without what is common to all."""
    folders = sorted({str(name) for name in comparison["results"]})
    last = [PurePath(folder).name for folder in folders]  # where these tell them apart
    short = dict(zip(folders, last if all(last) and len(set(last)) == len(last) else folders, strict=True))
    rows = [
        (
            short[str(row["results"])],
            str(row["variant"]),
            str(row["n_parameters"]),
            format_estimate(row["log_evidence"], row["se"], 2),
            format_fixed(row["difference"], 1),
            format_fixed(row["elpd_loo"], 1),
            format_fixed(row["elpd_verification"], 1),
            str(row["converged"]),
        )
        for row in comparison.to_dict("records")
    ]
    print_table(console, COMPARED, rows)
