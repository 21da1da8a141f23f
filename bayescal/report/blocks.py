"""What a page is made of: statements, tables, figures and folds, all text, nothing of how it looks."""

from __future__ import annotations

import math
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

MAX_SENTENCES_FIRST = 8
"""Sentences above the first figure of a page; the rest is folded."""
MIN_FINDINGS_FIRST = 2
MAX_FAILURES_FIRST = 3
URGENCY = {"bad": 0, "warning": 1}
SENTENCE_END = re.compile(r"[.!?][)”’]?(?=\s+[A-Z“]|\s*$)")


@dataclass(frozen=True)
class Statement:
    """A sentence computed from the numbers, how good the news is, and the word it is found by.

    As a finding it may state the figure that it rests on, the limit of that, their unit, and what to do.
    """

    block: ClassVar = "statement"
    text: str
    level: Level = "plain"
    lead: str = ""
    value: float = math.nan
    limit: float = math.nan
    unit: str = ""
    action: str = ""

    @property
    def said(self) -> str:
        """The text, and what to do."""
        return f"{self.text} {self.action}".rstrip()


@dataclass(frozen=True)
class KeyFigure:
    """A figure that the page begins with: its colour follows how good it is."""

    label: str
    value: str
    unit: str = ""
    status: Level = "plain"


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
class PageSection:
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
) -> PageSection:
    """Return a section of paragraphs, then figures, tables and notes; ``wide`` sets the tables smaller."""
    shown = [replace(table, style="wide") for table in tables] if wide else tables
    return PageSection(title, (*text, *figures, *shown, *notes))


@dataclass(frozen=True, eq=False)
class Page:
    """What the page of an experiment says."""

    # what sort of experiment it is, its own name, and its heading
    kind: str
    name: str
    title: str
    origin: str  # where its data come from: simulated, reconstructed, measured
    headline: str  # what to use, how accurate it is, what to do next: at most three sentences
    # what was found, each with a level; where one is bad the verdict is marked as failed
    verdict: tuple[Statement, ...]
    sections: tuple[PageSection, ...]
    facts: tuple[tuple[str, str], ...] = ()  # below the heading, such as machine and plan
    failures: tuple[Statement, ...] = ()  # what forbids to rely on the numbers; before the headline
    unreliable: bool = False  # whether the verdict is marked as one to be read with care
    symbols: tuple[str, ...] = ()  # parameters' symbols that running text sets as the field writes them
    key_figures: tuple[KeyFigure, ...] = ()  # four to six, in the first row of the page

    def __post_init__(self) -> None:
        """Check that no two figures would share a file."""
        names = [figure.name for figure in self.figures()]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"figure {name!r} is twice on the page")

    def add_failures(self, failures: Sequence[Statement]) -> Page:
        """Return the page with more that forbids to rely on the numbers."""
        if not failures:
            return self
        return replace(self, failures=(*self.failures, *failures))

    @property
    def level(self) -> Level:
        """How good the news is: the worst of what was found; plain where nothing is good or bad."""
        levels = {one.level for one in self.verdict} | ({"warning"} if self.unreliable else set())
        if self.failures or "bad" in levels:
            return "bad"
        return "warning" if "warning" in levels else "good" if "good" in levels else "plain"

    def figures(self) -> Iterator[Figure]:
        """Yield the figures of all sections, folded ones too."""
        blocks = (block for section in self.sections for block in unfold(section.blocks))
        return (block for block in blocks if isinstance(block, Figure))


def unfold(blocks: Sequence[Block]) -> Iterator[Block]:
    """Yield blocks, and those inside their folds."""
    for block in blocks:
        yield block
        if isinstance(block, Fold):
            yield from unfold(block.blocks)


def count_sentences(text: str) -> int:
    """Return how many sentences a text has; one without a full stop counts as one."""
    return max(len(SENTENCE_END.findall(text.strip())), 1 if text.strip() else 0)


def choose_first(page: Page) -> tuple[list[Statement], list[Statement]]:
    """Return the findings of a page that are seen at first sight and those that are folded, both in their order.

    With headline and failures they come to `MAX_SENTENCES_FIRST` sentences: bad news before warnings, warnings before
    the rest, else what comes first.
    """
    findings = page.verdict
    room = MAX_SENTENCES_FIRST - count_sentences(page.headline)
    room = max(room - min(len(page.failures), MAX_FAILURES_FIRST), MIN_FINDINGS_FIRST)
    first = set[int]()
    for k in sorted(range(len(findings)), key=lambda k: (URGENCY.get(findings[k].level, 2), k)):
        room -= count_sentences(findings[k].text) + bool(findings[k].action)
        if room < 0:
            break
        first.add(k)
    return [findings[k] for k in sorted(first)], [one for k, one in enumerate(findings) if k not in first]


def count_folded(folded: Sequence[Statement]) -> str:
    """Return where the rest of the findings is, in a line of the terminal."""
    return f"{len(folded)} more finding{'s' if len(folded) > 1 else ''} in the report"
