"""An arm in xacro: expanded to URDF by the package `xacrodoc`, after its user has trusted each file that is evaluated.

xacro evaluates Python expressions and reads other files by names that it computes; files are put to the question of
trust one by one, right before they are read.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from bayescal.config.trust import permit
from bayescal.errors import BayescalError, InputError

SUFFIX = ".xacro"


def expand(path: Path, arguments: Mapping[str, str]) -> bytes:
    """Return a xacro file as URDF, with values of its ``xacro:arg``.

    Packages are looked for in the folders above it. InputError where `xacrodoc` is not installed, a file is not
    trusted, or the file cannot be expanded.
    """
    try:
        import xacro
        from xacrodoc import packages
    except ImportError as error:
        raise InputError(
            f"{path}: found xacro, expected xacrodoc to expand it (pip install 'bayescal[xacro]'), or URDF: "
            f"xacro {path.name} > {name_urdf(path)}"
        ) from error
    permit({path.resolve(): path.read_bytes()}, path.parent)
    packages.walk_up_from(path)
    try:
        with _guard(xacro, path), contextlib.redirect_stderr(io.StringIO()):
            document = xacro.process_file(str(path), mappings=dict(arguments))
    except BayescalError:
        raise
    except Exception as error:  # of many kinds, among them whatever an expression raises
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: {text}, expected xacro that can be expanded") from error
    return str(document.toprettyxml(indent="  ")).encode()


@contextlib.contextmanager
def _guard(xacro: Any, path: Path) -> Iterator[None]:
    """Let xacro open files that are trusted alone."""

    def open_trusted(name: str, *options: Any, **more: Any) -> Any:
        other = Path(name)
        permit({other.resolve(): other.read_bytes()}, other.parent)
        return other.open(*options, **more)

    xacro.open = open_trusted
    try:
        yield
    finally:
        del xacro.open


def name_urdf(path: Path) -> str:
    """Return what the expanded file is called."""
    stem = path.name[: -len(SUFFIX)]
    return stem if stem.lower().endswith(".urdf") else f"{stem}.urdf"
