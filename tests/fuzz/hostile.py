"""Mutations of configs and tables as slips and malice make them; every one is drawn from a generator that is given."""

from __future__ import annotations

import copy
import json
import math
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

type Draw = np.random.Generator

NUMBERS: list[Any] = [
    *(0, -1, 1, 2, 3, 7, 1000, 10**6, 10**9, 10**18, 10**40),
    *(0.0, -1.0, 1e-300, 1e-9, 1e-3, 0.5, 573.0, 1e6, 1e9, -1e9, 1e12, 1e300, math.nan, math.inf, -math.inf),
]
TEXTS = [
    "",
    " ",
    "x",
    "None",
    "../../x",
    "/dev/null",
    ".",
    "a;b",
    "a,b",
    "ψ αβγ 漢字",
    "\u202etxt",
    "<script>alert(1)</script>",
]
TEXTS += [
    "line\nbreak",
    "tab\there",
    "\x07bell",
    "x" * 5000,
    "file.py:Class",
    "os:system",
    "nan",
    "1e9",
    "$HOME",
    "{x}",
    "%s",
]
OTHERS: list[Any] = [True, False, [], {}, [0], [1.0, 2.0], {"x": 1}, [[]], [{}], [1.0] * 400, ["x", "x"]]
NUMBER = re.compile(r"(?<![\w.\"-])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])")
GENTLE = (1.001, 0.99, 0.5, 2.0, 1.0 / 3.0, 5.0, -1.0, 0.0)
FACTORS = (1e3, 1e-3, -1.0, 0.0, 1e6, 57.29577951308232, 25.4)


# --- trees of TOML -------------------------------------------------------------------------------------------------


def dump_toml(content: dict[str, Any]) -> str:
    """Return TOML with an entry of the topmost table a line."""
    return "".join(f"{_key(key)} = {_value(value)}\n" for key, value in content.items())


