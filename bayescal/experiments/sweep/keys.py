"""Values by dotted keys: set in a config, found in a summary."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from typing import Any

from bayescal.errors import InputError

type Setting = tuple[str, str, Any]
"""File, empty for the experiment itself, dotted key, and value."""


def split_key(key: str) -> tuple[str, str]:
    """Return the file that a key stands in, empty for the experiment itself, and the key within."""
    file, colon, inner = key.partition(":")
    return (file, inner) if colon else ("", key)


def change(content: Mapping[str, Any], settings: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return a config's content with values set by dotted keys; tables on the way are made where there are none.

    What no key leads through is not copied.

    Raises
    ------
    InputError
        Where a key leads through what is no table, or to an entry that a list has not.
    """
    changed: dict[str, Any] = dict(content)
    for key, value in settings:
        *way, last = key.split(".")
        place: Any = changed
        for part in way:
            place = _enter(place, part, key)
        if isinstance(place, dict):
            place[last] = value
        else:
            _step(place, last, key)
            place[int(last)] = value
    return changed


def _enter(place: Any, part: str, key: str) -> Any:
    """Return a copy of what stands at a part of a key, put in its place."""
    inner = place.get(part, {}) if isinstance(place, dict) else _step(place, part, key)
    own = copy.copy(inner)
    if isinstance(place, dict):
        place[part] = own
    elif isinstance(place, list):
        place[int(part)] = own
    return own


def _step(place: Any, part: str, key: str) -> Any:
    if isinstance(place, dict) and part in place:
        return place[part]
    if isinstance(place, list) and part.isdigit() and int(part) < len(place):
        return place[int(part)]
    raise InputError(f"{key}: found no {part!r} there, expected a key of the config")


def find(content: Mapping[str, Any], key: str) -> Any:
    """Return the value of a dotted key; InputError where there is none."""
    place: Any = content
    for part in key.split("."):
        place = _step(place, part, key)
    return place


def look_up(summary: Any, key: str) -> Any:
    """Return what a summary holds at a dotted key, whose parts may have dots of their own; None for nothing."""
    if not key:
        return summary
    if isinstance(summary, list):
        head, _, rest = key.partition(".")
        return look_up(summary[int(head)], rest) if head.isdigit() and int(head) < len(summary) else None
    if not isinstance(summary, dict):
        return None
    parts = key.split(".")
    for n in range(len(parts), 0, -1):
        head = ".".join(parts[:n])
        if head in summary and (found := look_up(summary[head], ".".join(parts[n:]))) is not None:
            return found
    return None
