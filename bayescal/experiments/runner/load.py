"""From a TOML file to a kind of experiment and its checked config; and all that a config can name."""

from __future__ import annotations

import contextlib
import inspect
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from bayescal.config.built_in import BUILT_IN, describe_built_in
from bayescal.config.load import check_section, read_extended
from bayescal.config.registry import REGISTRIES, find_class, is_own, list_names, list_references, load_class
from bayescal.config.sections import ExperimentConfig
from bayescal.errors import InputError, NumericalError, say_unknown
from bayescal.experiments import SCHEMAS, USES
from bayescal.experiments.runner.experiment import Experiment
from bayescal.experiments.runner.memory import check_tables

type AnyExperiment = Experiment[Any, Any]

TITLES = {
    "KINDS": "Experiments",
    "BLOCKS": "Page blocks",
    "CLAIMS": "Claims",
    "MACHINES": "Machines",
    "INSTRUMENTS": "Instruments",
    "READERS": "Readers of data",
    "MODELS": "Kinematic models",
    "DEFORMATIONS": "Deformations",
    "ERRORS": "Reading errors",
    "SAMPLERS": "Samplers",
    "SENSORS": "Audit sensors",
    "CRITERIA": "Selection criteria",
    "METHODS": "Selection methods",
}


def find_kind(kind: str, file: Path | None, folder: Path | None) -> AnyExperiment:
    """Return a kind of experiment by its name; see `registry.find_class`."""
    base: type[AnyExperiment] = Experiment  # type: ignore[type-abstract]  # only subclasses of it are found
    if kind in USES:
        return find_class("KINDS", USES[kind], base, "kind", file, Path())()
    return find_class("KINDS", kind, base, "kind", file, folder)()


def load(path: Path) -> tuple[AnyExperiment, ExperimentConfig]:
    """Return an experiment's kind and its checked config; its ``kind`` says which schema holds.

    A file without a kind that names a ``study`` asks which pose to measure next. InputError for anything at fault, with
    file, line, field, found and expected.
    """
    content, text = read_extended(path)
    kind = content.get("kind", "next_pose" if "study" in content else None)
    if not isinstance(kind, str):
        found, names = repr(kind), ", ".join(sorted(list_references("KINDS")))
        if "legs" in content and "platform" in content:
            found = "none in a mechanism's file"
        raise InputError(f"{path}: kind: found {found}, expected one of {names}")
    return check_content(content | {"kind": kind}, path, text)


def check_content(content: dict[str, Any], path: Path, text: str = "") -> tuple[AnyExperiment, ExperimentConfig]:
    """Return the kind and the checked config of a content as a file has it, read from a file or not.

    Names of files start at the folder of ``path``, the file's lines are those of ``text``.
    """
    experiment = find_kind(str(content["kind"]), path, path.parent)
    return experiment, check_section(experiment.schema, content, path, text)


def read_inputs(experiment: AnyExperiment, config: ExperimentConfig, folder: Path) -> Any:
    """Return what an experiment computes with, read if there is memory for its files; InputError for any fault."""
    names: list[str] = []
    with contextlib.suppress(InputError):  # reading says it better
        names = experiment.files(config, folder)
    check_tables(folder / name for name in names)
    try:
        return experiment.read(config, folder)
    except NumericalError as error:  # nothing was accepted yet
        raise InputError(str(error)) from error


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
        raise InputError(f"{path}: kind: found {config.kind!r}, expected {kind!r}; or use bayescal run")
    return config


@dataclass(frozen=True)
class Entry:
    """One name: what it is in a sentence, and whether somebody else's package brings it."""

    name: str
    text: str
    own: bool


def list_sorts() -> dict[str, str]:
    """Return what can be listed, with its title: ``kinds`` to ``Kinds of experiment``."""
    return {what.lower(): TITLES[what] for what in REGISTRIES}


def list_entries(sort: str) -> list[Entry]:
    """Return all names of a sort, in order; InputError for another sort."""
    what = sort.upper()
    if what not in REGISTRIES:
        raise InputError(say_unknown("list", sort, list_sorts()))
    return [_describe(what, name) for name in list_names(what)]


def _describe(what: str, name: str) -> Entry:
    if name in BUILT_IN[what]:
        return Entry(name, describe_built_in(what, name), own=False)
    try:
        found = load_class(what, name, None)
    except InputError as error:  # of an installed package that is broken: the others are listed all the same
        return Entry(name, str(error), own=True)
    text = (inspect.getdoc(found) or "").partition("\n\n")[0]
    return Entry(name, " ".join(text.split()), is_own(found))


def describe_schema(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind's config, for editors; InputError for an unknown kind."""
    if kind not in {*list_names("KINDS"), *USES}:
        raise InputError(say_unknown("schema", kind, list_names("KINDS")))
    if kind in SCHEMAS:
        module, _, name = SCHEMAS[kind].partition(":")
        found: type[ExperimentConfig] = getattr(import_module(module), name)
    else:
        found = find_kind(kind, None, None).schema
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **found.model_json_schema()}
