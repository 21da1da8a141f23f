"""One run at a time on a results directory: a lock that dies with its process."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from bayescal.errors import InputError

fcntl: Any
try:
    import fcntl
except ImportError:  # Windows has no such locks; two runs on one directory are then the user's to avoid
    fcntl = None

HELD: set[Path] = set()
"""Lock files of this process, for what ends it at once to remove."""


@contextmanager
def hold_lock(path: Path, out: Path) -> Iterator[None]:
    """Hold the lock file of a results directory; the system lets go of it when the process ends, however it ends.

    Raises
    ------
    InputError
        Where another run holds it; the message names that run's process.
    """
    if fcntl is None:
        yield
        return
    made = [folder for folder in path.parents if not folder.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = _acquire(path, out)
    HELD.add(path)
    try:
        os.ftruncate(descriptor, 0)
        os.write(descriptor, str(os.getpid()).encode())
        yield
    finally:
        HELD.discard(path)  # first: once the file is gone, another run's may stand there
        path.unlink(missing_ok=True)
        os.close(descriptor)
        _remove_empty(made)


def _remove_empty(folders: list[Path]) -> None:
    """Remove directories, the innermost first, that were made and in which nothing was put: input was at fault."""
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return


def remove_locks() -> None:
    """Remove the lock files of this process, which is about to end without unwinding."""
    for path in HELD:
        with suppress(OSError):
            path.unlink()


def _acquire(path: Path, out: Path) -> int:
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.read(descriptor, 32).decode(errors="replace").strip() or "unknown"
            os.close(descriptor)
            raise InputError(
                f"{out}: another run (process {holder}) is under way there, expected none; wait for it or choose "
                "another --out"
            ) from error
        if _is_still_there(path, descriptor):
            return descriptor
        os.close(descriptor)  # its last holder removed the file in between: take the new one


def _is_still_there(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False
