"""The program: exit code 0 for success, 2 for bad input, 3 for a failure on the way, 130 for an interrupt."""

from __future__ import annotations

import errno
import io
import os
import sys
import traceback
from pathlib import Path

import typer

from bayescal.cli.app import app
from bayescal.config.trust import allow_own_classes
from bayescal.errors import BayescalError, InputError, NumericalError, SeveralFaultsError
from bayescal.experiments.frame.interrupts import INTERRUPTED
from bayescal.files.plain_text import make_plain

OWN_FAULT = "a fault of bayescal, or of a class of one's own"
TRACEBACK = "BAYESCAL_TRACEBACK"
"""Environment variable that shows where in the code a fault of bayescal's own is."""


def main() -> None:
    """Run the command line; errors become one line on standard error and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without Greek letters
    try:
        code = app(standalone_mode=False)
    except typer.TyperException as error:
        code = _complain(f"{error.format_message()} See bayescal --help.", InputError.exit_code)
    except SeveralFaultsError as error:
        code = max(_complain(line, error.exit_code) for line in error.lines)
    except BayescalError as error:
        code = _complain(str(error), error.exit_code)
    except OSError as error:  # a file or directory that may not be read or written, a full disk
        where = error.filename or "a file of the results"
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO)
        code = _complain(
            f"{where}: {error.strerror}, expected {'room to write' if full else 'to read or write there'}",
            NumericalError.exit_code if full else InputError.exit_code,
        )
    except MemoryError:
        code = _complain(
            "found too little memory, expected a smaller task or a larger machine", NumericalError.exit_code
        )
    except (KeyboardInterrupt, typer.Abort):
        code = _complain("interrupted", INTERRUPTED)
    except Exception as error:
        if os.environ.get(TRACEBACK):
            raise
        code = _complain(_describe_own_fault(error), NumericalError.exit_code)
    finally:
        allow_own_classes(True)  # what a call forbids holds for that call
    sys.exit(code or 0)


def _describe_own_fault(error: Exception) -> str:
    """Return what nobody foresaw in a line: where, what, and how to see all of it."""
    where = traceback.extract_tb(error.__traceback__)[-1]
    return (
        f"{type(error).__name__}: {error} ({Path(where.filename).name}, line {where.lineno}): {OWN_FAULT}, expected a "
        f"line that says what is wrong; please report it with what {TRACEBACK}=1 shows"
    )


def _complain(message: str, code: int) -> int:
    typer.echo(f"bayescal: {make_plain(' '.join(message.split()))}", err=True)
    return code
