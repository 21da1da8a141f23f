"""What an audit says on the terminal: its verdict, what is known of each symbol, and the requirements."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from rich.console import Console, RenderableType
from rich.table import Table as Grid

from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.tables import tabulate_symbols
from bayescal.experiments.audit.page.wording import (
    format_probability,
    format_sd,
    format_share,
    name_requirement,
    name_unit,
)
from bayescal.experiments.runner.results import Results
from bayescal.experiments.runner.terminal import TerminalColumn, print_table
from bayescal.limits import COVERAGE
from bayescal.report.blocks import Page, Table, choose_first, count_folded
from bayescal.report.numbers import NO_VALUE, format_plain, format_significant
from bayescal.report.symbols import write_symbol

type Printed = tuple[Sequence[TerminalColumn], Sequence[Sequence[str]]]

MARKS = {"good": "+", "plain": " ", "warning": "!", "bad": "x"}
MOST_WIDTH, FILE_WIDTH = 120, 100


def show_audit(results: Results, page: Page, console: Console) -> None:
    """Print the verdict of an audit's page, what is known of each symbol, and the requirements."""
    audit, written = AuditResults.of(results), {symbol: write_symbol(symbol) for symbol in page.symbols}
    width = min(MOST_WIDTH if console.is_terminal else FILE_WIDTH, console.width)
    lines: list[RenderableType] = [page.title]
    lines += [f"DO NOT USE: {failure.text}" for failure in page.failures]
    lines.append(page.headline)
    seen, folded = choose_first(page)
    for statement in seen:
        text = re.sub(r"(?<![\w.])[A-Za-z]\w*", lambda found: written.get(found[0], found[0]), statement.said)
        grid = Grid.grid(padding=(0, 1))
        grid.add_row(MARKS[statement.level], f"{statement.lead}: {text}")
        lines.append(grid)
    for one in [*lines, count_folded(folded)] if folded else lines:
        console.print(one, width=width, markup=False, highlight=False)
    symbols = _take(tabulate_symbols(audit), {0: 0, 1: 0, 2: 1, 3: 0, 5: 2, 6: 0})
    for columns, rows in [
        *_tabulate_variants(audit),
        symbols,
        *_tabulate_sets(audit),
        *_tabulate_requirements(audit),
    ]:
        print_table(console, columns, rows, width)


def _take(table: Table, ranks: Mapping[int, int]) -> Printed:
    """Return some columns of a page's table with their ranks; see `TerminalColumn`."""
    chosen = {k: table.columns[k] for k in ranks}
    shown = [
        TerminalColumn(one.title.lower(), ranks[k], "right" if one.kind == "number" else "left")
        for k, one in chosen.items()
    ]
    rows = [
        [write_symbol(row[k].text) if one.kind == "symbol" else row[k].text for k, one in chosen.items()]
        for row in table.rows
    ]
    return shown, rows


def _tabulate_variants(audit: AuditResults) -> list[Printed]:
    """Return how sets of sensors compare; nothing of a single one."""
    columns = (
        TerminalColumn("variant", justify="left"),
        TerminalColumn("free"),
        TerminalColumn("equations", 2),
        TerminalColumn("identifiable"),
        TerminalColumn("error, posterior / prior", 1),
        TerminalColumn("requirements"),
    )
    rows = []
    for row in audit.variants:
        numbers = map(str, (row.n_parameters, row.n_equations, row.n_identifiable))
        rows.append((row.variant, *numbers, format_share(row.error_ratio), format_probability(row.probability)))
    return [(columns, rows)] if len(rows) > 1 else []


def _tabulate_sets(audit: AuditResults) -> list[Printed]:
    """Return how true the claims of everything free and of the reduced set are; nothing without a reduced set."""
    reduced, n = audit.summary["reduced_set"], len(audit.parameters)
    if reduced is None or len(reduced["free"]) == n:
        return []
    columns = (
        TerminalColumn("free", justify="left"),
        TerminalColumn("parameters", 1),
        TerminalColumn("RMSE / predicted sd"),
        TerminalColumn("90 % coverage"),
        TerminalColumn("simulated", 2),
    )
    rows = []
    for name, free, z, coverage, key in (
        ("everything", n, 1.0, COVERAGE, ""),
        ("reduced set", len(reduced["free"]), reduced["rms_z"], reduced["coverage_90"], "_reduced"),
    ):
        simulated = audit.summary.get(f"simulated_calibrations{key}")
        found = NO_VALUE if simulated is None else format_share(simulated["coverage_90"])
        rows.append((name, str(free), format_significant(z, 2), format_share(coverage), found))
    return [(columns, rows)]


def _tabulate_requirements(audit: AuditResults) -> list[Printed]:
    """Return how each requirement is met; nothing where none is stated."""
    columns = (
        TerminalColumn("requirement", justify="left"),
        TerminalColumn("limit"),
        TerminalColumn("predicted sd"),
        TerminalColumn("of limit", 1),
        TerminalColumn("probability"),
        TerminalColumn("before", 2),
    )
    rows = [
        (
            name_requirement(r.requirement),
            f"{format_plain(r.limit)} {name_unit(r.unit)}",
            f"{format_sd(r.predicted_sd)} {name_unit(r.unit)}",
            format_share(r.predicted_sd / r.limit),
            format_probability(r.probability),
            format_probability(r.prior_probability),
        )
        for r in audit.requirements
    ]
    return [(columns, rows)] if rows else []
