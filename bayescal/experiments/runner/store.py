"""Where results live: finished work kept as it comes, the results directory replaced in one step.

``OUT.partial`` holds the finished tasks of a run, one file each, what determines them, and new results while they are
put together. ``OUT`` appears, or is replaced, only when everything in it is written: a killed run leaves the old
results or the new, never half. What others have put into either directory stays.
"""

from __future__ import annotations

import ctypes
import hashlib
import io
import json
import os
import shutil
import zipfile
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.errors import InputError
from bayescal.experiments.runner.identity import hash_identity, list_versions
from bayescal.experiments.runner.results import PROVENANCE_FILE
from bayescal.files.atomic import check_writable, read_json, resolve, write_atomically
from bayescal.files.manifest import add_others, list_written
from bayescal.numerics.geometry import Array

IDENTITY_FILE = "identity.json"
STAGED = "results"
CHECKSUM = "checksum"


@dataclass(frozen=True)
class Store:
    """The results directory of an experiment and the work in progress beside it."""

    out: Path
    run: str = ""  # what determines the run's numbers, as a hash; a task of another run counts as not finished
    again: bool = False  # whether results of the same config, of other data, may be replaced

    @property
    def partial(self) -> Path:
        """Directory of the finished tasks."""
        return self._beside(".partial")

    @property
    def staged(self) -> Path:
        """Directory in which new results are put together."""
        return self.partial / STAGED

    @property
    def lock(self) -> Path:
        """File that a run holds a lock on while it is under way."""
        return self._beside(".lock")

    def _beside(self, ending: str) -> Path:
        where = resolve(self.out)  # a link or "." has its neighbours where it points to
        return where.with_name(where.name + ending)

    # --- before the run ------------------------------------------------------------------------------------------

    def check_results(self, identity: dict[str, Any]) -> None:
        """Refuse to replace results of another config, or a directory that holds no results."""
        resolve(self.out)
        if not self.out.exists():
            return
        if os.path.ismount(self.out):
            raise InputError(f"{self.out}: found a mount point, expected a directory such as {self.out / 'results'}")
        provenance = self.out / PROVENANCE_FILE
        if not self.out.is_dir() or (not provenance.is_file() and any(self.out.iterdir())):
            raise InputError(f"{self.out}: holds no results, expected a new or a results directory")
        if provenance.is_file():
            known, wanted = read_json(provenance), hash_identity(identity)
            found, asked_again = known.get("config_sha256"), self.again and known.get("config") == identity["config"]
            may_replace = asked_again or _is_answered_further(known.get("config"), identity["config"])
            if found != wanted and not may_replace:
                raise InputError(
                    f"{self.out}: holds results of another config (sha256 {str(found)[:12]}, expected "
                    f"{wanted[:12]}); choose another --out or remove it"
                )

    def check(self, identity: dict[str, Any], resume: bool) -> None:
        """Refuse what `begin` would refuse, and results of another config, before anything is written."""
        self.check_results(identity)
        if resume:
            if not (self.partial / IDENTITY_FILE).is_file():
                raise InputError(f"{self.partial}: found no interrupted run")
            if changes := list_differences(read_json(self.partial / IDENTITY_FILE), identity):
                raise InputError(f"{self.partial}: cannot resume, the config differs: {'; '.join(changes)}")
        self._check_partial()
        check_writable(self.partial)

    def begin(self, identity: dict[str, Any], resume: bool) -> Store:
        """Make the partial directory ready, empty or with the tasks of the run to resume; return a store that knows it.

        InputError where there is nothing to resume, or it differs in what matters; the message names the differences.
        """
        self.check(identity, resume)
        begun = replace(self, run=hash_identity(identity))
        if resume:
            return begun
        self.discard()
        self.partial.mkdir(parents=True)
        write_atomically(self.partial / IDENTITY_FILE, json.dumps(identity, indent=1).encode())
        return begun

    def discard(self) -> None:
        """Remove the work in progress, and nothing else that stands there: it is of no use any more."""
        if not self.partial.is_dir():
            return
        shutil.rmtree(self.staged, ignore_errors=True)
        for path in self.partial.iterdir():
            if _is_ours(path) and path.name != IDENTITY_FILE:
                path.unlink(missing_ok=True)
        if {path.name for path in self.partial.iterdir()} <= {IDENTITY_FILE}:  # last: it says that this is a run's
            (self.partial / IDENTITY_FILE).unlink(missing_ok=True)
            self.partial.rmdir()

    def _check_partial(self) -> None:
        """Refuse to work in a directory that no run has made, or that holds what no run has."""
        if not self.partial.exists():
            return
        there = list(self.partial.iterdir()) if self.partial.is_dir() else [self.partial]
        if there and not any(path.name.removesuffix(".tmp") == IDENTITY_FILE for path in there):
            raise InputError(f"{self.partial}: found no interrupted run; remove it")
        for path in there:
            if not _is_ours(path) and path.name != STAGED:
                raise InputError(f"{path}: found no file of a run; move it")

    # --- tasks ---------------------------------------------------------------------------------------------------

    def save_task(self, key: str, arrays: dict[str, Array]) -> None:
        """Keep the arrays of a finished task, with a checksum that only this run's have."""
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **arrays, **{CHECKSUM: self._sum(arrays)})
        write_atomically(self.locate_task(key), buffer.getvalue())

    def locate_task(self, key: str) -> Path:
        """Return the file of a finished task."""
        return self.partial / f"{key}.npz"

    def load_task(self, key: str) -> dict[str, Array] | None:
        """Return the arrays of a finished task, or None; a damaged file, or another run's, counts as not finished."""
        path = self.locate_task(key)
        if not path.is_file():
            return None
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
        except (OSError, ValueError, EOFError, RuntimeError, AttributeError, TypeError, zipfile.BadZipFile):
            return None  # among them what a flipped bit looks like: an encrypted archive, a bare array
        found = arrays.pop(CHECKSUM, None)
        return arrays if found is not None and np.array_equal(found, self._sum(arrays)) else None

    def _sum(self, arrays: dict[str, Array]) -> Array:
        """Return the SHA-256, shape (32,), of the run and everything in its arrays."""
        digest = hashlib.sha256(self.run.encode())
        for name in sorted(arrays):
            values = np.ascontiguousarray(arrays[name])
            digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
            digest.update(values.tobytes())
        return np.frombuffer(digest.digest(), dtype=np.uint8)

    # --- after the run -------------------------------------------------------------------------------------------

    def stage(self) -> Path:
        """Return an empty directory beside the results to put new ones together in."""
        shutil.rmtree(self.staged, ignore_errors=True)
        self.staged.mkdir(parents=True)
        return self.staged

    def publish(self) -> None:
        """Put the staged results instead of the old ones in one step, then remove the old and the partial work.

        Files that the old run did not write stay in the results directory.
        """
        if self.out.exists():
            add_others(self.staged, _share_foreign(resolve(self.out), self.staged))
            _exchange(self.staged, resolve(self.out))
        else:
            self.staged.rename(resolve(self.out))
        self.discard()


