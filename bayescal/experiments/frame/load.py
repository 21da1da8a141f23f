"""From a TOML file to a kind of experiment and its checked config."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayescal.config.load import check_section, read_extended
from bayescal.config.registry import find_class, list_references
from bayescal.config.sections import ExperimentConfig
from bayescal.errors import InputError
from bayescal.experiments import GONE, KINDS, USES
from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.memory import check_tables

type AnyExperiment = Experiment[Any, Any]


def find_kind(kind: str, where: Path, folder: Path | None) -> AnyExperiment:
    """Return a kind of experiment by its name; see `registry.find_class`."""
    if kind in GONE:
        successor = repr(GONE[kind]) if GONE[kind] in KINDS else GONE[kind]
        raise InputError(f"{where}: kind: found {kind!r}, which is gone, expected {successor}")
    base: type[AnyExperiment] = Experiment  # type: ignore[type-abstract]  # only subclasses of it are found
    if kind in USES:
        return find_class("KINDS", USES[kind], base, "kind", where, Path())()
    return find_class("KINDS", kind, base, "kind", where, folder)()


def load(path: Path) -> tuple[AnyExperiment, ExperimentConfig]:
    """Return an experiment's kind and its checked config; its ``kind`` says which schema holds.

    A file without a kind that names a ``study`` asks which pose to measure next.

    Raises
    ------
    InputError
        For anything at fault, with file, line, field, found and expected.
    """
    content, text = read_extended(path)
    kind = content.get("kind", "next" if "study" in content else None)
    if not isinstance(kind, str):
        names = ", ".join(sorted(list_references("KINDS")))
        raise InputError(f"{path}: kind: found {_describe(content)}, expected one of {names}")
    experiment = find_kind(kind, path, path.parent)
    return experiment, check_section(experiment.schema, content, path, text)


def read_inputs(experiment: AnyExperiment, config: ExperimentConfig, folder: Path) -> Any:
    """Return what an experiment computes with, read if there is memory for its files.

    Raises
    ------
    InputError
        For anything at fault in the config or its files.
    """
    names: list[str] = []
    with contextlib.suppress(InputError):  # reading says it better
        names = experiment.files(config, folder)
    check_tables(folder / name for name in names)
    return experiment.read(config, folder)


def _describe(content: Mapping[str, Any]) -> str:
    """Return what a file without a kind of experiment has, or is."""
    if "legs" in content and "platform" in content:
        return "none in a machine's file, which an experiment names as its mechanism"
    return repr(content.get("kind"))


def load_experiment(path: Path | str) -> Any:
    """Return the checked config of an experiment of any kind; InputError for anything at fault.

    Examples
    --------
    >>> config = bc.load_experiment("examples/own_machine/audit.toml")
    >>> config.name, config.model_copy(update={"seed": 7}).seed
    ('own_machine_audit', 7)
    """
    return load(Path(path))[1]


def load_kind(path: Path, kind: str) -> Any:
    """Return the checked config of an experiment that must be of a kind."""
    config = load(path)[1]
    if config.kind != kind:
        raise InputError(f"{path}: kind: found {config.kind!r}, expected {kind!r}; bayescal run takes any kind")
    return config
