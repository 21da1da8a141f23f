"""A look at a machine's file by itself, whatever else is wrong with a config that names it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayescal.errors import InputError
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import load_mechanism


def look_at_machine(content: Mapping[str, Any], folder: Path) -> tuple[Mechanism | None, list[str]]:
    """Return the machine that a config names, or None and what is wrong with its file, a line each."""
    name = content.get("mechanism")
    if not isinstance(name, str):
        return None, []
    try:
        return load_mechanism(folder / name), []
    except InputError as error:
        return None, list(error.lines)
