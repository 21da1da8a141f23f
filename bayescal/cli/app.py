"""The program: its application, options that commands share, where they print, and what becomes of errors."""

from __future__ import annotations

import errno
import functools
import inspect
import io
import os
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_type_hints

import typer

from bayescal.config.trust import TRUST, change_policy
from bayescal.errors import BayescalError, InputError, NumericalError, SeveralFaultsError
from bayescal.experiments.runner.interrupts import INTERRUPTED
from bayescal.files.manifest import say_by
from bayescal.files.plain_text import make_plain
from bayescal.limits import LARGEST_SEED

if TYPE_CHECKING:
    from rich.console import Console

app = typer.Typer(
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Bayesian calibration of machines.",
)

WIDTH, WIDE = 120, 160
"""Of what is printed where there is no terminal; comparisons are wide."""

OWN_FAULT = "a bug of bayescal or a user-defined class"
TRACEBACK = "BAYESCAL_TRACEBACK"
"""Environment variable that shows where in the code a fault of bayescal's own is."""


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"bayescal {version('bayescal')}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def begin(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
    no_custom_code: NoCustomCode = False,
    trust: Trust = False,
) -> None:
    """Bayesian identification of parallel-kinematic machines."""
    del version, no_custom_code, trust
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _forbid_custom_code(forbidden: bool) -> None:
    if forbidden:
        change_policy(own=False)


def _trust_code(trusted: bool) -> None:
    if trusted:
        change_policy(everything=True)


def _be_quiet(quiet: bool) -> bool:
    if quiet:
        change_policy(say=None)
    return quiet


def is_interactive() -> bool:
    """Whether somebody sits there who can be asked."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def echo(text: str, nl: bool = True, err: bool = False) -> None:
    """Print a text that others may have written."""
    typer.echo(make_plain(text, but="\n\t"), nl=nl, err=err)


def print_sentence(text: str) -> None:
    """Print a text on standard output, on a terminal with lines that end between words."""
    console = make_console()
    if console.is_terminal:
        console.print(text)
    else:
        echo(text)


def _say(line: str) -> None:
    echo(f"bayescal: {line}", err=True)


def _ask(question: str) -> bool:
    return typer.confirm(make_plain(question), err=True)


Experiment = Annotated[Path, typer.Argument(metavar="EXPERIMENT.toml", help="Config of the experiment.")]
Seed = Annotated[int | None, typer.Option(min=0, max=LARGEST_SEED, help="Seed; default the config's.")]
NoCustomCode = Annotated[
    bool,
    typer.Option(
        "--no-custom-code",
        envvar="BAYESCAL_NO_CUSTOM_CODE",
        callback=_forbid_custom_code,
        is_eager=True,
        help="Refuse custom classes.",
    ),
]


Trust = Annotated[
    bool,
    typer.Option(
        "--trust",
        "--trust-code",
        callback=_trust_code,
        is_eager=True,
        help=f"Run named code files, trusted or not; like {TRUST}=1.",
    ),
]


AllowUnconverged = Annotated[bool, typer.Option("--allow-unconverged", help="Use an unconverged posterior.")]
AllowChangedFiles = Annotated[
    bool,
    typer.Option("--allow-changed-files", help="Use changed files, with a warning."),
]


@dataclass(frozen=True)
class RunOptions:
    """How an experiment is run, whatever its kind."""

    out: Annotated[Path | None, typer.Option(help="Results directory; default results/NAME.")] = None
    seed: Seed = None
    workers: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Processes; default one per core, one alone for short runs.")
    ] = None
    dask_scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask scheduler address, JSON file, or local:N."),
    ] = None
    resume: Annotated[bool, typer.Option("--resume", help="Resume an interrupted run.")] = False
    quiet: Annotated[
        bool, typer.Option("--quiet", callback=_be_quiet, is_eager=True, help="Print nothing but errors.")
    ] = False
    no_custom_code: NoCustomCode = False
    trust: Trust = False


def spread_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command whose parameter of a dataclass, such as RunOptions, is given option by option."""
    own = list(inspect.signature(command, eval_str=True).parameters.values())
    options = next(one for one in own if is_dataclass(one.annotation))
    kind, hints = inspect.Parameter.KEYWORD_ONLY, get_type_hints(options.annotation, include_extras=True)
    spread = [
        inspect.Parameter(one.name, kind, default=one.default, annotation=hints[one.name])
        for one in fields(options.annotation)
    ]

    @functools.wraps(command)
    def take(**given: object) -> None:
        command(**{options.name: options.annotation(**{one.name: given.pop(one.name) for one in spread})}, **given)

    take.__signature__ = inspect.Signature([*(one.replace(kind=kind) for one in own if one is not options), *spread])  # type: ignore[attr-defined]
    return take


def make_console(width: int = WIDTH) -> Console:
    """Return where to print; without a terminal as wide as COLUMNS says, or as is given."""
    from bayescal.experiments.runner.terminal import PlainConsole

    found = PlainConsole()
    if found.is_terminal:
        return found
    told = os.environ.get("COLUMNS", "")
    return PlainConsole(width=int(told) if told.isdecimal() and int(told) else width)


def check_out(out: Path | None) -> None:
    """Find out before anything is computed whether a file of results can be written."""
    from bayescal.files.atomic import check_writable

    if out is not None:
        if out.is_dir():
            raise InputError(f"{out}: is a directory, expected a file name")
        if out.is_symlink() and not out.exists():
            raise InputError(f"{out}: found a broken link, expected a file name")
        check_writable(out.parent)


def put(text: str, out: Path | None) -> None:
    """Write a text to a file, or to standard output."""
    from bayescal.files.atomic import make_directory, write_atomically

    if out is None:
        echo(text, nl=False)
    else:
        make_directory(out.parent)
        write_atomically(out, text.encode())
        echo(f"wrote {out}")


def main() -> None:
    """Run the command line; errors become one line on standard error and an exit code.

    Exit code 0 for success, 2 for bad input, 3 for a failure on the way, 130 for an interrupt.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without Greek letters
    say_by(_say)
    change_policy(say=_say, ask=_ask if is_interactive() else None)
    try:
        code = app(standalone_mode=False)
    except typer.TyperException as error:
        code = _complain(f"{error.format_message()} See bayescal --help.", InputError.exit_code)
    except SeveralFaultsError as error:
        code = max(_complain(line, error.exit_code) for line in error.lines)
    except BayescalError as error:
        code = _complain(str(error), error.exit_code)
    except OSError as error:  # a file or directory that may not be read or written, a full disk
        where = error.filename or "a results file"
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
        code = _complain(
            f"{where}: {error.strerror}, expected {'room to write' if full else 'to read or write'}",
            NumericalError.exit_code if full else InputError.exit_code,
        )
    except MemoryError:
        code = _complain("found too little memory, expected a smaller task", NumericalError.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        code = _complain("interrupted", INTERRUPTED)
    except Exception as error:
        if os.environ.get(TRACEBACK):
            raise
        where = traceback.extract_tb(error.__traceback__)[-1]
        code = _complain(
            f"{type(error).__name__}: {error} ({Path(where.filename).name}, line {where.lineno}): "
            f"{OWN_FAULT}; please report with {TRACEBACK}=1",
            NumericalError.exit_code,
        )
    finally:
        say_by(None)
        change_policy()  # what a call forbids or allows holds for that call
    sys.exit(code or 0)


def _complain(message: str, code: int) -> int:
    echo(f"bayescal: {make_plain(' '.join(message.split()))}", err=True)
    return code
