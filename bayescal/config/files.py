"""Which input files a config names."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, get_args, get_origin

from bayescal.config.sections import FileMark, Section


def find_files(section: Section) -> list[str]:
    """Return the names in all fields of a config that are marked as `InputFile`."""
    return list(dict.fromkeys(_find(section)))


def _find(value: Any) -> Iterator[str]:
    if isinstance(value, Section):
        for name, field in type(value).model_fields.items():
            inner = getattr(value, name)
            marks = [*field.metadata, *_list_metadata(field.annotation)]
            mark = next((one for one in marks if isinstance(one, FileMark)), None)
            if isinstance(inner, str) and mark is not None:
                yield from (() if inner in mark.but else (inner,))
            else:
                yield from _find(inner)
    elif isinstance(value, dict | list | tuple):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _find(one)


def _list_metadata(annotation: Any) -> Iterator[Any]:
    """Yield what annotations say beside types, inside unions too."""
    if get_origin(annotation) is Annotated:
        yield from get_args(annotation)[1:]
    for one in get_args(annotation):
        yield from _list_metadata(one)
