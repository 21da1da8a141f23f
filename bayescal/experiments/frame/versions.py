"""What computes: the content of bayescal and the versions of what its numbers depend on."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

NUMERIC = ("emcee", "numpy", "pandas", "scipy")
"""Packages whose versions may change numbers."""


@cache
def list_versions(more: tuple[str, ...] = ()) -> dict[str, str]:
    """Return the versions of Python, of bayescal with a hash of its sources, and of packages, ``more`` besides."""
    root = Path(__file__).parents[2]
    content = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        content.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    own = f"{version('bayescal')} (source {content.hexdigest()[:12]})"
    return {"python": platform.python_version(), "bayescal": own, **{name: version(name) for name in (*NUMERIC, *more)}}
