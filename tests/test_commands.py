"""Commands that compute nothing: the version, help, what can be named, schemas for editors, a look at a config."""

from __future__ import annotations

import inspect
import json
import re
import tomllib
from importlib.metadata import version

import pytest
import studies

import bayescal
from bayescal.config.built_in import BUILT_IN, describe_built_in
from bayescal.config.registry import REGISTRIES, is_own, list_references, load_class
from bayescal.experiments import KINDS, SCHEMAS, USES
from bayescal.experiments.runner.load import TITLES, find_kind, list_entries


def test_version(call):
    assert call("--version") == (0, f"bayescal {version('bayescal')}\n", "")


def test_the_version_stands_in_one_place(pytestconfig):
    with (pytestconfig.rootpath / "pyproject.toml").open("rb") as file:
        stated = tomllib.load(file)["project"]["version"]
    assert bayescal.__version__ == version("bayescal") == stated
    assert f"\nversion: {stated}\n" in (pytestconfig.rootpath / "CITATION.cff").read_text()


def test_everything_that_can_be_named_is_listed(call):
    code, said, _ = call("list")
    assert code == 0
    assert set(TITLES) == set(REGISTRIES)
    for what in REGISTRIES:
        assert TITLES[what] in said
        for name in list_references(what):
            assert f"\n  {name}: " in said
    assert all(entry.text and not entry.own for what in REGISTRIES for entry in list_entries(what.lower()))

    one = call("list", "models")[1]
    assert "six_pus" in one
    assert "exchange" not in one


def test_names_known_without_their_modules_are_those_of_the_classes():
    for what in REGISTRIES:
        found = {name: load_class(what, name, None) for name in list_references(what)}
        first = {name: inspect.getdoc(one).partition("\n\n")[0] for name, one in found.items() if not is_own(one)}
        told = {name: describe_built_in(what, name) for name in BUILT_IN[what]}
        assert told == {name: " ".join(text.split()) for name, text in first.items()}
        assert BUILT_IN[what] == {name: list_references(what)[name] for name in first}


def test_schemas_known_without_their_kinds_are_those_of_the_kinds():
    schemas = {kind: find_kind(kind, None, None).schema for kind in (*KINDS, *USES)}
    assert {kind: f"{one.__module__}:{one.__name__}" for kind, one in schemas.items()} == SCHEMAS


@pytest.mark.parametrize(("command", "name"), [("list", "modles"), ("schema", "studdy")])
def test_an_unknown_name_is_told_the_known_ones(command, name, call):
    code, _, complaint = call(command, name)
    assert code == 2
    assert f"{command}: found {name!r}, " in complaint


@pytest.mark.parametrize("kind", sorted(list_references("KINDS")))
def test_schema_of_every_kind(call, kind):
    code, said, _ = call("schema", kind)
    assert code == 0
    schema = json.loads(said)
    assert schema["properties"]["kind"]["const"] == kind
    assert schema["additionalProperties"] is False
    assert {"name", "seed"} <= set(schema["properties"])


def test_schema_knows_the_classes_that_can_be_named(call):
    text = call("schema", "study")[1]
    assert all(f'"{name}"' in text for name in (*list_references("MODELS"), *list_references("DEFORMATIONS")))


def test_a_config_is_looked_at_without_running_it(call, tmp_path):
    path = studies.write_tiny_study(tmp_path)
    before = studies.snapshot(tmp_path)
    code, said, complaint = call("validate", path)
    assert (code, complaint) == (0, "")
    assert "fit to run, a study 'tiny' (Tiny study)" in said
    assert re.search(r"\b13 rows .*\b12 \+ 78 unknowns", said)
    assert "data/targets.csv" in said
    assert f"bayescal run {path}" in said
    assert "bayescal simulate" in call("validate", tmp_path / "simulate.toml")[1]
    studies.edit(path, "data/actuators.csv", "data/actuator.csv")
    code, said, complaint = call("validate", path)
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert "actuator.csv:" in complaint
    studies.edit(path, "data/actuator.csv", "data/actuators.csv")
    assert studies.snapshot(tmp_path) == before
