"""Parts of a page that stand outside the package: any experiment's config may name them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path

from bayescal.config.registry import find_class, is_file, list_sources
from bayescal.config.trust import check_same
from bayescal.experiments.runner.kept_inputs import find_config
from bayescal.experiments.runner.losses import attempt, note, note_losses
from bayescal.experiments.runner.results import Results
from bayescal.report.blocks import Page, PageSection


class PageBlock(ABC):
    """A part of a page, made from results alone: ``blocks = ["file.py:Class"]`` in a config adds it to the page.

    Examples
    --------
    >>> class Poses(PageBlock):
    ...     def show(self, results):
    ...         found = results.tables.get("poses")
    ...         return None if found is None else make_section("Poses", (f"{len(found)} poses.",))
    """

    @abstractmethod
    def show(self, results: Results) -> PageSection | None:
        """Return a section of the page; None where these results have nothing for it."""


def find_blocks(names: Iterable[str], file: Path | None, folder: Path | None) -> list[PageBlock]:
    """Return the blocks that a config names; InputError for what is none. See `registry.find_class`."""
    base: type[PageBlock] = PageBlock  # type: ignore[type-abstract]  # only subclasses of it are found
    return [find_class("BLOCKS", name, base, "page_sections", file, folder)() for name in names]


def show_sections[S](blocks: Iterable[Callable[[S], PageSection | None]], subject: S) -> tuple[PageSection, ...]:
    """Return what blocks of a page show of something; one that fails costs its section, in which the reason stands."""
    shown = (_show(_name(block), partial(block, subject)) for block in blocks)
    return tuple(one for one in shown if one is not None)


def _name(block: Callable[..., PageSection | None]) -> str:
    """Return what a block shows, by the name of its function."""
    function = block.func if isinstance(block, partial) else block
    return str(getattr(function, "__name__", type(function).__name__)).removeprefix("show_").replace("_", " ")


def add_blocks(page: Page, results: Results, blocks: Iterable[PageBlock]) -> Page:
    """Return a page with what some blocks show of the results; of one that fails, why."""
    shown = (_show(type(one).__name__, partial(one.show, results)) for one in blocks)
    return replace(page, sections=(*page.sections, *(one for one in shown if one is not None)))


def _show(name: str, show: Callable[[], PageSection | None]) -> PageSection | None:
    what = f"section {name!r} of the page"
    with note_losses() as losses:
        found = attempt(what, show, None)
    kept = [note(one) for one in losses]  # where somebody collects, who says so
    return PageSection(f"{name[0].upper()}{name[1:]}", tuple(one.say() for one in losses)) if kept else found


def find_kept(results: Results, what: str, name: str) -> Path | None:
    """Return the folder in which results keep a user-defined class; InputError unless it is theirs.

    Of one that stands in no file the folder of the results.
    """
    if not is_file(name) or results.folder is None:
        return results.folder
    folder = find_config(results.folder, results.provenance).parent
    check_same(folder, list_sources(what, name, folder), results.hashes)
    return folder
