"""What a report page is made of: statements and tables, all text, nothing of how it looks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Literal

type Level = Literal["plain", "good", "warning", "bad"]


@dataclass(frozen=True)
class Statement:
    """A sentence computed from the numbers, how good the news is, and the word it is found by."""

    text: str
    level: Level = "plain"
    lead: str = ""


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    title : str
    unit : str
        Shown below the title.
    group : str
        Neighbours of the same group share a heading.
    kind : str
        ``number`` columns are right-aligned, ``symbol`` columns are set as the field writes the symbol.
    symbolic : bool
        Whether the title is a parameter's symbol.
    """

    title: str
    unit: str = ""
    group: str = ""
    kind: Literal["number", "text", "name", "symbol"] = "number"
    symbolic: bool = False


@dataclass(frozen=True)
class Cell:
    """Text of a table.

    Attributes
    ----------
    text : str
    level : str
    span : int
        How many rows it covers, zero where the cell above covers it.
    badge : bool
        Whether the text stands on a coloured ground, as a mark does.
    more : str
        What the text opens on a click; in print it is open.
    """

    text: str
    level: Level = "plain"
    span: int = 1
    badge: bool = False
    more: str = ""


@dataclass(frozen=True)
class Table:
    """A table with its caption."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[Statement, ...] = ()

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Headings over neighbouring columns and how many they cover; empty without any."""
        if not any(column.group for column in self.columns):
            return []
        return [(group, len(list(members))) for group, members in groupby(self.columns, key=lambda c: c.group)]


@dataclass(frozen=True)
class Fold:
    """Tables behind a line that opens them; in print they are open."""

    title: str
    tables: tuple[Table, ...]
    is_open: bool = False


@dataclass(frozen=True)
class FigureBlock:
    """A figure's place in the report; without data it says why it was left out."""

    name: str
    caption: str
    source: str | None
    reason: str = ""
    section: str = ""


def make_table(
    caption: str,
    columns: Sequence[Column],
    rows: Sequence[Sequence[str | Cell]],
    notes: Sequence[Statement] = (),
) -> Table:
    """Return a table whose plain strings have become cells."""
    cells = tuple(tuple(Cell(c) if isinstance(c, str) else c for c in row) for row in rows)
    return Table(caption, tuple(columns), cells, tuple(notes))
