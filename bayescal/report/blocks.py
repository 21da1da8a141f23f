"""What a page is made of: statements, tables, figures and folds, all text, nothing of how it looks."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import TYPE_CHECKING, ClassVar, Literal

from bayescal.report.scene import Scene

if TYPE_CHECKING:  # it takes a second to import, and only pages that are drawn need it
    from matplotlib import figure as mpl

type Level = Literal["plain", "good", "warning", "bad"]

FIGURE_NAME = re.compile(r"[A-Za-z0-9_-]+")

MOST_FINDINGS = 5
URGENCY = {"bad": 0, "warning": 1}


@dataclass(frozen=True)
class Statement:
    """A sentence computed from the numbers, how good the news is, and the word it is found by."""

    block: ClassVar = "statement"
    text: str
    level: Level = "plain"
    lead: str = ""


# --- tables ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    title: str
    unit: str = ""  # shown below the title
    group: str = ""  # neighbours of the same group share a heading
    # ``number`` columns are right-aligned, ``symbol`` columns are set as the field writes the symbol; ``seconds`` are
    # wall times, the only numbers that differ between runs of the same config
    kind: Literal["number", "text", "name", "symbol", "seconds"] = "number"
    symbolic: bool = False  # whether the title is a parameter's symbol


@dataclass(frozen=True)
class Cell:
    """Text of a table."""

    text: str
    level: Level = "plain"
    span: int = 1  # how many rows it covers, zero where the cell above covers it
    badge: bool = False  # whether the text stands on a coloured ground, as a mark does
    more: str = ""  # what the text opens on a click; in print it is open


@dataclass(frozen=True)
class Table:
    """A table with its caption."""

    block: ClassVar = "table"
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[Statement, ...] = ()  # below the table
    # ``wide`` tables are set smaller, ``long`` ones join the rows of a parameter, ``claims`` have fixed widths
    style: str = ""
    # headings over groups of rows, by the number of the row that follows
    headings: Mapping[int, str] = field(default_factory=dict)

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Headings over neighbouring columns and how many they cover; empty without any."""
        if not any(column.group for column in self.columns):
            return []
        return [(group, len(list(members))) for group, members in groupby(self.columns, key=lambda c: c.group)]


def make_table(
    caption: str,
    columns: Sequence[Column],
    rows: Sequence[Sequence[str | Cell]],
    notes: Sequence[Statement] = (),
    style: str = "",
) -> Table:
    """Return a table whose plain strings have become cells."""
    cells = tuple(tuple(Cell(c) if isinstance(c, str) else c for c in row) for row in rows)
    return Table(caption, tuple(columns), cells, tuple(notes), style)


def make_pairs(caption: str, rows: Sequence[Sequence[str | Cell]], notes: Sequence[Statement] = ()) -> Table:
    """Return a table of questions and answers, without headings."""
    return make_table(caption, (Column("", kind="text"), Column("", kind="text")), rows, notes)


# --- figures -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Figure:
    """A figure with its caption, or the reason why it cannot be drawn."""

    block: ClassVar = "figure"
    name: str  # of its file in ``figures``, without the ending; letters, digits, ``_`` and ``-``
    caption: str
    draw: Callable[[], mpl.Figure] | None  # draws it; None where it is left out
    reason: str = ""  # why it is left out

    def __post_init__(self) -> None:
        """Check the name: a file is called by it."""
        if not FIGURE_NAME.fullmatch(self.name):
            raise ValueError(f"figure {self.name!r}: expected letters, digits, _ and -")


# --- other blocks ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Heading:
    """A heading within a section."""

    block: ClassVar = "heading"
    text: str


@dataclass(frozen=True)
class Absent:
    """Why something is not there."""

    block: ClassVar = "absent"
    text: str


@dataclass(frozen=True)
class Counts:
    """Marks in a row behind a title."""

    block: ClassVar = "counts"
    title: str
    marks: tuple[Cell, ...]


@dataclass(frozen=True)
class Preformatted:
    """Text as it stands, such as a config."""

    block: ClassVar = "preformatted"
    text: str


@dataclass(frozen=True)
class Definitions:
    """Questions with their answers."""

    block: ClassVar = "definitions"
    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Side:
    """Tables side by side where there is room."""

    block: ClassVar = "side"
    tables: tuple[Table, ...]


