"""A manifest of a directory that a command wrote: the SHA-256 of each file, by which it is whole or refused.

It is written last. It tells edits, losses and additions that somebody or a disk has made; it is no signature, but one
of it covers all files.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path

from bayescal.errors import InputError
from bayescal.files.atomic import read_json, write_atomically

MANIFEST = "manifest.json"
HASHES, OTHERS = "sha256", "others"
"""Keys of the manifest: of files that were written, and names of others that stood there."""
SIGNATURES = (f"{MANIFEST}.sig", f"{MANIFEST}.asc")
"""A signature of the manifest beside it, as OpenSSH and OpenPGP write it, which covers all files."""
SHOWN = 3

_OVERLOOKED: ContextVar[bool] = ContextVar("ignore changed manifests", default=False)
_SAY: ContextVar[Callable[[str], None] | None] = ContextVar("directory to text", default=None)


@contextmanager
def overlooking(allowed: bool = True) -> Iterator[None]:
    """Take directories that are not whole meanwhile, and say what is overlooked."""
    token = _OVERLOOKED.set(allowed or _OVERLOOKED.get())
    try:
        yield
    finally:
        _OVERLOOKED.reset(token)


def say_by(say: Callable[[str], None] | None) -> None:
    """Let what is said of directories go somewhere, from now on; None makes a Python warning of what is overlooked."""
    _SAY.set(say)


def write_manifest(folder: Path, others: Collection[str] = ()) -> None:
    """Write the manifest of all files of a directory, but for some that are somebody's own."""
    names = [name for name in _list_files(folder) if name not in others]
    _write(folder, {name: _hash(folder / name) for name in names}, others)


def renew_manifest(folder: Path, belongs: Callable[[str], bool], begin: bool = False) -> None:
    """Take the files whose names belong as they are now into a directory's manifest, which may have to be begun."""
    there = (folder / MANIFEST).is_file()
    if there or begin:
        hashes, others = _read(folder) if there else ({}, [])
        kept = {name: one for name, one in hashes.items() if not belongs(name)}
        new = {name: _hash(folder / name) for name in _list_files(folder) if belongs(name)}
        _write(folder, kept | new, others)


def add_others(folder: Path, names: Iterable[str]) -> None:
    """Let files of somebody's own stand in a directory, where it has a manifest."""
    if (folder / MANIFEST).is_file():
        hashes, others = _read(folder)
        _write(folder, hashes, {*others, *names})


def list_written(folder: Path) -> list[str] | None:
    """Return the files of a directory's manifest; None without one."""
    return [*_read(folder)[0], MANIFEST] if (folder / MANIFEST).is_file() else None


def check_whole(
    folder: Path, expected: bool, but: Callable[[str], bool] = lambda name: False, additions: bool = False
) -> None:
    """Check a directory by its manifest; InputError names what was edited, is missing or was added.

    ``expected``: whether it must have one; an earlier version has written none, which is said. ``but`` tells of a name
    that its file may be anything; ``additions``: whether files may stand there that were not written with the others.
    """
    if not (folder / MANIFEST).is_file():
        if expected:
            _refuse(folder, [f"no {MANIFEST}"])
        elif (say := _SAY.get()) is not None:
            say(f"{folder}: found no {MANIFEST}; bayescal update-manifest {folder} writes it")
        return
    hashes, others = _read(folder)
    there = set(_list_files(folder))
    faults = [
        f"{name} {'edited' if name in there else 'missing'}"
        for name, one in hashes.items()
        if not but(name) and not (name in there and _hash(folder / name) == one)
    ]
    new = set() if additions else there - {*hashes, *others}
    faults += [f"{name} added" for name in sorted(new) if not but(name)]
    if faults:
        _refuse(folder, faults)


def _refuse(folder: Path, faults: list[str]) -> None:
    more = f" and {len(faults) - SHOWN} more" if len(faults) > SHOWN else ""
    found = f"{folder}: found {', '.join(faults[:SHOWN])}{more}"
    if not _OVERLOOKED.get():
        raise InputError(f"{found}, expected unchanged files, or --allow-changed-files")
    if (say := _SAY.get()) is not None:
        say(f"{found}: used (--allow-changed-files)")
    else:
        warnings.warn(f"{found}: used (--allow-changed-files)", stacklevel=2)


def _list_files(folder: Path) -> list[str]:
    """Return the names of all files of a directory but manifest, its signature, and those that systems hide there."""
    names = [path.relative_to(folder) for path in sorted(folder.rglob("*")) if not path.is_dir()]
    shown = [one for one in names if one.name != MANIFEST and not any(p.startswith(".") for p in one.parts)]
    return [name for one in shown if (name := one.as_posix()) not in SIGNATURES]


def _hash(path: Path) -> str:
    try:
        state = path.stat()
        return _hash_content(path, state.st_mtime_ns, state.st_size, state.st_ino)
    except OSError as error:
        return f"cannot be read ({error.strerror})"


@lru_cache(maxsize=4096)
def _hash_content(path: Path, *state: int) -> str:
    """Return the SHA-256 of a file, taken once for each of its states: a command looks at results several times."""
    del state
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _read(folder: Path) -> tuple[dict[str, str], list[str]]:
    content = read_json(folder / MANIFEST)
    hashes, others = content.get(HASHES), content.get(OTHERS, [])
    if not isinstance(hashes, dict) or not isinstance(others, list):
        raise InputError(f"{folder / MANIFEST}: found no hashes of files")
    return hashes, others


def _write(folder: Path, hashes: dict[str, str], others: Iterable[str]) -> None:
    content = {HASHES: dict(sorted(hashes.items())), OTHERS: sorted(others)}
    text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
    write_atomically(folder / MANIFEST, text.encode())
