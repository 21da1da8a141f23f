"""One member of a sweep: an experiment of any kind with some keys changed, computed wherever a worker is.

A worker need not see the sweep's folder: what members read is sent, and laid out in a folder of its own there.
"""

from __future__ import annotations

import copy
import hashlib
import json
import os
import shutil
import tempfile
import tomllib
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.config.load import check_section
from bayescal.config.sections import ExperimentConfig
from bayescal.errors import InputError, NumericalError
from bayescal.experiments.frame.load import AnyExperiment, find_kind, read_inputs
from bayescal.experiments.frame.memory import check_memory
from bayescal.experiments.frame.parallel import Run
from bayescal.files.toml import write_toml

type Setting = tuple[str, str, Any]
"""File, empty for the experiment itself, dotted key, and value."""

type Files = dict[str, bytes]

_laid_out: dict[str, Path] = {}


@dataclass(frozen=True)
class Base:
    """The experiment that members vary.

    Attributes
    ----------
    name : str
        Of its file.
    kind : str
    text : str
        Of the file.
    content : dict
        Of the file and what it extends, with the sweep's seed.
    files : dict of str to bytes
        All that members read, by names relative to the folder.
    """

    name: str
    kind: str
    text: str
    content: dict[str, Any]
    files: Files

    def vary(self, settings: tuple[Setting, ...], experiment: AnyExperiment, folder: Path) -> ExperimentConfig:
        """Return a member's checked config; InputError where its keys make none."""
        content = change(self.content, [(key, value) for file, key, value in settings if not file])
        config: ExperimentConfig = check_section(experiment.schema, content, folder / self.name, self.text)
        return config

    def vary_files(self, settings: tuple[Setting, ...]) -> Files:
        """Return the files that a member reads otherwise than they stand."""
        changed: Files = {}
        for file in dict.fromkeys(file for file, _, _ in settings if file):
            own = [(key, value) for other, key, value in settings if other == file]
            changed[file] = write_toml(change(tomllib.loads(self.files[file].decode()), own)).encode()
        return changed


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a member.

    Attributes
    ----------
    packed : ndarray of uint8
        JSON, as ``summary.json`` has it, compressed: thousands of members are held and kept; empty where it failed.
    failure : str
        Why it failed, or what forbids to rely on it.
    """

    packed: np.ndarray
    failure: str

    @classmethod
    def from_summary(cls, summary: Mapping[str, Any], failure: str = "") -> Outcome:
        """Return the outcome of a member that has a summary."""
        text = json.dumps(summary, ensure_ascii=False, allow_nan=False)
        return cls(np.frombuffer(zlib.compress(text.encode()), dtype=np.uint8), failure)

    @classmethod
    def from_failure(cls, failure: str) -> Outcome:
        """Return the outcome of a member that has none."""
        return cls(np.empty(0, dtype=np.uint8), failure)

    @property
    def has_summary(self) -> bool:
        """Whether it did not fail."""
        return self.packed.size > 0

    def read(self) -> dict[str, Any]:
        """Return the summary; nothing where there is none."""
        found: dict[str, Any] = json.loads(zlib.decompress(self.packed.tobytes())) if self.has_summary else {}
        return found


def compute_member(base: Base, settings: tuple[Setting, ...]) -> Outcome:
    """Return a member's summary, or why there is none."""
    with _go_to(base, settings) as folder:
        try:
            experiment = _find_kind(base.kind, folder)
            config = base.vary(settings, experiment, folder)
            inputs = read_inputs(experiment, config, folder)
            check_memory(experiment.estimate_memory(inputs), 1)
            results = experiment.compute(inputs, Run())
            return Outcome.from_summary(results.summary, "; ".join(experiment.list_failures(results)))
        except MemoryError as error:  # another time, or on another machine, it may do: such an outcome is not kept
            raise NumericalError("found no memory for it") from error
        except Exception as error:  # whatever it is, the other members go on, and it is listed
            known = isinstance(
                error, InputError | NumericalError | ArithmeticError | ValueError
            )  # LAPACK's are the last
            said = " ".join(str(error).split()).replace(f"{folder}{os.sep}", "")
            return Outcome.from_failure(said if known and said else f"{type(error).__name__}: {said}")


