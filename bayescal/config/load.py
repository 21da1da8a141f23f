"""Reading configs: TOML to checked sections, every fault as one line with file, line, field, found and expected."""

from __future__ import annotations

import difflib
import os
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from bayescal.config.sections import Section
from bayescal.errors import InputError
from bayescal.files.atomic import read_text

EXTENDS = "extends"
MAX_DEPTH = 8
FOLDER = "folder"
"""Where names of files start, in the context of a validation."""
OWN = "a user-defined class"
"""The branch of a union that is a section of somebody else's class."""
MEASURED = "measured-"
"""Begins the tags of unions whose branches are told apart by more than a key that has to be there."""

type Location = tuple[str | int, ...]

_TABLE = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(r"^\s*([\w.\-\"']+)\s*=")


def read_toml(path: Path) -> tuple[dict[str, object], str]:
    """Return a TOML file's content and its text; InputError where it is none."""
    text = read_text(path, "a TOML config")
    try:
        return tomllib.loads(text), text
    except (ValueError, RecursionError) as error:  # also numbers of thousands of digits and brackets without end
        if path.suffix.lower() == ".csv":
            raise InputError(f"{path}: found a CSV table, expected a TOML config") from error
        raise InputError(f"{path}: not valid TOML: {error}") from error


def read_extended(path: Path, depth: int = 0) -> tuple[dict[str, object], str]:
    """Return a TOML file's content and its text, tables filled in from what it extends.

    A key ``extends`` names another config, relative to this one; its tables are filled in where this one is silent.
    """
    content, text = read_toml(path)
    base = content.pop(EXTENDS, None)
    if base is None:
        return content, text
    if not isinstance(base, str):
        raise InputError(f"{path}: {EXTENDS}: found {base!r}, expected a config")
    if depth == MAX_DEPTH:
        raise InputError(f"{path}: {EXTENDS}: found more than {MAX_DEPTH} configs in a row, expected fewer")
    if Path(base).parent != Path():
        raise InputError(f"{path}: {EXTENDS}: found {base!r}, expected a config in the same directory")
    below, _ = read_extended(path.parent / base, depth + 1)
    return merge(below, content), text


def list_extended(name: str, folder: Path) -> tuple[str, ...]:
    """Return a file with those that it extends, where it is TOML that does."""
    found = [name]
    while found[-1].endswith(".toml") and (folder / found[-1]).is_file():
        base = read_toml(folder / found[-1])[0].get(EXTENDS)
        other = os.path.normpath(Path(found[-1]).parent / base) if isinstance(base, str) else ""
        if not other or other in found:
            break
        found.append(other)
    return tuple(found)


def merge(below: dict[str, object], above: dict[str, object]) -> dict[str, object]:
    """Return tables merged key by key; what is no table is replaced, and a table that has another kind too."""
    result = dict(below)
    for key, value in above.items():
        old = below.get(key)
        if isinstance(old, dict) and isinstance(value, dict):
            another = any(tag in value and old.get(tag) != value[tag] for tag in ("kind", "sampling", "prior", "class"))
            result[key] = value if another else merge(old, value)
        else:
            result[key] = value
    return result


def check_section[S: Section](
    schema: type[S], content: dict[str, object], path: Path, text: str, folder: Path | None = None
) -> S:
    """Return content as a section, the classes that it names looked up beside its file, or in another ``folder``.

    InputError with file, line, field, found and expected where it is none.
    """
    try:
        return schema.model_validate(content, context={FOLDER: path.parent if folder is None else folder})
    except ValidationError as error:
        first, *others = (_describe(fault, schema, path, text) for fault in _choose_faults(error))
        raise InputError(first, others) from error


def _choose_faults(error: ValidationError) -> list[ErrorDetails]:
    """Return a fault for each place, that to be told first before the others.

    Unknown keys come first, since they explain the missing ones; then the deepest place, since a list that may also be
    a number is at fault in its entry; last, that something is no list, since most of these may be a number instead.
    Places inside of one another are one place, seen by several branches of a union.
    """
    rank = {"extra_forbidden": -1, "list_type": 1}
    told = [one for one in error.errors() if one["type"] != "default_factory_not_called"]  # for another field's fault
    faults = sorted(told, key=lambda one: (rank.get(one["type"], 0), -len(_keys_of(one["loc"]))))
    chosen: dict[tuple[int | str, ...], ErrorDetails] = {}
    for fault in faults:
        place = tuple(_keys_of(fault["loc"]))
        if not any(place[: len(other)] == other[: len(place)] for other in chosen):
            chosen[place] = fault
    return list(chosen.values())


