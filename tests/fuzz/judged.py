"""Calls of the command line in this process, held against what every call has to keep."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bayescal import cli
from bayescal.files.plain_text import is_plain

SECONDS = 60
CODES = (0, 2, 3, 130)
UNSHOWN = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)


class TooLongError(BaseException):
    """A call that does not end."""


@dataclass(frozen=True)
class Outcome:
    """What a call of the command line left: code, what it said, faults in words."""

    code: int
    out: str
    err: str
    faults: tuple[str, ...]


def _stop(*_: object) -> None:
    raise TooLongError


@contextlib.contextmanager
def _in_time(seconds: float) -> Iterator[None]:
    """Stop after so many seconds of the processor, and after ten times as many of the clock, where a call waits."""
    timers = ((signal.ITIMER_PROF, signal.SIGPROF, seconds), (signal.ITIMER_REAL, signal.SIGALRM, 10.0 * seconds))
    before = [signal.signal(alarm, _stop) for _, alarm, _ in timers]
    for which, _, most in timers:
        signal.setitimer(which, most)
    try:
        yield
    finally:
        for (which, alarm, _), former in zip(timers, before, strict=True):
            signal.setitimer(which, 0.0)
            signal.signal(alarm, former)


def judge_call(arguments: list[object], *watched: Path, seconds: float = SECONDS) -> Outcome:
    """Call the command line and look for faults.

    In the watched folders nothing may have changed after exit code 2, and nothing else than what the call is about
    after any other: what ``--out`` and ``--draws-out`` name, with what stands beside it under its name, and directories
    of results that ``report`` and ``update-manifest`` take. Results that stand there are whole. A call ends within
    ``seconds`` of the processor, by default within a minute.
    """
    before = [_list(folder) for folder in watched]
    out, err, code, raised = io.StringIO(), io.StringIO(), 1, ""
    argv = sys.argv
    with contextlib.ExitStack() as stack:
        said = stack.enter_context(warnings.catch_warnings(record=True))
        warnings.simplefilter("always")
        stack.enter_context(contextlib.redirect_stdout(out))
        stack.enter_context(contextlib.redirect_stderr(err))
        sys.argv = ["bayescal", *map(str, arguments)]
        try:
            with _in_time(seconds):
                cli.main()
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 1
        except TooLongError:
            raised = f"no end within {seconds:g} s: " + traceback.format_exc(limit=-3)
        except BaseException:  # whatever it is, a user would see a traceback
            raised = traceback.format_exc(limit=-4)
        finally:
            sys.argv = argv
    shown = [f"{one.category.__name__}: {one.message}" for one in said if not issubclass(one.category, UNSHOWN)]
    after = [_list(folder) for folder in watched]
    touched = {name for one, other in zip(before, after, strict=True) for name, *_ in set(one) ^ set(other)}
    changed = sorted(touched if code == 2 else {one for one in touched if not _is_meant(one, arguments)})
    several = "validate" in arguments  # a look at everything tells all faults, a line each
    found = _find_faults(code, out.getvalue(), err.getvalue(), raised, shown, changed, several)
    return Outcome(code, out.getvalue(), err.getvalue(), tuple(found))


def judge_refusal(arguments: list[object], *watched: Path) -> str:
    """Call the command line, which has to refuse without a fault; return the line in which it does."""
    outcome = judge_call(arguments, *watched)
    assert (outcome.faults, outcome.code) == ((), 2)
    return outcome.err


def _find_faults(
    code: int, out: str, err: str, raised: str, shown: list[str], changed: list[str], several: bool
) -> Iterator[str]:
    if raised:
        yield raised
        return
    if cli.OWN_FAULT in err:
        yield err
    if code not in CODES:
        yield f"exit code {code}"
    if shown:
        yield f"warnings: {shown[:3]}"
    lines = err.splitlines()
    told = lines and all(line.startswith("bayescal: ") for line in lines) and len(lines) == err.count("\n")
    if code and not (told and (several or len(lines) == 1)):
        yield f"more or less than a line on standard error: {err!r}"
    if code == 2 and out:
        yield f"something on standard output: {out!r}"
    if not code and err:
        yield f"something on standard error: {err!r}"
    if not is_plain(err, but="\n"):
        yield f"control characters: {err!r}"
    if changed:
        yield f"exit code {code}, but {', '.join(changed[:3])} changed ({err!r})"


def _is_meant(name: str, arguments: list[object]) -> bool:
    """Whether a call may change a file or directory."""
    given = [str(one) for one in arguments]
    meant = [given[k + 1] for k, one in enumerate(given[:-1]) if one in ("--out", "--draws-out")]
    meant += given[1:2] if given[0] in ("report", "update-manifest") else []
    beside = [f"{Path(one).with_suffix('')}." for one in meant]  # a certificate's numbers, work in progress
    parents = {str(Path(one).parent) for one in meant}
    return name in parents or name.startswith((*meant, *beside))


def _list(folder: Path) -> list[tuple[str, int, int]]:
    found = []
    for where, _, names in os.walk(folder):
        found.append((where, 0, 0))
        for name in names:
            status = os.lstat(f"{where}/{name}")
            found.append((f"{where}/{name}", status.st_size, status.st_mtime_ns))
    return sorted(found)
