"""From a sweep's config to its members: what varies, checked one setting at a time, and what the members read.

A member is computed wherever a worker is, which need not see the sweep's folder: the files that members read are sent.
"""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
import os
import tomllib
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.config.load import check_section, list_extended, merge, read_extended, read_toml
from bayescal.config.registry import hash_modules, list_sources
from bayescal.config.sections import ExperimentConfig
from bayescal.config.trust import permit, vouch
from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner.identity import hash_identity, identify
from bayescal.experiments.runner.load import AnyExperiment, find_kind, read_inputs
from bayescal.experiments.runner.memory import MemoryEstimate, check_memory
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Summary
from bayescal.experiments.sweep.schema import SEED, AxisConfig, SweepConfig
from bayescal.files.memory import MemoryPath
from bayescal.files.toml import write_toml

type Setting = tuple[str, str, object]
"""File, empty for the experiment itself, dotted key, and value."""

type Files = dict[str, bytes]


@dataclass(frozen=True)
class BaseExperiment:
    """The experiment that members vary."""

    name: str  # of its file
    kind: str
    text: str  # of the file
    content: dict[str, Any]  # of the file and what it extends, with the sweep's seed
    files: Files  # all that members read, by names relative to the folder

    @cached_property
    def folder(self) -> MemoryPath:
        """All that members read that do not vary their files."""
        return self.lay_out({})

    def lay_out(self, changed: Files) -> MemoryPath:
        """Return all that members read, some files otherwise than they stand."""
        files = {**self.files, **changed}
        return MemoryPath(files={os.path.normpath(name): content for name, content in files.items()})

    def list_code(self) -> Files:
        """Return the files among all that are code."""
        return {name: content for name, content in self.files.items() if name.endswith(".py")}

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
    """What became of a member."""

    # uint8: JSON of its summary, compressed, since thousands of members are held and kept; empty where it failed
    packed: np.ndarray
    failure: str  # why it failed, or what forbids to rely on it

    @classmethod
    def of(cls, failure: str, summary: Summary | None = None) -> Outcome:
        """Return the outcome of a member, of one that failed without a summary."""
        text = "" if summary is None else json.dumps(summary, ensure_ascii=False, allow_nan=False)
        return cls(np.frombuffer(zlib.compress(text.encode()) if text else b"", dtype=np.uint8), failure)

    @property
    def has_summary(self) -> bool:
        """Whether it did not fail."""
        return self.packed.size > 0

    def read(self) -> Summary:
        """Return the summary; nothing where there is none."""
        found: Summary = json.loads(zlib.decompress(self.packed.tobytes())) if self.has_summary else {}
        return found


def compute_member(base: BaseExperiment, settings: tuple[Setting, ...]) -> Outcome:
    """Return a member's summary, or why there is none."""
    vouch(base.list_code().values())  # read and trusted before members were handed to this process
    changed = base.vary_files(settings)
    folder = base.folder if not changed else base.lay_out(changed)
    try:
        experiment = _find_kind(base.kind, folder)
        config = base.vary(settings, experiment, folder)
        inputs = read_inputs(experiment, config, folder)
        check_memory(experiment.estimate_memory(inputs), 1)
        results = experiment.compute(inputs, Run())
        return Outcome.of("; ".join(experiment.list_failures(results)), results.summary)
    except MemoryError as error:  # another time, or on another machine, it may do: such an outcome is not kept
        raise NumericalError("too little memory") from error
    except Exception as error:  # whatever it is, the other members go on, and it is listed
        known = isinstance(error, InputError | NumericalError | ArithmeticError | ValueError)  # LAPACK's are the last
        said = " ".join(str(error).split())
        return Outcome.of(said if known and said else f"{type(error).__name__}: {said}")


@lru_cache(maxsize=4)
def _find_kind(kind: str, folder: Path) -> AnyExperiment:
    """Return a kind; the files of a folder are looked through once."""
    return find_kind(kind, folder, folder)


def split_key(key: str) -> tuple[str, str]:
    """Return the file that a key stands in, empty for the experiment itself, and the key within."""
    file, colon, inner = key.partition(":")
    return (file, inner) if colon else ("", key)


def change(content: Mapping[str, object], settings: Iterable[tuple[str, object]]) -> dict[str, Any]:
    """Return a config's content with values set by dotted keys; tables on the way are made where there are none.

    What no key leads through is not copied. InputError where a key leads through what is no table, or to an entry that
    a list has not.
    """
    changed: dict[str, Any] = dict(content)
    for key, value in settings:
        *way, last = key.split(".")
        place: Any = changed
        for part in way:  # a copy of what stands there, put in its place
            own = copy.copy(place.get(part, {}) if isinstance(place, dict) else _step(place, part, key))
            place[part if isinstance(place, dict) else int(part)] = own
            place = own
        if isinstance(place, dict):
            place[last] = value
        else:
            _step(place, last, key)
            place[int(last)] = value
    return changed


def _step(place: object, part: str, key: str) -> Any:
    if isinstance(place, dict) and part in place:
        return place[part]
    if isinstance(place, list) and part.isdigit() and int(part) < len(place):
        return place[int(part)]
    raise InputError(f"{key}: found no {part!r}, expected a key of the config")


def find(content: Mapping[str, object], key: str) -> Any:
    """Return the value of a dotted key; InputError where there is none."""
    place: Any = content
    for part in key.split("."):
        place = _step(place, part, key)
    return place


def look_up(summary: object, key: str) -> object:
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


