"""What a config can name: kinds, models, sensors and whatever else is looked up, built-in ones and own ones."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import Any

from bayescal.config.registry import REGISTRIES, is_own, list_references, load_class
from bayescal.errors import InputError
from bayescal.experiments import USES
from bayescal.experiments.frame.load import find_kind

TITLES = {
    "KINDS": "Kinds of experiment",
    "BLOCKS": "Blocks of pages",
    "CLAIMS": "Claims of publications",
    "MACHINES": "Machines of one function",
    "INSTRUMENTS": "Instruments beside a machine",
    "MODELS": "Kinematic models",
    "DEFORMATIONS": "Deformations of the platform",
    "ERRORS": "Errors of readings",
    "SENSORS": "Sensors of an audit",
    "CRITERIA": "Criteria of pose selection",
    "METHODS": "Methods of pose selection",
}


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
        raise InputError(f"list: found {sort!r}, expected one of {', '.join(list_sorts())}")
    return [_describe(what, name) for name in sorted(list_references(what))]


def _describe(what: str, name: str) -> Entry:
    try:
        found = load_class(what, name, None)
    except InputError as error:  # of an installed package that is broken: the others are listed all the same
        return Entry(name, str(error), own=True)
    text = (inspect.getdoc(found) or "").partition("\n\n")[0]
    return Entry(name, " ".join(text.split()), is_own(found))


def describe_schema(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind's config, for editors; InputError for an unknown kind."""
    if kind not in {**list_references("KINDS"), **USES}:
        raise InputError(f"schema: found {kind!r}, expected one of {', '.join(sorted(list_references('KINDS')))}")
    schema: dict[str, Any] = find_kind(kind, None, None).schema.model_json_schema()  # type: ignore[arg-type]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
