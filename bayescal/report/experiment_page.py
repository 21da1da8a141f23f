"""The page of a small experiment: a verdict, then sections of text, tables and figures, all in one file."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from bayescal.report.blocks import FigureBlock, Statement, Table
from bayescal.report.page import render_png, render_template, set_prose, write_page

PAGE = "report.html"
FIGURES = "figures"
NAME = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True, eq=False)
class PageFigure:
    """A figure with its caption.

    Attributes
    ----------
    name : str
        Of its file in ``figures``, without the ending; letters, digits, ``_`` and ``-``.
    caption : str
    image : bytes, Figure or callable
        A PNG; or a figure; or what draws one, which then has the report's style.
    """

    name: str
    caption: str
    image: bytes | Figure | Callable[[], Figure]

    def __post_init__(self) -> None:
        """Check the name: a file is called by it."""
        if not NAME.fullmatch(self.name):
            raise ValueError(f"figure {self.name!r}: expected letters, digits, _ and -")

    def png(self) -> bytes:
        """Return the figure as PNG; the same figure gives the same bytes."""
        image = self.image
        if isinstance(image, bytes):
            return image
        return render_png((lambda: image) if isinstance(image, Figure) else image)


@dataclass(frozen=True, eq=False)
class PageSection:
    """A part of the page: paragraphs, then tables, then figures; ``wide`` sets the tables smaller."""

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[PageFigure, ...] = ()
    notes: tuple[Statement, ...] = ()
    wide: bool = False


@dataclass(frozen=True, eq=False)
class ExperimentPage:
    """What the page of an experiment says.

    Attributes
    ----------
    kind, name, title : str
        What sort of experiment it is, its own name, and its heading.
    origin : str
        Where its data come from: simulated, reconstructed, measured.
    headline : str
        The result in one sentence.
    verdict : tuple of Statement
        What was found, each with a level; where one is bad the verdict is marked as failed.
    sections : tuple of PageSection
    facts : tuple of (str, str)
        Below the heading, such as machine and plan.
    """

    kind: str
    name: str
    title: str
    origin: str
    headline: str
    verdict: tuple[Statement, ...]
    sections: tuple[PageSection, ...]
    facts: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        """Check that no two figures would share a file."""
        names = [figure.name for section in self.sections for figure in section.figures]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"figure {name!r} stands twice on the page, expected each name once")

    @property
    def failed(self) -> bool:
        """Whether the verdict has bad news."""
        return any(statement.level == "bad" for statement in self.verdict)


@dataclass(frozen=True, eq=False)
class _Context:
    """The page with its figures drawn."""

    page: ExperimentPage
    figures: dict[str, FigureBlock]

    @property
    def title(self) -> str:
        return self.page.title


def write_experiment_page(page: ExperimentPage, folder: Path) -> Path:
    """Write ``figures/*.png`` and ``report.html`` into a directory.

    Returns
    -------
    Path
        The page; it holds its figures and its style and refers to no other file.
    """
    images = {f.name: (f, f.png()) for section in page.sections for f in section.figures}
    blocks = {}
    for name, (figure, image) in images.items():
        (folder / FIGURES).mkdir(exist_ok=True)
        (folder / FIGURES / f"{name}.png").write_bytes(image)
        source = f"data:image/png;base64,{base64.b64encode(image).decode('ascii')}"
        blocks[name] = FigureBlock(name, figure.caption, source)
    text = render_template(
        "experiment.html", set_prose, ("report.css", "experiment.css"), report=_Context(page, blocks)
    )
    return write_page(folder / PAGE, text)