def _describe(fault: ErrorDetails, schema: type[Section], path: Path, text: str) -> str:
    """Return a fault as one line."""
    location = _keys_of(fault["loc"])
    field = ".".join(str(part) for part in location) or "the file"
    line = find_line(text, location[:-1] if fault["type"] == "missing" else location)
    where = f"{path}, line {line}: {field}" if line else f"{path}: {field}"
    if fault["type"] == "extra_forbidden":
        sections, key = _find_sections(schema, _keys_of(fault["loc"], tags=True)[:-1]), str(location[-1])
        return f"{where}: {describe_unknown_key(sorted({k for one in sections for k in one.model_fields}), key)}"
    message = fault["msg"].removeprefix("Value error, ")
    if fault["type"] == "missing":
        return f"{where}: missing, expected a value"
    if fault["type"] == "value_error":
        return f"{where}: {message}"
    if fault["type"] == "union_tag_not_found":
        return f"{where}: found no key {fault['ctx']['discriminator']}, expected a value"
    if fault["type"] == "union_tag_invalid":
        text = f"{where}: found {fault['ctx']['tag']!r}, expected one of {fault['ctx']['expected_tags']}"
        return text.replace(MEASURED, "")
    message = message.replace("a valid dictionary or object to extract fields from", "a table of keys")
    if message.startswith("Input should be "):
        return f"{where}: found {_short(fault['input'])}, expected {message.removeprefix('Input should be ')}"
    return f"{where}: found {_short(fault['input'])}, expected: {message[0].lower()}{message[1:]}"


def _keys_of(location: tuple[int | str, ...], tags: bool = False) -> list[int | str]:
    """Return a fault's location without the parts that name a branch of a union, but for tags where they are wanted."""
    branches = {"normal", "uniform", "fixed", "float", "constrained-float", "observability", "accuracy", "numbers", OWN}
    marks = ("function-", "list[", "dict[", "[key]", *(() if tags else (MEASURED,)))
    return [part for part in location if part not in branches and not str(part).startswith(marks)]


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) < 60 else text[:57] + "..."


def _find_sections(schema: object, location: Sequence[int | str]) -> list[type[BaseModel]]:
    """Return the sections that may stand at a location, looking through lists, unions and dictionaries."""
    found = [schema]
    for part in location:
        found = [inner for kind in found for inner in _step(kind, part)]
    return [model for kind in found for model in _models(kind)]


def _step(kind: object, part: int | str) -> Sequence[object]:
    if str(part).startswith(MEASURED):
        return _find_tagged(kind, str(part))
    if isinstance(part, int):
        return _list_items(kind)
    models = _models(kind)
    hits = [m.model_fields[part].annotation for m in models if part in m.model_fields]
    return hits or models


def _list_items(kind: object) -> list[object]:
    """Return what the items of a list are, of what may be one."""
    kind = getattr(kind, "__value__", kind)
    if get_origin(kind) is list:
        return list(get_args(kind))
    return [hit for one in get_args(kind) for hit in _list_items(one)]


def _find_tagged(kind: object, tag: str) -> list[object]:
    """Return the branch of a union that has a tag."""
    inner = get_args(getattr(kind, "__value__", kind))
    if any(getattr(one, "tag", None) == tag for one in inner):
        return [inner[0]]
    return [hit for one in inner for hit in _find_tagged(one, tag)]


def _models(kind: object) -> list[type[BaseModel]]:
    """Return all pydantic models inside a type."""
    kind = getattr(kind, "__value__", kind)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return [kind]
    return [model for inner in get_args(kind) for model in _models(inner)]


def suggest(name: str, known: Iterable[str]) -> str:
    """Return which of the known names is near to one, as a part of a message; empty where none is."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f", did you mean {close[0]!r}?" if close else ""


def look_up[T](registry: Mapping[str, T], name: str, what: str) -> T:
    """Return the entry of a registry; InputError with the nearest name where there is none."""
    if name not in registry:
        raise InputError(f"{what}: {describe_unknown(registry, name)}")
    return registry[name]


def describe_unknown(known: Iterable[str], name: str) -> str:
    """Return that a name is none of those known, with the nearest one."""
    known = sorted(known)
    return f"found {name!r}{suggest(name, known)}, expected one of {', '.join(known)}"


def describe_unknown_key(known: Iterable[str], key: str) -> str:
    """Return that a key of a section is none of those known, with the nearest one."""
    known = sorted(known)
    expected = f"one of {', '.join(known)}" if known else "none"
    return f"unknown key{suggest(key, known)}, expected {expected}"


def dump_config(config: Section) -> dict[str, object]:
    """Return a config as plain JSON-ready values."""
    return TypeAdapter(type(config)).dump_python(config, mode="json")


def find_line(text: str, location: Sequence[str | int]) -> int | None:
    """Return the line of a location, or of the table or list that it stands in; None where neither is in the text.

    tomllib keeps no lines, messages need them. Entries of lists are counted from zero. A key of an inline table is on
    the line of that table, unless one row of the text alone has it.
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
