"""What could not be computed although the rest was: each costs its line, never the run.

`attempt` is put around whatever results can do without: one variant, an estimator of evidence, a secondary table, a
section of a page. A failure is noted with its reason. Notes are collected per task, kept with it, and reach the summary
under ``lost``, the page, the terminal and the exit code.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from bayescal.errors import BayescalError, InputError
from bayescal.experiments.runner.results import Summary

LOST_PARTS = "lost"
"""Key of the summary that lists what could not be computed; absent where everything was."""
PACKAGE = Path(__file__).parents[2]
NUMERICAL = (BayescalError, ArithmeticError, ValueError)
"""What computing raises where numbers are at fault: SciPy and LAPACK raise the last two."""
RAISE_OTHERS = False
"""Whether what only a programming error raises is raised all the same: tests must not take it for a loss."""


@dataclass(frozen=True)
class Loss:
    """What could not be computed, and why."""

    what: str
    why: str

    def say(self) -> str:
        """Return both in a line."""
        return f"{self.what} could not be computed: {self.why}"


_noted: ContextVar[list[Loss] | None] = ContextVar("noted", default=None)


@contextmanager
def note_losses() -> Iterator[list[Loss]]:
    """Collect what `attempt` loses meanwhile."""
    found: list[Loss] = []
    token = _noted.set(found)
    try:
        yield found
    finally:
        _noted.reset(token)


def note(loss: Loss) -> bool:
    """Note what was lost; return whether somebody collects."""
    noted = _noted.get()
    if noted is not None and loss not in noted:
        noted.append(loss)
    return noted is not None


def attempt[T](what: str, compute: Callable[[], T], otherwise: T) -> T:
    """Return what a computation gives; where it fails, something else, and note the loss.

    Input at fault is raised, want of memory, which another run may not have, and everything where nobody collects.
    """
    try:
        return compute()
    except (InputError, MemoryError):
        raise
    except Exception as error:
        if (RAISE_OTHERS and not isinstance(error, NUMERICAL)) or not note(Loss(what, describe(error))):
            raise
        return otherwise


def describe(error: Exception) -> str:
    """Return an exception as a line: its message, and for a programming error its kind and where it was raised."""
    said = " ".join(str(error).split())
    if isinstance(error, BayescalError):
        return said
    return f"{type(error).__name__}: {said} ({locate(error)})"


def locate(error: Exception) -> str:
    """Return file and line where somebody's own class, otherwise this package, called what raised."""
    frames = traceback.extract_tb(error.__traceback__)
    installed = [("site-packages" in one.filename or one.filename.startswith("<")) for one in frames]
    ours = [one for one, is_installed in zip(frames, installed, strict=True) if not is_installed]
    own = [one for one in ours if PACKAGE not in Path(one.filename).parents]
    where = [one for one in own if "/lib/python" not in one.filename] or ours or list(frames)
    return f"{Path(where[-1].filename).name}, line {where[-1].lineno}"


def list_losses(summary: Summary) -> list[Loss]:
    """Return what a summary lists as lost."""
    found = summary.get(LOST_PARTS, [])
    return [Loss(str(one.get("what")), str(one.get("why"))) for one in found if isinstance(one, dict)]


def record_losses(losses: Iterable[Loss]) -> list[dict[str, str]]:
    """Return losses as a summary lists them."""
    return [{"what": one.what, "why": one.why} for one in losses]
