"""Reading the files of a results directory, each fault one line that names the file."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from bayescal.errors import InputError

NUMBER = (int, float)

type Kinds = type | tuple[type, ...]


def check_keys(content: Any, keys: Mapping[str, Kinds], path: Path, where: str) -> None:
    """Raise InputError where a JSON object lacks a key or holds a value of another kind; ``where`` leads to it."""
    for key, kind in keys.items():
        value = content.get(key)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            found = "nothing" if value is None else type(value).__name__
            wanted = "a number" if kind == NUMBER else getattr(kind, "__name__", str(kind))
            raise InputError(f"{path}: {where}{key}: found {found}, expected {wanted}")


def read_table(path: Path, columns: Sequence[str], texts: Collection[str], expected: str) -> pd.DataFrame:
    """Return a CSV table.

    Parameters
    ----------
    path : Path
    columns : sequence of str
        Those that must be there; all that are no texts hold numbers.
    texts : collection of str
        Columns of text.
    expected : str
        What the file is, for the error.

    Raises
    ------
    InputError
        Where the file is missing, no table, or lacks a column.
    """
    try:
        table = pd.read_csv(path, dtype=dict.fromkeys(texts, str), keep_default_na=False, na_values=[""])
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file, expected {expected}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as a table ({error})") from error
    missing = [column for column in columns if column not in table.columns]
    if missing:
        raise InputError(f"{path}: found no column {missing[0]!r}, expected {', '.join(columns)}")
    for column in set(columns) - set(texts) if len(table) else ():
        if not (pd.api.types.is_numeric_dtype(table[column]) or pd.api.types.is_bool_dtype(table[column])):
            raise InputError(f"{path}: column {column!r}: found text, expected numbers")
    return table
