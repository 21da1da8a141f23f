"""The table of a page that says how far the estimates of `shared.estimate` are to be trusted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from bayescal.report.blocks import Cell, Column, Table, make_table
from bayescal.report.numbers import format_fixed


def tabulate_diagnostics(caption: str, variants: Iterable[Mapping[str, Any]]) -> Table:
    """Return both log-evidences and the chains' diagnostics of variants, a row each."""
    columns = [Column("Variant", kind="text"), Column("importance", group="log-evidence")]
    columns += [Column("bridge", group="log-evidence"), Column("Efficiency"), Column("Pareto k")]
    columns += [Column("R-hat, largest"), Column("bulk, least", group="ESS"), Column("tail, least", group="ESS")]
    columns += [Column("Converged", kind="text")]
    rows: list[list[str | Cell]] = [
        [
            str(row["title"]),
            format_fixed(row["log_evidence_importance"], 2),
            format_fixed(row["log_evidence_bridge"], 2),
            format_fixed(row["efficiency"], 2),
            format_fixed(row["pareto_k"], 2),
            format_fixed(row["rhat_max"], 4),
            format_fixed(row["ess_bulk_min"], 0),
            format_fixed(row["ess_tail_min"], 0),
            Cell("yes", "good") if row["converged"] else Cell(row["problems"], "bad"),
        ]
        for row in variants
    ]
    return make_table(caption, columns, rows)
