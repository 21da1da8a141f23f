"""Which input files and classes a config names."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

from bayescal.config.classes import ClassName
from bayescal.config.registry import list_sources, load_class
from bayescal.config.sections import FileMark, Section


def find_files(section: Section, folder: Path) -> list[str]:
    """Return the names in all fields of a config that are marked as `InputFile`, and the files of its classes."""
    return list(dict.fromkeys(_find(section, folder)))


def find_classes(section: Section, folder: Path) -> list[type]:
    """Return the classes that a config names, those in files relative to a folder."""
    names = [one for one in _walk(section) if isinstance(one, ClassName)]
    return [one.found or load_class(one.registry, one, folder) for one in names]


def _walk(value: Any) -> Iterator[Any]:
    """Yield everything in a section that holds nothing else."""
    if isinstance(value, Section):
        inner: Any = [getattr(value, name) for name in type(value).model_fields]
    elif isinstance(value, dict | list | tuple):
        inner = value.values() if isinstance(value, dict) else value
    else:
        yield value
        return
    for one in inner:
        yield from _walk(one)


def _find(value: Any, folder: Path) -> Iterator[str]:
    if isinstance(value, ClassName):
        yield from list_sources(value.registry, value, folder)
    elif isinstance(value, Section):
        for name, mark in _mark_fields(type(value)).items():
            inner = getattr(value, name)
            if isinstance(inner, str) and mark is not None:
                yield from (() if inner in mark.but else (inner,))
            else:
                yield from _find(inner, folder)
    elif isinstance(value, dict | list | tuple):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _find(one, folder)


@cache
def _mark_fields(section: type[Section]) -> dict[str, FileMark | None]:
    """Return the fields of a section with the marks of those that may name a file."""
    found = {}
    for name, field in section.model_fields.items():
        marks = [*field.metadata, *_list_metadata(field.annotation)]
        found[name] = next((one for one in marks if isinstance(one, FileMark)), None)
    return found


def _list_metadata(annotation: Any) -> Iterator[Any]:
    """Yield what annotations say beside types, inside unions too."""
    if get_origin(annotation) is Annotated:
        yield from get_args(annotation)[1:]
    for one in get_args(annotation):
        yield from _list_metadata(one)
