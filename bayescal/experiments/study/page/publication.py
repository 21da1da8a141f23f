"""The publication whose machine, tables and figures a study repeats; a study of anybody's machine has none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayescal.experiments.frame.results import Kinds, check_keys

KEYS: dict[str, Kinds] = {"source": str, "citation": str, "figures": dict, "notation": dict}


@dataclass(frozen=True)
class Publication:
    """What a page refers to.

    Attributes
    ----------
    source : str
        As the page calls it, ``RR-8096``.
    citation : str
        A sentence by which it is found.
    figures : mapping of str to str
        By the names of the page's figures, what each is after: ``figure 15``.
    notation : mapping of str to str
        By symbol, where it is defined: ``eq. 1``.
    """

    source: str
    citation: str
    figures: Mapping[str, str]
    notation: Mapping[str, str]


def read_publication(summary: Mapping[str, Any], path: Path) -> Publication | None:
    """Return what a summary says of the publication, None where it says nothing; InputError where that is at fault."""
    if "publication" not in summary:
        return None
    check_keys(summary, {"publication": dict}, path, "")
    content = summary["publication"]
    check_keys(content, KEYS, path, "publication.")
    for key in ("figures", "notation"):
        check_keys(content[key], dict.fromkeys(content[key], str), path, f"publication.{key}.")
    return Publication(**{key: content[key] for key in KEYS})


def cite_figure(publication: Publication | None, name: str) -> str:
    """Return what a figure is after, in brackets behind a space; nothing where it is after none."""
    place = publication.figures.get(name) if publication else None
    return f" (after {publication.source} {place})" if publication and place else ""


def cite_symbol(publication: Publication | None, symbol: str) -> str:
    """Return where a symbol is defined, in brackets behind a space; nothing where no source says so."""
    place = publication.notation.get(symbol) if publication else None
    return f" ({publication.source} {place})" if publication and place else ""
