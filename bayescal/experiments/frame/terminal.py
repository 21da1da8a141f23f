"""Tables on a terminal: columns are left out by its width, and nothing that is shown is cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from rich.console import Console
from rich.table import Table

from bayescal.report.blocks import Page
from bayescal.report.findings import choose_first, count_folded
from bayescal.report.numbers import join_words

UNBOUNDED = 10_000  # letters


@dataclass(frozen=True)
class Shown:
    """A column of a table on a terminal.

    Attributes
    ----------
    title : str
    rank : int
        Columns of the largest rank are left out first; those of rank zero never.
    justify : str
    """

    title: str
    rank: int = 0
    justify: Literal["left", "right"] = "right"


def print_table(console: Console, columns: Sequence[Shown], rows: Sequence[Sequence[str]], width: int = 0) -> None:
    """Print a table with the columns that have room, and say which have none.

    Parameters
    ----------
    console : Console
    columns : sequence of Shown
    rows : sequence of sequences of str
        A text for each column.
    width : int
        In letters; that of the console by default.
    """
    room, kept = width or console.width, list(range(len(columns)))
    table = _build(columns, rows, kept)
    unbounded = console.options.update(max_width=UNBOUNDED)
    while console.measure(table, options=unbounded).maximum > room and any(columns[k].rank for k in kept):
        kept.remove(max(kept, key=lambda k: (columns[k].rank, k)))
        table = _build(columns, rows, kept)
    console.print(table, width=room)
    left = [column.title for k, column in enumerate(columns) if k not in kept]
    if left:
        console.print(f"no room here for: {join_words(left)} (in the report)", width=room)


def _build(columns: Sequence[Shown], rows: Sequence[Sequence[str]], kept: Sequence[int]) -> Table:
    table = Table()
    for k in kept:
        table.add_column(columns[k].title, justify=columns[k].justify, overflow="fold")
    for row in rows:
        table.add_row(*(row[k] for k in kept))
    return table


def print_text(console: Console, text: str) -> None:
    """Print a sentence, broken between words on a terminal and on one line in a file."""
    console.print(text, soft_wrap=not console.is_terminal)


def show_verdict(page: Page, console: Console) -> None:
    """Print a page's headline and what of its verdict is seen at first sight."""
    print_text(console, page.headline)
    seen, folded = choose_first(page.verdict)
    for one in seen:
        print_text(console, f"{one.lead}: {one.text}" if one.lead else one.text)
    if folded:
        print_text(console, count_folded(folded))
