"""Every key of every TOML file is described, has a unit where it is a number, and an example that its schema takes."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from pydantic import TypeAdapter, ValidationError

DOCS = Path(__file__).parents[1] / "docs"
sys.path.insert(0, str(DOCS / "_extensions"))

import references  # noqa: E402  # stands beside the pages that it writes


@pytest.fixture(scope="module")
def keys():
    places = {
        place.schema for _, _, schema in references.list_schemas().values() for place in references.list_places(schema)
    }
    return [(schema, name, info) for schema in places for name, info in schema.model_fields.items()]


@pytest.fixture(scope="module")
def examples():
    return references.collect_examples()


def test_every_key_is_described_and_numbers_have_units(keys):
    assert len(keys) > 500
    for schema, name, info in keys:
        meaning, unit = references.split_unit(schema, name)
        assert meaning, f"{schema.__name__}.{name} has no docstring below it"
        assert unit or not references.has_numbers(info.annotation), f"{schema.__name__}.{name} has no [unit]"


def test_every_key_has_an_example(keys, examples):
    for schema, name, _ in keys:
        assert references.find_example(schema, name, examples), f"{schema.__name__}.{name}"


def test_given_examples_are_valid_and_needed(keys, examples):
    given = {(section, name): one for section, keys in references.read_given().items() for name, one in keys.items()}
    for schema, name, info in keys:
        if (schema.__name__, name) in given:
            assert (schema, name) not in examples
            value = given.pop((schema.__name__, name))
            annotation = references.unwrap(info.annotation)
            try:
                TypeAdapter(annotation).validate_python(value)
            except ValidationError as error:
                pytest.fail(f"{schema.__name__}.{name}: {error}")
    assert not given


def test_every_column_of_every_table_is_described():
    page = references.write_tables()
    for kind in references.list_kinds().values():
        for row in kind.rows:
            assert f"### {row.table}.csv" in page
            for one in row.list_columns():
                assert one.meaning, f"{row.__name__}.{one.name} has no meaning"
                assert f"`{one.name}`" in page


def test_every_page_is_written(examples):
    for title, text, schema in references.list_schemas().values():
        assert f"# {title}" in references.write_page(title, text, schema, examples)


def test_a_page_of_a_kind_has_its_keys(examples):
    _, _, schema = references.list_schemas()["kind_study"]
    page = references.write_page("study", "", schema, examples)
    row = "| `target_noise_um` | Standard deviation of a target's coordinates.<br>`target_noise_um = 10.0` | µm |"
    assert row in page
    assert '## `[[data]]` with `kind = "poses"`' in page
    assert "## `[[variants]]`" in page
    assert "`[parameters.NAME]`" in page
