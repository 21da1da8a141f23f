"""What an audit says on the terminal: its verdict, what is known of each symbol, and the requirements."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from rich.console import Console, RenderableType
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
from bayescal.experiments.frame.results import Results
from bayescal.experiments.frame.terminal import Shown, print_table
from bayescal.limits import COVERAGE
from bayescal.report.blocks import choose_first, count_folded
from bayescal.report.numbers import NOTHING, format_plain, format_significant
from bayescal.report.symbols import write_symbol

type Printed = tuple[Sequence[Shown], Sequence[Sequence[str]]]

MARKS = {"good": "+", "plain": " ", "warning": "!", "bad": "x"}
MOST_WIDTH, FILE_WIDTH = 120, 100


def show_audit(results: Results, console: Console) -> None:
    """Print the verdict of an audit, what is known of each symbol, and the requirements."""
    audit = AuditResults.of(results)
    width = min(MOST_WIDTH if console.is_terminal else FILE_WIDTH, console.width)
    for one in _list_lines(audit):
        console.print(one, width=width, markup=False, highlight=False)
    tables = [*_tabulate_variants(audit), _tabulate_symbols(audit)]
    for columns, rows in [*tables, *_tabulate_sets(audit), *_tabulate_requirements(audit)]:
        print_table(console, columns, rows, width)


def _list_lines(audit: AuditResults) -> list[RenderableType]:
    """Return the verdict, its headline first."""
    lines: list[RenderableType] = [audit.summary["title"]]
    lines += [f"DO NOT RELY ON THIS: {failure.text}" for failure in list_failures(audit)]
    lines.append(state_headline(audit))
    seen, folded = choose_first(state_verdict(audit))
    for statement in seen:
        grid = Table.grid(padding=(0, 1))
        grid.add_row(MARKS[statement.level], f"{statement.lead}: {_write_symbols(statement.text, audit.symbols)}")
        lines.append(grid)
    return [*lines, count_folded(folded)] if folded else lines


def _write_symbols(text: str, symbols: list[str]) -> str:
    """Return text with Greek letters as such."""
    written = {symbol: write_symbol(symbol) for symbol in symbols}
    return re.sub(r"(?<![\w.])[A-Za-z]\w*", lambda found: written.get(found[0], found[0]), text)


def _tabulate_variants(audit: AuditResults) -> list[Printed]:
    """Return how sets of sensors compare; nothing of a single one."""
    variants = audit.summary.get("variants", {})
    if len(variants) < 2:
        return []
    columns = (
        Shown("variant", justify="left"),
        Shown("free"),
        Shown("equations", 2),
        Shown("identifiable"),
        Shown("error left", 1),
        Shown("requirements"),
    )
    rows = []
    for name, row in variants.items():
        left, chance = (float("nan") if row[key] is None else row[key] for key in ("left", "probability"))
        numbers = [str(row[key]) for key in ("n_parameters", "n_equations", "n_identifiable")]
        rows.append((name, *numbers, format_share(left), format_probability(chance)))
    return [(columns, rows)]


def _tabulate_symbols(audit: AuditResults) -> Printed:
    columns = (
        Shown("symbol", justify="left"),
        Shown("unit", justify="left"),
        Shown("tolerance", 1),
        Shown("remains"),
        Shown("contraction", 2),
        Shown("verdict", justify="left"),
    )
    rows = []
    for symbol, group in audit.parameters.groupby("symbol", sort=False):
        counts = Counter(name_verdict(row) for _, row in group.iterrows()).most_common()
        verdicts = [f"{n} {verdict}" if len(counts) > 1 else verdict for verdict, n in counts]
        rows.append(
            (
                write_symbol(str(symbol)),
                name_unit(str(group["unit"].iloc[0])),
                format_range(list(group["prior_sd"]), format_sd),
                format_range(list(group["posterior_sd"]), format_sd),
                format_range(list(group["contraction"]), format_contraction),
                ", ".join(verdicts),
            )
        )
    return columns, rows


def _tabulate_sets(audit: AuditResults) -> list[Printed]:
    """Return how true the claims of everything free and of the reduced set are; nothing without a reduced set."""
    reduced = audit.summary["reduced_set"]
    if reduced is None or len(reduced["free"]) == len(audit.parameters):
        return []
    columns = (
        Shown("free", justify="left"),
        Shown("parameters", 1),
        Shown("true error / claimed sd, rms"),
        Shown("90 % intervals hold"),
        Shown("simulated", 2),
    )
    rows = []
    for name, n, z, coverage, key in (
        ("everything", len(audit.parameters), 1.0, COVERAGE, "simulated_calibrations"),
        (
            "reduced set",
            len(reduced["free"]),
            reduced["rms_z"],
            reduced["coverage_90"],
            "simulated_calibrations_reduced",
        ),
    ):
        simulated = audit.summary.get(key)
        found = NOTHING if simulated is None else format_share(simulated["coverage_90"])
        rows.append((name, str(n), format_significant(z, 2), format_share(coverage), found))
    return [(columns, rows)]


def _tabulate_requirements(audit: AuditResults) -> list[Printed]:
    """Return how each requirement stands; nothing where none is stated."""
    columns = (
        Shown("requirement", justify="left"),
        Shown("limit"),
        Shown("predicted sd"),
        Shown("of limit", 1),
        Shown("probability"),
        Shown("before", 2),
    )
    rows = []
    for r in audit.requirements:
        unit = name_unit(r.unit)
        rows.append(
            (
                name_requirement(r.name),
                f"{format_plain(r.limit)} {unit}",
                f"{format_sd(r.predicted_sd)} {unit}",
                format_share(r.predicted_sd / r.limit),
                format_probability(r.probability),
                format_probability(r.prior_probability),
            )
        )
    return [(columns, rows)] if rows else []
