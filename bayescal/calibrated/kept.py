"""A machine of functions as files: its own, and the code of a class of its own, which nothing runs unasked.

Results and exported machines keep the file that a machine is read from and, where its class stands in a file beside
it, that file with what it imports from beside itself. Whoever loads a stranger's results runs that code only if they
say so.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from pathlib import Path

from bayescal.config.classes import CLASS
from bayescal.config.load import read_toml
from bayescal.config.registry import list_references
from bayescal.config.trust import check_same, check_trust
from bayescal.machines.read import LEGS, list_machine_sources, read_reading_model
from bayescal.machines.readings import ReadingModel


def keep_machines(
    paths: Iterable[Path], others: Iterable[Path] = (), folder: Path | None = None
) -> tuple[dict[str, bytes], dict[Path, str]]:
    """Return the files that machines are read from, by names in one folder, and each machine's own name there.

    Other files are kept beside them, and where a ``folder`` is given it has a place there, too.
    """
    machines = {path: path.resolve() for path in paths}
    every = dict.fromkeys([*machines.values(), *(one.resolve() for one in others)])
    for path in machines:
        every |= dict.fromkeys((path.parent / one).resolve() for one in list_machine_sources(path))
    known = machines if folder is None else machines | {folder: folder.resolve()}
    root = Path(os.path.commonpath([*(one.parent for one in every), *(known[folder] for _ in [folder] if folder)]))
    files = {one.relative_to(root).as_posix(): one.read_bytes() for one in every}
    return files, {path: one.relative_to(root).as_posix() for path, one in known.items()}


def read_kept(path: Path, trust: bool, known: Collection[str] | None = None) -> ReadingModel:
    """Return the machine of a kept file.

    Parameters
    ----------
    path : Path
        The machine's TOML file.
    trust : bool
        Whether the code of a class of its own may be run.
    known : collection of str, optional
        SHA-256 of files that the results go back to: code has to be one of these.

    Raises
    ------
    InputError
        For code that nobody has allowed to run, or that is another than the results'.
    """
    for name in _list_own_classes(path):
        check_trust(path, f"machine of its own class {name!r}", trust)
    check_same(path.parent, [path.name], known)
    check_same(path.parent, list_machine_sources(path), known)
    return read_reading_model(path)


def _list_own_classes(path: Path) -> list[str]:
    """Return the names of classes in a machine's file that are neither built in nor an installed package's."""
    content = read_toml(path)[0]
    named = [("MACHINES", content.get("kind"))]
    if content.get("kind") == LEGS:
        named = [("MODELS", content.get("model")), ("DEFORMATIONS", content.get("deformation"))]
    found = [(what, one.get(CLASS) if isinstance(one, dict) else one) for what, one in named]
    return [one for what, one in found if isinstance(one, str) and one not in list_references(what)]