@dataclass(frozen=True)
class Card:
    """One finding: a parameter's symbol with words and marks, sentences, and more of the kind behind a line."""

    block: ClassVar = "card"
    symbol: str
    where: str
    marks: tuple[Cell, ...]
    text: str
    facts: tuple[str, ...] = ()
    more_title: str = ""
    more: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Fold:
    """Blocks behind a line that opens them; in print they are open."""

    block: ClassVar = "fold"
    title: str
    blocks: tuple[Block, ...]
    is_open: bool = False


type Block = (
    str
    | Statement
    | Table
    | Figure
    | Scene
    | Heading
    | Absent
    | Counts
    | Preformatted
    | Definitions
    | Side
    | Card
    | Fold
)
"""A string is a paragraph."""


# --- the page ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a page with its heading; ``anchor`` is what links lead to, ``short`` what stands in the navigation."""

    title: str
    blocks: tuple[Block, ...]
    anchor: str = ""
    short: str = ""


def make_section(
    title: str,
    text: Sequence[str] = (),
    tables: Sequence[Table] = (),
    figures: Sequence[Figure] = (),
    notes: Sequence[Statement] = (),
    wide: bool = False,
) -> Section:
    """Return a section of paragraphs, then tables, figures and notes; ``wide`` sets the tables smaller."""
    shown = [replace(table, style="wide") for table in tables] if wide else tables
    return Section(title, (*text, *shown, *figures, *notes))


@dataclass(frozen=True, eq=False)
class Page:
    """What the page of an experiment says."""

    # what sort of experiment it is, its own name, and its heading
    kind: str
    name: str
    title: str
    origin: str  # where its data come from: simulated, reconstructed, measured
    headline: str  # the result in one sentence
    # what was found, each with a level; where one is bad the verdict is marked as failed
    verdict: tuple[Statement, ...]
    sections: tuple[Section, ...]
    facts: tuple[tuple[str, str], ...] = ()  # below the heading, such as machine and plan
    failures: tuple[Statement, ...] = ()  # what forbids to rely on the numbers; before the headline
    failures_title: str = ""
    doubtful: bool = False  # whether the verdict is marked as one to be read with care
    symbols: tuple[str, ...] = ()  # parameters' symbols that running text sets as the field writes them

    def __post_init__(self) -> None:
        """Check that no two figures would share a file."""
        names = [figure.name for figure in self.figures()]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"figure {name!r} is twice on the page, expected each name once")

    def add_failures(self, failures: Sequence[Statement]) -> Page:
        """Return the page with more that forbids to rely on the numbers."""
        if not failures:
            return self
        title = self.failures_title or "Do not rely on these results yet. What speaks against them:"
        return replace(self, failures=(*self.failures, *failures), failures_title=title)

    @property
    def failed(self) -> bool:
        """Whether there is bad news."""
        return bool(self.failures) or any(statement.level == "bad" for statement in self.verdict)

    def figures(self) -> Iterator[Figure]:
        """Yield the figures of all sections, folded ones too."""
        blocks = (block for section in self.sections for block in unfold(section.blocks))
        return (block for block in blocks if isinstance(block, Figure))

    def shown_figures(self) -> set[str]:
        """Return the names of the figures that no fold hides at first sight."""
        blocks = [block for section in self.sections for block in section.blocks]
        opened = [inner for block in blocks if isinstance(block, Fold) and block.is_open for inner in block.blocks]
        return {block.name for block in (*blocks, *opened) if isinstance(block, Figure)}


def unfold(blocks: Sequence[Block]) -> Iterator[Block]:
    """Yield blocks, and those inside their folds."""
    for block in blocks:
        yield block
        if isinstance(block, Fold):
            yield from unfold(block.blocks)


def choose_first(findings: Sequence[Statement]) -> tuple[list[Statement], list[Statement]]:
    """Return what stands in the verdict at first sight and what is folded, both in their order.

    At most five are seen: bad news before warnings, warnings before the rest, else what comes first.
    """
    ranked = sorted(range(len(findings)), key=lambda k: (URGENCY.get(findings[k].level, 2), k))
    first = set(ranked[:MOST_FINDINGS])
    return [findings[k] for k in sorted(first)], [findings[k] for k in sorted(set(ranked) - first)]


def count_folded(folded: Sequence[Statement]) -> str:
    """Return where the rest of the findings is, in a line of the terminal."""
    return f"{len(folded)} more finding{'s' if len(folded) > 1 else ''} in the report"
