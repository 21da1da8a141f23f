"""From a sweep's config to its members: what varies, checked one setting at a time, and what the members read."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from bayescal.config.load import EXTENDS, merge, read_extended, read_toml
from bayescal.config.registry import hash_modules, list_sources
from bayescal.errors import InputError
from bayescal.experiments.frame.identity import hash_identity, identify
from bayescal.experiments.frame.load import AnyExperiment, find_kind, read_inputs
from bayescal.experiments.frame.memory import Need
from bayescal.experiments.sweep.members import Base, Setting, find, split_key
from bayescal.experiments.sweep.schema import SEED, AxisConfig, SweepConfig


@dataclass(frozen=True, eq=False)
class SweepInputs:
    """What a sweep computes with.

    Attributes
    ----------
    config : SweepConfig
    folder : Path
    base : Base
    experiment : Experiment
        Its kind.
    sources : tuple of str
        Files of the kind, where it is none of an installed package.
    modules : dict of str to str
        SHA-256 of the modules that somebody else's classes stand in.
    extended : dict of str to tuple of str
        Each input file with those that it extends.
    need : Need
        Memory that a member takes, as the experiment stands.
    """

    config: SweepConfig
    folder: Path
    base: Base
    experiment: AnyExperiment
    sources: tuple[str, ...]
    modules: dict[str, str]
    extended: dict[str, tuple[str, ...]]
    need: Need

    def list_members(self) -> Iterator[tuple[tuple[Any, ...], tuple[Setting, ...]]]:
        """Yield what each axis takes and what that sets, member by member; the last axis is the fastest."""
        axes = [list(zip(axis.settings, _list_settings(axis, self.base), strict=True)) for axis in self.config.axes]
        rows = itertools.product(*axes) if self.config.combine == "grid" else zip(*axes, strict=True)
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

    Raises
    ------
    InputError
        For a key that is none, a value that its schema refuses, or input of the experiment as it stands at fault.
    """
    base = _read_base(config, folder)
    experiment, sources = find_kind(base.kind, folder, folder), list_sources("KINDS", base.kind, folder)
    standing = base.vary((), experiment, folder)
    need = experiment.estimate_memory(read_inputs(experiment, standing, folder))
    files = {*experiment.files(standing, folder), *sources}
    modules = hash_modules([type(experiment)]) | experiment.modules(standing, folder)
    for number, settings in _list_single(config, base):
        try:
            found = base.vary(settings, experiment, folder)
        except InputError as error:
            said = ", ".join(f"{key} = {json.dumps(value)}" for _, key, value in settings)
            raise InputError(f"axes.{number}: with {said}: {error}") from error
        files |= set(experiment.files(found, folder))
        modules |= experiment.modules(found, folder)
    extended = {name: _list_extended(name, folder) for name in sorted(files)}
    contents = {name: _read_file(folder / name) for names in extended.values() for name in names}
    whole = Base(base.name, base.kind, base.text, base.content, {**base.files, **contents})
    for axis in config.axes:
        for file, _ in map(split_key, axis.keys):
            if file and file not in whole.files:
                raise InputError(f"{axis.name}: found no file {file!r} that the experiment reads, expected one")
    return SweepInputs(config, folder, whole, experiment, tuple(sources), modules, extended, need)


def _read_base(config: SweepConfig, folder: Path) -> Base:
    """Return the experiment, with the files that its axes' keys stand in."""
    path = folder / config.experiment
    content, text = read_extended(path)
    kind = content.get("kind")
    if not isinstance(kind, str) or kind == config.kind:
        raise InputError(f"{path}: kind: found {kind!r}, expected an experiment that is no sweep")
    files = {file for axis in config.axes for file, _ in map(split_key, axis.keys) if file}
    contents = {name: _read_file(folder / name) for name in sorted({config.experiment, *files})}
    return Base(config.experiment, kind, text, {**merge(content, config.set), SEED: config.seed}, contents)


def _list_single(config: SweepConfig, base: Base) -> Iterator[tuple[int, tuple[Setting, ...]]]:
    """Yield each entry of each axis by itself, with the axis' number."""
    for number, axis in enumerate(config.axes):
        for settings in _list_settings(axis, base):
            yield number, settings


def _list_settings(axis: AxisConfig, base: Base) -> list[tuple[Setting, ...]]:
    """Return what each entry of an axis sets."""
    places = [split_key(key) for key in axis.keys]
    if axis.factors is None:
        return [tuple((file, key, value) for file, key in places) for value in axis.settings]
    now = [(file, key, find(base.content if not file else _parse(base, file), key)) for file, key in places]
    return [tuple((file, key, _multiply(key, value, one)) for file, key, value in now) for one in axis.factors]


def _parse(base: Base, file: str) -> dict[str, Any]:
    return tomllib.loads(base.files[file].decode())


def _multiply(key: str, value: Any, factor: float) -> Any:
    if isinstance(value, list):
        return [_multiply(key, one, factor) for one in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{key}: found {value!r}, expected numbers to multiply by factors")
    return value * factor


def _read_file(path: Path) -> bytes:
    if path.suffix == ".toml":
        read_toml(path)  # a fault is one line
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}), expected a file of the experiment") from error


def _list_extended(name: str, folder: Path) -> tuple[str, ...]:
    """Return a file with those that it extends, where it is TOML that does."""
    found = [name]
    while found[-1].endswith(".toml") and (folder / found[-1]).is_file():
        base = read_toml(folder / found[-1])[0].get(EXTENDS)
        other = os.path.normpath(Path(found[-1]).parent / base) if isinstance(base, str) else ""
        if not other or other in found:
            break
        found.append(other)
    return tuple(found)


def list_files(inputs: SweepInputs) -> list[str]:
    """Return all files that a sweep's results depend on, the experiment's and those that it extends first."""
    return list(dict.fromkeys([*_list_extended(inputs.config.experiment, inputs.folder), *inputs.base.files]))
