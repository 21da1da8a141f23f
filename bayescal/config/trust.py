"""Whether code that is not the library's own may be imported because a file names it, or because results keep it."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable
from contextvars import ContextVar
from pathlib import Path

from bayescal.errors import InputError

_ALLOWED: ContextVar[bool] = ContextVar("own classes are imported", default=True)


def allow_own_classes(allowed: bool) -> None:
    """Say whether files beside configs, other modules and installed packages' classes may be imported from now on."""
    _ALLOWED.set(allowed)


def are_own_classes_allowed() -> bool:
    """Whether they may."""
    return _ALLOWED.get()


def check_trust(path: Path, what: str, trust: bool) -> None:
    """Raise InputError for somebody's own class that nobody has allowed to run."""
    if not trust:
        raise InputError(
            f"{path}: found a {what}, whose code would be run, expected --trust-code (in Python trust=True) from "
            "whoever knows it"
        )


def check_same(folder: Path, names: Iterable[str], known: Collection[str] | None) -> None:
    """Raise InputError for a file that is none of those that results go back to, by their SHA-256."""
    for name in names:
        path = folder / name
        if not path.is_file():
            raise InputError(f"{path}: no such file, expected it as the results kept it")
        if known is not None and hash_file(path.read_bytes()) not in known:
            raise InputError(f"{path}: found another file than the results were computed with, expected the same")


def hash_file(content: bytes) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(content).hexdigest()