def _key(key: str) -> str:
    return json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(key)} = {_value(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower() if isinstance(value, bool) else repr(value)


def list_places(tree: Any, before: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the paths of all nodes below a tree's root."""
    inner = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [path for key, one in inner for path in ((*before, key), *list_places(one, (*before, key)))]


def _hold(tree: Any, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        tree = tree[key]
    return tree


def _delete(value: Any, rng: Draw) -> Any:
    del value, rng
    return _delete


def _put(choices: list[Any]) -> Callable[[Any, Draw], Any]:
    return lambda _, rng: copy.deepcopy(choices[rng.integers(len(choices))])


def _scale(value: Any, rng: Draw) -> Any:
    if isinstance(value, list):
        return [_scale(one, rng) for one in value]
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return value * FACTORS[rng.integers(len(FACTORS))] if number else value


def _repeat(value: Any, rng: Draw) -> Any:
    del rng
    return [*value, *value[:1]] if isinstance(value, list) else [value, value]


def _cut(value: Any, rng: Draw) -> Any:
    if isinstance(value, list | str):
        return value[: int(rng.integers(len(value) + 1))]
    return dict(list(value.items())[: int(rng.integers(len(value) + 1))]) if isinstance(value, dict) else [value]


def _turn(value: Any, rng: Draw) -> Any:
    return [value[k] for k in rng.permutation(len(value))] if isinstance(value, list) else str(value)


CHANGES: list[Callable[[Any, Draw], Any]] = [
    *(_delete, _put(NUMBERS), _put(NUMBERS), _put(TEXTS), _put(OTHERS), _scale, _scale, _repeat, _cut, _turn),
]


def change_tree(tree: dict[str, Any], rng: Draw) -> tuple[dict[str, Any], str]:
    """Return a tree with one thing changed, and what."""
    tree = copy.deepcopy(tree)
    places = list_places(tree)
    path = places[rng.integers(len(places))]
    holder = _hold(tree, path)
    kind = rng.random()
    if kind < 0.08:
        other = places[rng.integers(len(places))]
        there = _hold(tree, other)
        holder[path[-1]], value = copy.deepcopy(there[other[-1]]), copy.deepcopy(holder[path[-1]])
        if other[: len(path)] != path and path[: len(other)] != other:
            there[other[-1]] = value
        return tree, f"{path} exchanged with {other}"
    if kind < 0.14 and isinstance(holder, dict):
        name = f"{path[-1]}x" if rng.random() < 0.5 else TEXTS[rng.integers(len(TEXTS))]
        holder[name] = holder[path[-1]] if rng.random() < 0.5 else holder.pop(path[-1])
        return tree, f"{path} also as {name!r}"
    change = CHANGES[rng.integers(len(CHANGES))]
    value = change(holder[path[-1]], rng)
    if value is _delete:
        del holder[path[-1]]
        return tree, f"{path} deleted"
    holder[path[-1]] = value
    return tree, f"{path} = {str(value)[:60]!r}"


# --- tables --------------------------------------------------------------------------------------------------------


def change_table(text: str, rng: Draw) -> tuple[str, str]:
    """Return a CSV text with one thing changed, and what."""
    lines = text.splitlines()
    comments = [line for line in lines if line.startswith("#")]
    rows = [line.split(",") for line in lines if line.strip() and not line.startswith("#")]
    change = TABLE_CHANGES[rng.integers(len(TABLE_CHANGES))]
    said = change(rows, rng)
    return "\n".join([*comments, *(",".join(row) for row in rows)]) + "\n", f"{change.__name__} {said}"


def _cell(rows: list[list[str]], rng: Draw, first: int = 1) -> tuple[int, int]:
    row = int(rng.integers(min(first, len(rows) - 1), len(rows)))
    return row, int(rng.integers(len(rows[row])))


def put_cell(rows: list[list[str]], rng: Draw) -> str:
    """Put something else into a cell."""
    row, column = _cell(rows, rng, 0 if rng.random() < 0.1 else 1)
    choices = [
        *map(str, NUMBERS),
        *(text.replace(",", ";").replace("\n", " ") for text in TEXTS),
        "1_000",
        "1.0.0",
        "0x10",
    ]
    rows[row][column] = choices[rng.integers(len(choices))]
    return f"row {row} column {column} = {rows[row][column][:40]!r}"


def delete_row(rows: list[list[str]], rng: Draw) -> str:
    """Delete a row, perhaps the header."""
    row = int(rng.integers(len(rows)))
    del rows[row]
    return str(row)


def repeat_row(rows: list[list[str]], rng: Draw) -> str:
    """Write a row twice, perhaps all of them."""
    if rng.random() < 0.2:
        rows.extend([list(row) for row in rows[1:]])
        return "all"
    row = int(rng.integers(len(rows)))
    rows.insert(row, list(rows[row]))
    return str(row)


def exchange_rows(rows: list[list[str]], rng: Draw) -> str:
    """Exchange two rows but for their first cells."""
    one, other = (int(k) for k in rng.integers(len(rows), size=2))
    rows[one][1:], rows[other][1:] = rows[other][1:], rows[one][1:]
    return f"{one} and {other}"


def delete_column(rows: list[list[str]], rng: Draw) -> str:
    """Delete a column."""
    column = int(rng.integers(len(rows[0])))
    for row in rows:
        del row[column : column + 1]
    return str(column)


def repeat_column(rows: list[list[str]], rng: Draw) -> str:
    """Write a column twice."""
    column = int(rng.integers(len(rows[0])))
    for row in rows:
        row.extend(row[column : column + 1])
    return str(column)


def exchange_columns(rows: list[list[str]], rng: Draw) -> str:
    """Exchange two columns, headers stay where they are or go with them."""
    one, other = (int(k) for k in rng.integers(len(rows[0]), size=2))
    for row in rows[int(rng.integers(2)) :]:
        if max(one, other) < len(row):
            row[one], row[other] = row[other], row[one]
    return f"{one} and {other}"


def scale_column(rows: list[list[str]], rng: Draw) -> str:
    """Write the numbers of a column, or of all of them, in another unit; or zeros."""
    factor = FACTORS[rng.integers(len(FACTORS))]
    chosen = range(len(rows[0])) if rng.random() < 0.5 else [int(rng.integers(len(rows[0])))]
    for row in rows[1:]:
        for column in chosen:
            try:
                row[column] = repr(float(row[column]) * factor)
            except (ValueError, IndexError):
                continue
    return f"{list(chosen)} by {factor:g}"


def add_cell(rows: list[list[str]], rng: Draw) -> str:
    """Add a cell to a row."""
    row, _ = _cell(rows, rng)
    rows[row].append("1.0")
    return str(row)


def empty_rows(rows: list[list[str]], rng: Draw) -> str:
    """Leave nothing but the header, or one row."""
    del rows[1 + int(rng.integers(2)) :]
    return f"{len(rows)} left"


TABLE_CHANGES = [put_cell] * 6
TABLE_CHANGES += [delete_row, repeat_row, exchange_rows, delete_column, repeat_column, exchange_columns]
TABLE_CHANGES += [scale_column, scale_column, add_cell, empty_rows]


# --- bytes ---------------------------------------------------------------------------------------------------------


def change_bytes(content: bytes, rng: Draw) -> tuple[bytes, str]:
    """Return a file's content changed without regard to what it means, and what was done."""
    where, way = int(rng.integers(len(content) + 1)), int(rng.integers(10))
    inserted = [b"\x00", b"\xff\xfe", b"\xc3(", b"\r", b'"', "\u2028\u00a0".encode(), b"\x1b[31m", b"[" * 2000, b"="]
    if way < 6:
        one = inserted[rng.integers(len(inserted))]
        return content[:where] + one + content[where:], f"{one[:8]!r} at {where}"
    if way == 6:
        return content[:where], f"cut at {where}"
    if way == 7:
        return content.replace(b",", b";"), "semicolons"
    if way == 8:
        return (b"", "empty") if rng.random() < 0.5 else (content.decode(errors="replace").encode("utf-16"), "UTF-16")
    return content[:where] + content[where + int(rng.integers(1, 40)) :], f"a piece lost at {where}"


def change_number(content: bytes, rng: Draw) -> tuple[bytes, str]:
    """Return a text with one of its numbers somewhat larger or smaller, or with another sign."""
    numbers = list(NUMBER.finditer(content.decode(errors="replace")))
    if not numbers:
        return change_bytes(content, rng)
    one, factor = numbers[rng.integers(len(numbers))], GENTLE[rng.integers(len(GENTLE))]
    value = float(one[0]) * factor
    new = str(round(value)) if one[0].lstrip("-").isdigit() else repr(value)
    text = content.decode(errors="replace")
    return (text[: one.start()] + new + text[one.end() :]).encode(), f"{one[0]} at {one.start()} = {new}"


def change_file(path: Path, rng: Draw, gentle: float = 0.0) -> tuple[bytes, str]:
    """Return a file's content with one to three things changed, and what; by a share of the time some number a bit."""
    content, said = path.read_bytes(), []
    if gentle and rng.random() < gentle and path.suffix in (".toml", ".csv", ".json"):
        return change_number(content, rng)
    for _ in range(1 if rng.random() < 0.7 else int(rng.integers(2, 4))):
        try:
            content, what = _change(path.suffix, content, rng)
        except (ValueError, IndexError, KeyError, RecursionError):  # what an earlier change left is no such file
            content, what = change_bytes(content, rng)
        said.append(what)
    return content, "; ".join(said)


def _change(suffix: str, content: bytes, rng: Draw) -> tuple[bytes, str]:
    if rng.random() < 0.15:
        return change_bytes(content, rng)
    if suffix == ".toml":
        tree, said = change_tree(tomllib.loads(content.decode()), rng)
        return dump_toml(tree).encode("utf-8", "surrogatepass"), said
    if suffix == ".csv":
        text, said = change_table(content.decode(), rng)
        return text.encode("utf-8", "surrogatepass"), said
    if suffix == ".json":
        tree, said = change_tree(json.loads(content), rng)
        return json.dumps(tree).encode(), said
    return change_bytes(content, rng)
