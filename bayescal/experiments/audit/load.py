"""Reading an audit's design; one may extend another, so that variants of a machine share what they have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayescal.config.load import check_section, read_toml
from bayescal.errors import InputError
from bayescal.experiments.audit.schema import AuditConfig

EXTENDS = "extends"
MAX_DEPTH = 8


def load_audit(path: Path) -> AuditConfig:
    """Return the checked design of an audit.

    A key ``extends`` names another design, relative to this one; its tables are filled in where this one is silent.

    Raises
    ------
    InputError
        For anything at fault, with file, line, field, found and expected.
    """
    content, text = _read_extended(path, 0)
    kind = content.get("kind")
    if kind != "audit":
        raise InputError(f"{path}: kind: found {kind!r}, expected 'audit'")
    return check_section(AuditConfig, content, path, text)


def _read_extended(path: Path, depth: int) -> tuple[dict[str, Any], str]:
    content, text = read_toml(path)
    base = content.pop(EXTENDS, None)
    if base is None:
        return content, text
    if not isinstance(base, str):
        raise InputError(f"{path}: {EXTENDS}: found {base!r}, expected the name of another design")
    if depth == MAX_DEPTH:
        raise InputError(f"{path}: {EXTENDS}: found more than {MAX_DEPTH} designs in a row, expected fewer")
    if Path(base).parent != Path():
        raise InputError(f"{path}: {EXTENDS}: found {base!r}, expected a design in the same directory")
    below, _ = _read_extended(path.parent / base, depth + 1)
    return _merge(below, content), text


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Return tables merged key by key; what is no table is replaced, and a table that has another kind too."""
    result = dict(below)
    for key, value in above.items():
        old = below.get(key)
        both = isinstance(old, dict) and isinstance(value, dict) and not _differ(old, value)
        result[key] = _merge(old, value) if both and isinstance(old, dict) else value
    return result


def _differ(old: dict[str, Any], new: dict[str, Any]) -> bool:
    return any(tag in new and old.get(tag) != new[tag] for tag in ("kind", "plan", "prior"))
