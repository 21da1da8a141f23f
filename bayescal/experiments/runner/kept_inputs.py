"""What results keep of an experiment: its config and the files that this names, in a folder of their own."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

from bayescal.config.sections import ExperimentConfig
from bayescal.errors import InputError
from bayescal.experiments.runner.results import Results, Writer
from bayescal.files.toml import format_toml

INPUTS = "inputs"
CONFIG = "experiment.toml"
CONFIG_FILE = "config_file"
"""Entry of the provenance: where the config stands among the results, files at their names beside it."""
LARGEST = 100_000_000  # bytes of a file that is kept


def keep_inputs(config: ExperimentConfig, folder: Path, names: Iterable[str]) -> tuple[str, dict[str, str | Writer]]:
    """Return where results keep a config, and it with the files that it names, by their names in the results.

    Names start at ``folder``. Those above it begin further down in the results, below the folders' own names; files
    with absolute names, and very large ones, are not kept.
    """
    kept = {os.path.normpath(name) for name in names if not Path(name).is_absolute()}
    above = max((PurePosixPath(name).parts.count("..") for name in kept), default=0)
    base = PurePosixPath(INPUTS, *(folder.resolve().parts[-above:] if above else ()))
    text = format_toml((), config.model_dump(mode="json", exclude_unset=True))
    place = base / (CONFIG if CONFIG not in kept else f"own_{CONFIG}")
    found: dict[str, str | Writer] = {str(place): text}
    for name in sorted(kept):
        content = (folder / name).read_bytes()
        if len(content) <= LARGEST:
            found[os.path.normpath(base / name)] = partial(_write, content)
    return str(place), found


def _write(content: bytes, path: Path) -> None:
    path.write_bytes(content)


def find_config(folder: Path, provenance: Mapping[str, object]) -> Path:
    """Return where the config stands that results in a folder keep; InputError for results that keep none."""
    parts = PurePosixPath(str(provenance.get(CONFIG_FILE, ""))).parts
    path = folder.joinpath(*parts)
    if parts[:1] != (INPUTS,) or ".." in parts or not path.is_file():
        raise InputError(f"{folder}: found no inputs, expected results of a run that kept them")
    return path


def read_inputs(results: Results) -> tuple[dict[str, Any], str, Mapping[str, bytes]]:
    """Return the content of the config that results keep, its name, and the files that it names beside it.

    Names start in one folder. InputError for results that keep none.
    """
    import tomllib

    assert results.folder is not None
    root = results.folder / INPUTS
    name = find_config(results.folder, results.provenance).relative_to(root).as_posix()
    files = {one.relative_to(root).as_posix(): one.read_bytes() for one in sorted(root.rglob("*")) if one.is_file()}
    return tomllib.loads(files.pop(name).decode()), name, files
