"""Records of finished tasks: dataclasses, tables and arrays as named arrays, without pickle.

A value becomes a tree of JSON beside numpy arrays. Only dataclasses that the reader names itself are made again, so
that a file decides nothing of what is run.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import numpy as np

from bayescal.experiments.runner.losses import LOST_PARTS, Loss, list_losses, record_losses
from bayescal.files.plain_text import add_article
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    import pandas as pd

TREE = "tree"
TAG = "#"

LOSSES = "losses"
"""Of a record: what a task could not compute."""

type Record = dict[str, Array]


def encode(value: object) -> Record:
    """Return a value as named arrays.

    It is made of None, numbers, texts, numpy arrays, tables with a plain index, dictionaries, lists, tuples and
    dataclasses; TypeError for anything else.
    """
    arrays: Record = {}
    tree = _encode(value, arrays)
    return {TREE: np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8), **arrays}


def keep_losses(record: Record, losses: Sequence[Loss]) -> Record:
    """Return a task's record with what it could not compute."""
    text = json.dumps({LOST_PARTS: record_losses(losses)}).encode()
    return {**record, LOSSES: np.frombuffer(text, dtype=np.uint8)} if losses else record


def read_losses(record: Mapping[str, Array]) -> list[Loss]:
    """Return what a task could not compute; ValueError or TypeError where a record is none."""
    if LOSSES not in record:
        return []
    return list_losses(json.loads(bytes(record[LOSSES].astype(np.uint8))))


def _encode(value: object, arrays: Record) -> object:
    import pandas as pd  # a third of a second, for those who have tables

    if value is None or isinstance(value, bool | str) or type(value) in (int, float):
        return value
    if isinstance(value, np.ndarray | np.generic):
        if value.dtype == object:
            raise TypeError("found an array of objects, expected numbers or texts")
        name = f"a{len(arrays)}"
        array = np.asarray(value)
        # an array keeps its order of axes in a file: BLAS sums another order in other last digits
        ordered = array.flags.c_contiguous or array.flags.f_contiguous
        arrays[name] = array if ordered else np.ascontiguousarray(array)
        return {TAG: "array" if isinstance(value, np.ndarray) else "scalar", "at": name}
    if isinstance(value, pd.DataFrame):
        columns = {str(name): _encode_column(value[name], arrays) for name in value.columns}
        return {TAG: "table", "columns": columns, "length": len(value)}
    if is_dataclass(value) and not isinstance(value, type):
        inner = {field.name: _encode(getattr(value, field.name), arrays) for field in fields(value)}
        return {TAG: "dataclass", "name": _name(type(value)), "fields": inner}
    if isinstance(value, dict):
        return {TAG: "dict", "items": [[_encode(k, arrays), _encode(v, arrays)] for k, v in value.items()]}
    if isinstance(value, list | tuple):
        return {TAG: type(value).__name__, "items": [_encode(one, arrays) for one in value]}
    raise TypeError(
        f"found {add_article(type(value).__name__)}, expected numbers, texts, arrays, tables or dataclasses"
    )


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _encode_column(column: pd.Series, arrays: Record) -> object:
    import pandas as pd  # a third of a second, for those who have tables

    if isinstance(column.dtype, np.dtype) and column.dtype != object:
        return _encode(column.to_numpy(), arrays)
    return [None if pd.isna(one) else _encode(one, arrays) for one in column]


def decode(record: Mapping[str, Array], classes: Iterable[type] = ()) -> Any:
    """Return the value of a record from `encode`; ValueError, KeyError or TypeError where it is none.

    Dataclasses that may occur are those given and, found by themselves, those of their fields.
    """
    known = {_name(one): one for one in find_dataclasses(classes)}
    return _decode(json.loads(bytes(record[TREE].astype(np.uint8))), record, known)


def _decode(tree: object, record: Mapping[str, Array], known: Mapping[str, type]) -> Any:
    import pandas as pd  # a third of a second, for those who have tables

    if isinstance(tree, list):
        return [_decode(one, record, known) for one in tree]
    if not isinstance(tree, dict):
        return tree
    match tree[TAG]:
        case "array":
            return record[tree["at"]]
        case "scalar":
            return record[tree["at"]][()]
        case "table":
            columns = {name: _decode(one, record, known) for name, one in tree["columns"].items()}
            return pd.DataFrame(columns, index=pd.RangeIndex(tree["length"]))
        case "dataclass":
            inner = {name: _decode(one, record, known) for name, one in tree["fields"].items()}
            return known[tree["name"]](**inner)
        case "dict":
            return {_decode(key, record, known): _decode(one, record, known) for key, one in tree["items"]}
        case "list":
            return _decode(tree["items"], record, known)
        case "tuple":
            return tuple(_decode(tree["items"], record, known))
    raise ValueError(f"found {tree[TAG]!r} in a record")


def find_dataclasses(classes: Iterable[type]) -> set[type]:
    """Return the dataclasses among types, in their arguments and in their fields."""
    found: set[type] = set()
    waiting = list(classes)
    while waiting:
        one = waiting.pop()
        one = getattr(one, "__value__", one)  # of a type alias
        waiting += get_args(one)
        if isinstance(one, type) and is_dataclass(one) and one not in found:
            found.add(one)
            waiting += get_type_hints(one).values()
    return found
