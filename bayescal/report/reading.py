"""Checking what the files of a results directory hold, each fault one line that names the file, and their rows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayescal.errors import InputError

NUMBER = (int, float)

if TYPE_CHECKING:
    import pandas as pd

type Kinds = type | tuple[type, ...]
type Row = dict[str, Any]


def check_keys(content: Any, keys: Mapping[str, Kinds], path: Path, where: str) -> None:
    """Raise InputError where a JSON object lacks a key or holds a value of another kind; ``where`` leads to it."""
    for key, kind in keys.items():
        value = content.get(key)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            found = "nothing" if value is None else type(value).__name__
            wanted = "a number" if kind == NUMBER else getattr(kind, "__name__", str(kind))
            raise InputError(f"{path}: {where}{key}: found {found}, expected {wanted}")


def list_rows(table: pd.DataFrame) -> list[Row]:
    """Return the rows of a table by the names of its columns."""
    return [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]
