"""TOML as it is written: plain keys first, then a table for each section."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def format_toml(comments: Sequence[str], content: Mapping[str, Any]) -> str:
    """Return a content below lines of comments, without what is None; rows of matrices have lines of their own."""
    return "".join(f"# {one}\n" for one in comments) + write_toml(_simplify(content))


def _simplify(value: object) -> Any:
    """Return lists instead of arrays, and tables without what is None."""
    if isinstance(value, Mapping):
        return {key: _simplify(one) for key, one in value.items() if one is not None}
    if isinstance(value, list | tuple):
        return [_simplify(one) for one in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def write_toml(content: Mapping[str, Any]) -> str:
    """Return TOML that reads as a content of tables, lists, texts, numbers and truth values."""
    plain = {key: value for key, value in content.items() if not _is_section(value)}
    lines = [f"{_quote(key)} = {_write(value)}\n" for key, value in plain.items()]
    for key, value in content.items():
        if isinstance(value, Mapping) and key not in plain:
            lines += [f"\n[{_quote(key)}]\n", *(f"{_quote(k)} = {_write(one)}\n" for k, one in value.items())]
        elif key not in plain:
            for one in value:
                lines += [f"\n[[{_quote(key)}]]\n", *(f"{_quote(k)} = {_write(v)}\n" for k, v in one.items())]
    return "".join(lines)


def _is_section(value: object) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list) and bool(value) and all(isinstance(one, Mapping) for one in value)
    )


def _quote(key: str) -> str:
    plain = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if plain else json.dumps(key, ensure_ascii=False)


def _write(value: object) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_quote(key)} = {_write(one)}" for key, one in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, list) and value and isinstance(value[0], list | Mapping):
        return "".join(["[\n", *(f"    {_write(row)},\n" for row in value), "]"])
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_write, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, int | float) else str(value)
