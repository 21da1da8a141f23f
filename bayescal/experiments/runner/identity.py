"""What determines results: config without titles, content of input files, others' classes; and what computes them."""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bayescal.config.load import dump_config
from bayescal.config.sections import ExperimentConfig
from bayescal.files.atomic import read_text

PACKAGES = ("bayescal", "numpy", "scipy", "emcee", "arviz", "arviz-stats", "pandas", "matplotlib", "h5netcdf", "xarray")
COSMETIC = "title"

NUMERIC = ("emcee", "numpy", "pandas", "scipy")
"""Packages whose versions may change numbers."""


def identify(
    config: ExperimentConfig, folder: Path, names: Iterable[str], modules: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return what determines an experiment's results: config, input files, and modules of somebody else's classes.

    ``names`` are those of the files, which start at ``folder``; InputError where one is not there. Modules come with
    their SHA-256.
    """
    files = {}
    for name in sorted(set(names)):
        read_text(folder / name, "a file of the experiment")
        files[name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    foreign = {"modules": dict(modules)} if modules else {}
    return {"config": _without_titles(dump_config(config)), "files": files, **foreign}


def _without_titles(value: object) -> object:
    if isinstance(value, dict):
        return {key: _without_titles(one) for key, one in value.items() if key != COSMETIC}
    return [_without_titles(one) for one in value] if isinstance(value, list) else value


def hash_identity(identity: dict[str, Any]) -> str:
    """Return the SHA-256 of an identity in canonical JSON."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def describe_provenance(config: ExperimentConfig, identity: dict[str, Any]) -> dict[str, Any]:
    """Return where results come from: what determines them, and what computed them."""
    return {
        "kind": config.kind,
        "name": config.name,
        "config_sha256": hash_identity(identity),
        **identity,
        "title": config.title,
        "seed": config.seed,
        "python": platform.python_version(),
        "platform": sys.platform,
        "versions": {name: version(name) for name in PACKAGES},
    }


@cache
def list_versions(more: tuple[str, ...] = ()) -> dict[str, str]:
    """Return the versions of Python, of bayescal with a hash of its sources, and of packages, ``more`` besides."""
    root = Path(__file__).parents[2]
    content = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        content.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    own = f"{version('bayescal')} (source {content.hexdigest()[:12]})"
    return {"python": platform.python_version(), "bayescal": own, **{name: version(name) for name in (*NUMERIC, *more)}}