def _is_answered_further(known: object, wanted: object) -> bool:
    """Whether results are a preliminary answer to a config that asks for more."""
    if not (isinstance(known, dict) and isinstance(wanted, dict) and isinstance(known.get("sampler"), dict)):
        return False
    efforts = [one.get("sampler", {}).get("effort") for one in (known, wanted)]
    plain = [
        {**one, "sampler": {**one.get("sampler", {}), "effort": None}} if isinstance(one.get("sampler"), dict) else one
        for one in (known, wanted)
    ]
    return efforts[0] == "quick" != efforts[1] and plain[0] == plain[1]


def _is_ours(path: Path) -> bool:
    """Whether a run has written a file of the partial directory."""
    name = path.name.removesuffix(".tmp")
    return (name == IDENTITY_FILE or name.endswith(".npz")) and path.is_file()


def _share_foreign(old: Path, new: Path) -> list[str]:
    """Let what a run has not written stand in its results and in those that are to replace them; return its names.

    Whoever is killed meanwhile loses none of it.
    """
    written, shared = list_written(old), []
    if written is None:  # nothing tells
        return []
    for path in sorted(old.rglob("*")):
        name = path.relative_to(old)
        if (path.is_dir() and not path.is_symlink()) or name.as_posix() in written or (new / name).exists():
            continue
        (new / name).parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(path, new / name, follow_symlinks=False)
        except OSError:  # a file system without such links
            shutil.copy2(path, new / name, follow_symlinks=False)
        shared.append(name.as_posix())
    return shared


def _exchange(one: Path, other: Path) -> None:
    """Exchange two directories, by one system call where the system has it."""
    exchange = 2  # RENAME_EXCHANGE
    at_cwd = -100  # AT_FDCWD
    function = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None) if os.name == "posix" else None
    if function is not None and function(at_cwd, os.fsencode(one), at_cwd, os.fsencode(other), exchange) == 0:
        return
    aside = one.with_name(f"{one.name}.old")
    other.rename(aside)
    one.rename(other)
    aside.rename(one)


def list_differences(old: object, new: object, where: str = "") -> list[str]:
    """Return the differences of two JSON values, each as ``key: old -> new``."""
    if isinstance(old, dict) and isinstance(new, dict):
        keys = sorted(set(old) | set(new))
        return [d for k in keys for d in list_differences(old.get(k), new.get(k), f"{where}.{k}" if where else str(k))]
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        pairs = zip(old, new, strict=True)
        return [d for k, (a, b) in enumerate(pairs) for d in list_differences(a, b, f"{where}[{k}]")]
    return [] if old == new else [f"{where}: {json.dumps(old)} -> {json.dumps(new)}"]


@dataclass(frozen=True)
class Pool(Store):
    """A folder of finished tasks whose names are hashes of all that determines them; ``out`` is the folder.

    A task computed by another bayescal, or with other versions of what numbers depend on, counts as not finished. The
    folder may be removed at any time: what is missing is computed again.
    """

    def locate_task(self, key: str) -> Path:
        """Return the file of a finished task, in one of 256 folders."""
        return self.out / key[-2:] / f"{key}.npz"

    def save_task(self, key: str, arrays: dict[str, Array]) -> None:
        """Keep a finished task; where another run keeps the same one just now, it may."""
        self.locate_task(key).parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError, FileNotFoundError):
            super().save_task(key, arrays)

    @property
    def partial(self) -> Path:
        """Directory of the finished tasks."""
        return self.out


def open_pool(folder: Path) -> Pool:
    """Return a folder's tasks, those of this bayescal and these versions."""
    return Pool(folder, json.dumps(list_versions(), sort_keys=True))
