"""What of machines' files belongs to the identity of results: the sources of their classes."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from bayescal.config.registry import hash_modules
from bayescal.machines.read import find_machine_class, list_machine_sources


def list_sources(machines: Iterable[str], folder: Path) -> list[str]:
    """Return the sources that machines' classes stand in, relative to the config's folder as the machines' files."""
    return [
        os.path.normpath(Path(name).parent / one) for name in machines for one in list_machine_sources(folder / name)
    ]


def hash_machine_modules(machines: Iterable[str], folder: Path) -> dict[str, str]:
    """Return the hashes of installed modules that the machines' classes stand in."""
    own = [find_machine_class(folder / name) for name in machines]
    return hash_modules([one for one in own if one is not None])
