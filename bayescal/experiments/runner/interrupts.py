"""What an interrupt does (one line, no process left behind, exit code 130), and the lock that dies with its process."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from bayescal.errors import InputError

INTERRUPTED = 130
SAFE_PATH = "PYTHONSAFEPATH"
WARNINGS = "PYTHONWARNINGS"
TRACKERS = ("joblib.externals.loky.backend.resource_tracker", "multiprocessing.resource_tracker")
UNSAID = ",".join(f"ignore::UserWarning:{tracker}" for tracker in TRACKERS)
SHOW_CURSOR = "\x1b[?25h\n"  # a progress bar hides it

fcntl: Any


@contextmanager
def end_on_interrupt(message: str) -> Iterator[None]:
    """Let an interrupt or a SIGTERM end the process at once, with a message, and its workers with it.

    A KeyboardInterrupt would be printed with its traceback by emcee, or lost in a callback from C. Nothing needs to be
    unwound but the lock: every other file is written whole or not at all. A process that was started to ignore
    interrupts, in the background of a script, goes on ignoring them; where another program has its own handler, or
    outside the main thread, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> None:
        for worker in multiprocessing.active_children():
            if worker.pid is not None:
                with suppress(ProcessLookupError):
                    os.kill(worker.pid, signal.SIGKILL)
        for path in HELD:
            with suppress(OSError):
                path.unlink()
        cursor = SHOW_CURSOR if sys.stderr.isatty() else ""
        os.write(2, f"{cursor}{message}\n".encode())
        os._exit(INTERRUPTED)

    defaults = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    before = {number: signal.getsignal(number) for number in defaults}
    for number, default in defaults.items():
        if before[number] == default:
            signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def shield_children() -> Iterator[None]:
    """Let processes that are started now never see an interrupt from the terminal: it is their parent's to handle.

    The process that clears up shared memory after all others have ended does so without a word, and none imports from
    the current folder before it is told where to import from.
    """
    before = {name: os.environ.get(name) for name in (WARNINGS, SAFE_PATH)}
    os.environ |= {WARNINGS: ",".join(filter(None, (before[WARNINGS], UNSAID))), SAFE_PATH: "1"}
    can_block = hasattr(signal, "pthread_sigmask")
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if can_block else set()
    try:
        yield
    finally:
        if can_block:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@cache
def follow_parent(parent: int) -> None:
    """Let this worker end when its parent has ended without telling it, killed for example."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


try:
    import fcntl
except ImportError:  # Windows has no such locks; two runs on one directory are then the user's to avoid
    fcntl = None

HELD: set[Path] = set()
"""Lock files of this process, for what ends it at once to remove."""


@contextmanager
def hold_lock(path: Path, out: Path) -> Iterator[None]:
    """Hold the lock file of a results directory; the system lets go of it when the process ends, however it ends.

    InputError where another run holds it; the message names that run's process.
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
        with suppress(OSError):  # the innermost first, as long as nothing was put there: input was at fault
            for folder in made:
                folder.rmdir()


def _acquire(path: Path, out: Path) -> int:
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.read(descriptor, 32).decode(errors="replace").strip() or "unknown"
            os.close(descriptor)
            raise InputError(
                f"{out}: another run (process {holder}) is there; wait for it or choose another --out"
            ) from error
        with suppress(FileNotFoundError):
            if os.path.samestat(path.stat(), os.fstat(descriptor)):
                return descriptor
        os.close(descriptor)  # its last holder removed the file in between: take the new one
