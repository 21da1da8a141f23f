"""Where commands print, and what they write."""

from __future__ import annotations

import os
from pathlib import Path

import typer
from rich.console import Console

from bayescal.errors import InputError

WIDTH, WIDE = 120, 160
"""Of what is printed where there is no terminal; comparisons are wide."""


def make_console(width: int = WIDTH) -> Console:
    """Return where to print; without a terminal as wide as COLUMNS says, or as is given."""
    found = Console(highlight=False, markup=False)
    if found.is_terminal:
        return found
    told = os.environ.get("COLUMNS", "")
    return Console(width=int(told) if told.isdecimal() and int(told) else width, highlight=False, markup=False)


def check_out(out: Path | None) -> None:
    """Find out before anything is computed whether a file of results can be written."""
    from bayescal.files.atomic import check_writable

    if out is not None:
        if out.is_dir():
            raise InputError(f"{out}: is a directory, expected a file name")
        if out.is_symlink() and not out.exists():
            raise InputError(f"{out}: is a link that leads nowhere, expected a file name")
        check_writable(out.parent)


def put(text: str, out: Path | None) -> None:
    """Write a text to a file, or to standard output."""
    from bayescal.files.atomic import make_directory, write_atomically

    if out is None:
        typer.echo(text, nl=False)
    else:
        make_directory(out.parent)
        write_atomically(out, text.encode())
        typer.echo(f"wrote {out}")
