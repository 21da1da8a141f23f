"""Where a key of a TOML file stands: tomllib keeps no lines, messages need them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence

type Location = tuple[str | int, ...]

_TABLE = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(r"^\s*([\w.\-\"']+)\s*=")


def find_line(text: str, location: Sequence[str | int]) -> int | None:
    """Return the line of a location, or of the table or list that it stands in; None where neither is in the text.

    Entries of lists are counted from zero. A key of an inline table is on the line of that table, unless one row of the
    text alone has it.
    """
    lines = dict(reversed(list(_list_locations(text))))
    for depth in range(len(location), 0, -1):
        if line := lines.get(tuple(location[:depth])):
            return _find_inside(text, line, location[depth:])
    return None


def _list_locations(text: str) -> Iterator[tuple[Location, int]]:
    """Return the tables and keys of a text with their lines, in order."""
    table: Location = ()
    counts: Counter[Location] = Counter()
    for line, row in enumerate(text.splitlines(), start=1):
        if header := _TABLE.match(row):
            table = _enter(_split(header[2]), len(header[1]) == 2, counts)
            yield table, line
            if len(header[1]) == 2:
                yield table[:-1], line
        elif key := _KEY.match(row):
            yield (*table, *_split(key[1])), line


def _split(name: str) -> list[str]:
    return [part.strip().strip("\"'") for part in name.split(".")]


def _enter(names: Sequence[str], is_list: bool, counts: Counter[Location]) -> Location:
    """Return the location of a table; the last entry of a list is meant where a part of its name is one."""
    here: Location = ()
    for depth, name in enumerate(names, start=1):
        here = (*here, name)
        if is_list and depth == len(names):
            counts[here] += 1
        if counts[here]:
            here = (*here, counts[here] - 1)
    return here


def _find_inside(text: str, line: int, rest: Sequence[str | int]) -> int:
    """Return the only row below a line that begins an inline table with the key that is looked for, or the line."""
    keys = [part for part in rest if isinstance(part, str)]
    if not keys:
        return line
    rows = [
        k for k, row in enumerate(text.splitlines(), start=1) if re.search(rf"[{{,]\s*{re.escape(keys[-1])}\s*=", row)
    ]
    return rows[0] if len(rows) == 1 and rows[0] > line else line
