"""Reading and writing files so that a fault is one line and a write is whole or not at all."""

from __future__ import annotations

import io
import json
import os
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

from bayescal.errors import InputError
from bayescal.files.plain_text import add_article

PROBE = b" " * 65536
"""Less room than this is none: no results would fit."""


def read_text(path: Path, expected: str) -> str:
    """Return a UTF-8 text, with or without byte order mark; InputError names the file and what was expected."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file, expected {expected}") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder, expected {expected}") from error
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}, line {line}: not UTF-8, expected {expected}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not UTF-8 ({type(error).__name__})") from error


def read_json(path: Path) -> dict[str, Any]:
    """Return a JSON object of a results directory; InputError where the file is none."""
    if path.parent.is_file():
        raise InputError(f"{path.parent}: found a file, expected a directory")
    text = read_text(path, "a results directory's JSON")
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not JSON ({error})") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: found {add_article(type(content).__name__)}, expected a JSON object")
    return content


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that it is there whole or not at all."""
    if path.is_dir():
        raise InputError(f"{path}: is a directory, expected a file name")
    temporary = path.with_name(path.name + ".tmp")
    temporary.unlink(missing_ok=True)  # a link there would lead elsewhere
    try:
        with temporary.open("xb") as file:
            file.write(content)
            file.flush()
            if isinstance(file, io.FileIO | io.BufferedWriter):  # on disk
                os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        error.filename = str(path)  # a full disk does not say where
        raise


def resolve(path: Path) -> Path:
    """Return where a path leads; InputError where links lead round in a circle."""
    try:
        return path.resolve()
    except (RuntimeError, OSError) as error:  # Python before 3.13 has the former of a loop
        raise InputError(f"{path}: found circular links, expected a directory or none") from error


def check_writable(folder: Path) -> None:
    """Raise InputError or OSError where a directory could not be made or written to; nothing is left there."""
    there = resolve(folder)
    while not there.exists():
        there = there.parent
    if not there.is_dir():
        raise InputError(f"{there}: is no directory, expected one")
    try:
        with tempfile.TemporaryFile(dir=there) as probe:
            probe.write(PROBE)
    except OSError as error:
        error.filename = str(there)
        raise


def make_directory(path: Path) -> None:
    """Make a directory; InputError where a file is in the way or it may not be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot make a directory ({error.strerror})") from error
