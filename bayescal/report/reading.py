"""Checking what the JSON files of a results directory hold, each fault one line that names the file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

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
