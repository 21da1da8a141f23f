"""What an interrupt does: one line, no process left behind, exit code 130."""

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

from bayescal.experiments.frame.lock import remove_locks

INTERRUPTED = 130
WARNINGS = "PYTHONWARNINGS"
TRACKERS = ("joblib.externals.loky.backend.resource_tracker", "multiprocessing.resource_tracker")
UNSAID = ",".join(f"ignore::UserWarning:{tracker}" for tracker in TRACKERS)
SHOW_CURSOR = "\x1b[?25h\n"  # a progress bar hides it


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
        remove_locks()
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

    The process that clears up shared memory after all others have ended does so without a word.
    """
    before = os.environ.get(WARNINGS)
    os.environ[WARNINGS] = ",".join(filter(None, (before, UNSAID)))
    try:
        with _block_interrupts():
            yield
    finally:
        if before is None:
            del os.environ[WARNINGS]
        else:
            os.environ[WARNINGS] = before


@contextmanager
def _block_interrupts() -> Iterator[None]:
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@cache
def follow_parent(parent: int) -> None:
    """Let this worker end when its parent has ended without telling it, killed for example."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