def list_keys(summary: object, before: str = "") -> Iterator[str]:
    """Yield the dotted keys of all numbers of a summary."""
    inner = summary.items() if isinstance(summary, dict) else enumerate(summary) if isinstance(summary, list) else ()
    for key, value in inner:
        yield from list_keys(value, f"{before}{key}.")
    if isinstance(summary, int | float):
        yield before[:-1]


@dataclass(frozen=True, eq=False)
class SweepInputs:
    """What a sweep computes with."""

    config: SweepConfig
    folder: Path
    base: BaseExperiment
    experiment: AnyExperiment  # its kind
    sources: tuple[str, ...]  # files of the kind, where it is none of an installed package
    modules: dict[str, str]  # SHA-256 of the modules that somebody else's classes stand in
    extended: dict[str, tuple[str, ...]]  # each input file with those that it extends
    need: MemoryEstimate  # memory that a member takes, as the experiment stands

    def list_members(self) -> Iterator[tuple[tuple[object, ...], tuple[Setting, ...]]]:
        """Yield what each axis takes and what that sets, member by member; the last axis is the fastest."""
        axes = [list(zip(axis.settings, _list_settings(axis, self.base), strict=True)) for axis in self.config.axes]
        rows = itertools.product(*axes) if self.config.mode == "grid" else zip(*axes, strict=True)
        for row in rows:
            yield tuple(taken for taken, _ in row), tuple(one for _, settings in row for one in settings)

    def find_address(self, settings: tuple[Setting, ...]) -> str:
        """Return the hash of all that determines a member's summary; InputError where its config is none."""
        config = self.base.vary(settings, self.experiment, self.folder)
        own = [*self.experiment.files(config, self.folder), *self.sources]
        names = {one for name in own for one in self.extended.get(name, (name,))}
        changed = {name: hashlib.sha256(text).hexdigest() for name, text in self.base.vary_files(settings).items()}
        files = {name: changed.get(name) or self._hashes[name] for name in sorted(names)}
        return hash_identity({**identify(config, self.folder, (), self.modules), "files": files})

    @cached_property
    def _hashes(self) -> dict[str, str]:
        return {name: hashlib.sha256(content).hexdigest() for name, content in self.base.files.items()}


def read_sweep(config: SweepConfig, folder: Path) -> SweepInputs:
    """Return a sweep's base and axes; each entry of an axis by itself must make a config that its kind accepts.

    InputError for a key that is none, a value that its schema refuses, or input of the experiment as it stands at
    fault.
    """
    base = _read_base(config, folder)
    experiment, sources = find_kind(base.kind, folder, folder), list_sources("KINDS", base.kind, folder)
    standing = base.vary((), experiment, folder)
    need = experiment.estimate_memory(read_inputs(experiment, standing, folder))
    files = {*experiment.files(standing, folder), *sources}
    modules = hash_modules([type(experiment)]) | experiment.modules(standing, folder)
    single = [(k, one) for k, axis in enumerate(config.axes) for one in _list_settings(axis, base)]
    for number, settings in single:  # each entry of each axis by itself
        try:
            found = base.vary(settings, experiment, folder)
        except InputError as error:
            said = ", ".join(f"{key} = {json.dumps(value)}" for _, key, value in settings)
            raise InputError(f"axes.{number}: with {said}: {error}") from error
        files |= set(experiment.files(found, folder))
        modules |= experiment.modules(found, folder)
    extended = {name: list_extended(name, folder) for name in sorted(files)}
    contents = {name: _read_file(folder / name) for names in extended.values() for name in names}
    whole = BaseExperiment(base.name, base.kind, base.text, base.content, {**base.files, **contents})
    for name, code in whole.list_code().items():  # whatever members make of it
        permit({(folder / name).resolve(): code}, (folder / name).parent)
    for axis in config.axes:
        for file, _ in map(split_key, axis.keys):
            if file and file not in whole.files:
                raise InputError(f"{axis.name}: found no input file {file!r}")
    return SweepInputs(config, folder, whole, experiment, tuple(sources), modules, extended, need)


def _read_base(config: SweepConfig, folder: Path) -> BaseExperiment:
    """Return the experiment, with the files that its axes' keys stand in."""
    path = folder / config.experiment
    content, text = read_extended(path)
    kind = content.get("kind")
    if not isinstance(kind, str) or kind == config.kind:
        raise InputError(f"{path}: kind: found {kind!r}, expected no sweep")
    files = {file for axis in config.axes for file, _ in map(split_key, axis.keys) if file}
    contents = {name: _read_file(folder / name) for name in sorted({config.experiment, *files})}
    return BaseExperiment(
        config.experiment, kind, text, {**merge(content, config.overrides), SEED: config.seed}, contents
    )


def _list_settings(axis: AxisConfig, base: BaseExperiment) -> list[tuple[Setting, ...]]:
    """Return what each entry of an axis sets."""
    places = [split_key(key) for key in axis.keys]
    if axis.factors is None:
        return [tuple((file, key, value) for file, key in places) for value in axis.settings]
    now = [
        (file, key, find(tomllib.loads(base.files[file].decode()) if file else base.content, key))
        for file, key in places
    ]
    return [tuple((file, key, _multiply(key, value, one)) for file, key, value in now) for one in axis.factors]


def _multiply(key: str, value: object, factor: float) -> object:
    if isinstance(value, list):
        return [_multiply(key, one, factor) for one in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{key}: found {value!r}, expected numbers")
    return value * factor


def _read_file(path: Path) -> bytes:
    if path.suffix == ".toml":
        read_toml(path)  # a fault is one line
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error


def list_files(inputs: SweepInputs) -> list[str]:
    """Return all files that a sweep's results depend on, the experiment's and those that it extends first."""
    return list(dict.fromkeys([*list_extended(inputs.config.experiment, inputs.folder), *inputs.base.files]))
