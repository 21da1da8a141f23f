"""A look at a machine's file by itself, whatever else is wrong with a config that names it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayescal.config.load import read_toml
from bayescal.errors import InputError
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import load_mechanism, read_reading_model


def look_at_machine(content: Mapping[str, Any], folder: Path) -> tuple[Mechanism | None, list[str]]:
    """Return the mechanism that a config names, None for another machine, and what is wrong with the file, in lines."""
    name = content.get("machine", content.get("machine", content.get("mechanism")))
    if not isinstance(name, str):
        return None, []
    try:
        if "kind" in read_toml(folder / name)[0]:
            read_reading_model(folder / name)
            return None, []
        return load_mechanism(folder / name), []
    except InputError as error:
        return None, list(error.lines)
