"""Every experiment has one gate: what `validate` accepts `run` does not refuse; what is refused is refused alike."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from fuzz.hostile import dump_toml, list_places
from fuzz.judged import judge_call
from fuzz.subjects import QUICK
from fuzz.suite import cutting, hold_gate, look_and_run
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner import run as frame
from bayescal.experiments.simulation.kind import Simulation

SIMULATION = "own_machine/simulate.toml"
SCALARS = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.floats(0.01, 100.0),
    st.integers(-3, 200),
    st.booleans(),
    st.text(max_size=12),
    st.sampled_from(["x", "x[1]", "none", "independent", "free", "data/readings.csv"]),
)
VALUES = st.one_of(SCALARS, st.lists(SCALARS, max_size=3), st.dictionaries(st.text(min_size=1, max_size=5), SCALARS))


@contextmanager
def rewritten(path: Path, content: bytes) -> Iterator[None]:
    original = path.read_bytes()
    path.write_bytes(content)
    try:
        yield
    finally:
        path.write_bytes(original)


def change_config(content: dict[str, Any], data: st.DataObject) -> None:
    """Put a value somewhere into a config, or instead of another of its own."""
    places = list_places(content)
    *way, last = data.draw(st.sampled_from(places), label="place")
    holder: Any = content
    for key in way:
        holder = holder[key]
    own = st.sampled_from(list(_leaves(content)))
    holder[last] = data.draw(st.one_of(VALUES, own), label="value")


def _leaves(tree: Any) -> Iterator[Any]:
    if isinstance(tree, dict | list):
        for one in tree.values() if isinstance(tree, dict) else tree:
            yield from _leaves(one)
    else:
        yield tree


def change_cell(text: str, data: st.DataObject) -> str:
    """Put a value into a cell of a table."""
    rows = [line.split(",") for line in text.splitlines()]
    row = data.draw(st.sampled_from([k for k, one in enumerate(rows) if one[0][:1] != "#"]), label="row")
    column = data.draw(st.integers(0, len(rows[row]) - 1), label="column")
    rows[row][column] = data.draw(st.one_of(st.floats(), st.floats(-1e3, 1e3), st.sampled_from(["", "x"])).map(str))
    return "\n".join(",".join(one) for one in rows) + "\n"


def hold_changed(ground, folder: Path, data: st.DataObject) -> None:
    """Change a file of an experiment, and hold `validate` against `run`."""
    subject = ground.subjects[data.draw(st.sampled_from(sorted(QUICK)), label="experiment")]
    path = data.draw(st.sampled_from([one for one in subject.files if one.suffix in (".toml", ".csv")]), label="file")
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".csv":
        text = change_cell(text, data)
    else:
        content = tomllib.loads(text)
        change_config(content, data)
        text = dump_toml(content)
    with rewritten(path, text.encode("utf-8", "surrogatepass")), cutting():
        looked, ran = look_and_run(subject, folder)
    assert [*looked.faults, *ran.faults, *hold_gate(looked, ran)] == []


SETTINGS = {"deadline": None, "derandomize": True, "database": None}
ONCE = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large]


@settings(max_examples=25, suppress_health_check=ONCE, **SETTINGS)
@given(data=st.data())
def test_validate_and_run_have_one_gate(ground, tmp_path, data):
    hold_changed(ground, tmp_path, data)


@pytest.mark.slow
@settings(max_examples=1000, suppress_health_check=ONCE, **SETTINGS)
@given(data=st.data())
def test_validate_and_run_have_one_gate_for_many(ground, tmp_path, data):
    hold_changed(ground, tmp_path, data)


def test_what_there_is_no_memory_for_is_refused_by_both(ground, tmp_path, monkeypatch):
    monkeypatch.setattr("bayescal.experiments.runner.memory.measure_available", lambda: 1e8)
    monkeypatch.setattr(frame, "cpu_count", lambda: 1)  # as many processes as `run` is given here
    looked, ran = look_and_run(ground.subjects["own_machine/study.toml"], tmp_path)
    assert (looked.code, ran.code, looked.err.count("\n")) == (2, 2, 1)
    assert "memory: found" in looked.err
    assert hold_gate(looked, ran) == []


def test_code_that_results_cannot_keep_is_refused_before_computing(ground, tmp_path):
    folder, blocks = ground.root / "sweep", ["absent.py:Mine"]
    config = folder / "blocks.toml"
    config.write_text(f"page_sections = {blocks}\n" + (folder / "sweep.toml").read_text())
    looked, ran = judge_call(["validate", config]), judge_call(["run", config, "--out", tmp_path / "out", "--quiet"])
    assert (looked.code, ran.code) == (2, 2)
    assert looked.err == ran.err
    assert list(tmp_path.iterdir()) == []


def test_reading_that_fails_is_bad_input(ground, tmp_path, monkeypatch):
    def fail(*_: object) -> None:
        raise NumericalError("found no reading of the machine, expected one that stands")

    monkeypatch.setattr(Simulation, "read", fail)
    looked, ran = look_and_run(ground.subjects[SIMULATION], tmp_path)
    assert (looked.code, ran.code) == (2, 2)
    assert looked.err == ran.err


def test_what_is_refused_late_fails_and_leaves_nothing(ground, tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise InputError("found late")

    monkeypatch.setattr(Simulation, "compute", refuse)
    call = ["run", ground.root / SIMULATION, "--out", tmp_path / "a" / "out", "--quiet"]
    outcome = judge_call(call, tmp_path)
    assert (outcome.code, outcome.faults) == (3, ())
    assert f"found late ({frame.FOUND_LATE})" in outcome.err
    assert list(tmp_path.iterdir()) == []


def test_names_and_titles_have_a_length(ground):
    path = ground.root / SIMULATION
    content = tomllib.loads(path.read_text())
    for key, value, said in (("title", "x" * 2001, "found 2001 letters"), ("name", "x" * 101, "at most 100")):
        with rewritten(path, dump_toml(content | {key: value}).encode()):
            assert said in judge_call(["validate", path]).err