@lru_cache(maxsize=4)
def _find_kind(kind: str, folder: Path) -> AnyExperiment:
    """Return a kind; the folder's name stands for its content, so that its files are looked through once."""
    return find_kind(kind, folder, folder)


@contextmanager
def _go_to(base: Base, settings: tuple[Setting, ...]) -> Iterator[Path]:
    """Hold a folder with the files of a member: one of its own where these vary."""
    changed = base.vary_files(settings)
    if not changed:
        yield _lay_out_once(base.files)
        return
    with tempfile.TemporaryDirectory(prefix="bayescal_") as root:
        yield lay_out({**base.files, **changed}, Path(root))


def _lay_out_once(files: Files) -> Path:
    """Return a folder with files, the same as long as this process lives."""
    content = hash_files(files)
    if content not in _laid_out:
        root = tempfile.mkdtemp(prefix="bayescal_")
        Finalize(None, shutil.rmtree, (root, True), exitpriority=0)  # at the end of a worker process, too
        _laid_out[content] = lay_out(files, Path(root))
    return _laid_out[content]


def hash_files(files: Files) -> str:
    """Return the SHA-256 of files with their names."""
    whole = hashlib.sha256()
    for name, content in sorted(files.items()):
        whole.update(f"{name} {len(content)} ".encode() + content)
    return whole.hexdigest()


def lay_out(files: Mapping[str, bytes], root: Path) -> Path:
    """Write files below a root, so deep that names which lead upwards stay inside; return where names start."""
    names = {os.path.normpath(name): content for name, content in files.items()}
    depth = max((Path(name).parts.count(os.pardir) for name in names), default=0)
    folder = root.resolve().joinpath(*["in"] * depth)
    for name, content in names.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def split_key(key: str) -> tuple[str, str]:
    """Return the file that a key stands in, empty for the experiment itself, and the key within."""
    file, colon, inner = key.partition(":")
    return (file, inner) if colon else ("", key)


def change(content: Mapping[str, Any], settings: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return a config's content with values set by dotted keys; tables on the way are made where there are none.

    What no key leads through is not copied.

    Raises
    ------
    InputError
        Where a key leads through what is no table, or to an entry that a list has not.
    """
    changed: dict[str, Any] = dict(content)
    for key, value in settings:
        *way, last = key.split(".")
        place: Any = changed
        for part in way:
            place = _enter(place, part, key)
        if isinstance(place, dict):
            place[last] = value
        else:
            _step(place, last, key)
            place[int(last)] = value
    return changed


def _enter(place: Any, part: str, key: str) -> Any:
    """Return a copy of what stands at a part of a key, put in its place."""
    inner = place.get(part, {}) if isinstance(place, dict) else _step(place, part, key)
    own = copy.copy(inner)
    if isinstance(place, dict):
        place[part] = own
    elif isinstance(place, list):
        place[int(part)] = own
    return own


def _step(place: Any, part: str, key: str) -> Any:
    if isinstance(place, dict) and part in place:
        return place[part]
    if isinstance(place, list) and part.isdigit() and int(part) < len(place):
        return place[int(part)]
    raise InputError(f"{key}: found no {part!r} there, expected a key of the config")


def find(content: Mapping[str, Any], key: str) -> Any:
    """Return the value of a dotted key; InputError where there is none."""
    place: Any = content
    for part in key.split("."):
        place = _step(place, part, key)
    return place


def look_up(summary: Any, key: str) -> Any:
    """Return what a summary holds at a dotted key, whose parts may have dots of their own; None for nothing."""
    if not key:
        return summary
    if isinstance(summary, list):
        head, _, rest = key.partition(".")
        return look_up(summary[int(head)], rest) if head.isdigit() and int(head) < len(summary) else None
    if not isinstance(summary, dict):
        return None
    parts = key.split(".")
    for n in range(len(parts), 0, -1):
        head = ".".join(parts[:n])
        if head in summary and (found := look_up(summary[head], ".".join(parts[n:]))) is not None:
            return found
    return None
