"""Sessions as a user runs them: what moved is found, expansion is told apart, and what is at fault is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import reading_sessions
import session_studies
import studies

from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import run_experiment
from bayescal.experiments.sessions import inputs
from bayescal.experiments.shared.slips import FoundSlip

pytestmark = pytest.mark.runs

MADE = {"legs": session_studies, "channels": reading_sessions}
MOVED = {
    "legs": ("legs", "leg", session_studies.LEG, ("S1", "S3"), 40.0, 5.0),
    "channels": ("shifts", "parameter", f"s0[{reading_sessions.COLUMN}]", ("M1", "M3"), 80.0, 10.0),
}
"""By what is measured: table and column of what moved, what it is, since when, four sd at most [µm], log-evidence."""


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return {name: one.write_sessions(tmp_path_factory.mktemp(name)) for name, one in MADE.items()}


@pytest.fixture(scope="module", params=MADE)
def finished(request, written):
    path = written[request.param]
    return request.param, run_experiment(load(path)[1], path.parent, path.parent / "out")


def test_what_moved_is_found(finished):
    name, found = finished
    table, column, place, (since, until), widest, least = MOVED[name]
    shifts = found.results.table(table)
    whole = shifts[(shifts["since"] == since) & (shifts["session"] == until)].set_index(column)
    moved, sd = whole.loc[place, ["mean", "sd"]]
    assert abs(moved - MADE[name].MOVED_UM[2]) < 4.0 * sd < widest
    others = whole.drop(place)
    assert (np.abs(others["mean"]) < 4.0 * others["sd"]).all()
    assert found.summary["log_evidence_drift"] > least


def test_expansion_is_told_apart_from_drift(finished):
    name, found = finished
    one = found.results.table("expansion").iloc[0]
    assert one["body"] == {"legs": "struts", "channels": "rods"}[name]
    assert abs(one["mean"] - MADE[name].PPM) < 4.0 * one["sd"]
    assert one["sd"] < {"legs": 0.9, "channels": 0.5}[name] * one["prior_sd"]


def test_every_number_of_the_page_has_its_status(finished):
    name, found = finished
    models = found.results.table("models")
    assert (models["exact_efficiency"] > 0.9).all()
    page = (found.results.folder / "report.html").read_text()
    assert f"<h2>Motion of the {name}" in page
    assert "Expansion" in page
    if name == "channels":
        shifts, channels = found.results.table("shifts"), found.results.table("channels")
        assert list(channels["channel"].unique()) == ["s[1]", "s[2]", "s[3]"]
        assert set(channels["unit"]) == {"µm"}  # a carriage reads less by as much as its zero moves up
        np.testing.assert_allclose(channels["mean"], -shifts["mean"], atol=1e-6)
        return
    assert list(models["model"]) == ["drift", "no drift"]  # one scale: nothing to hold still by itself
    assert all(found.summary["reliable"].values())
    assert len(found.results.table("parameters")) == 3 * 6


def edit(old: str, new: str, file: str = "") -> Callable[[Path], None]:
    return lambda path: studies.edit(path.parent / file if file else path, old, new)


def warm(text: str) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        (path.parent / "warm.csv").write_text(text)
        studies.edit(path, "temperature_celsius = 20.0", 'temperatures = "warm.csv"')

    return change


def exchange(path: Path) -> None:
    table = pd.read_csv(path.parent / "month_2.csv")
    table[["s_1_mm", "s_2_mm"]] = table[["s_2_mm", "s_1_mm"]].to_numpy()
    table.to_csv(path.parent / "month_2.csv", index=False)


FUNCTION = '[error_terms.motors]\nchannels = ["s"]\nkernel = "quadratic"\nscale_um = 20.0\nshared = false\n\n[sampler]'
FAULTS_OF_LEGS = {
    "missing": (edit("data/2/targets.csv", "data/7/targets.csv"), r"data/7/targets\.csv: no such file"),
    "no temperature": (edit("temperature_celsius = 20.0", ""), "session 'S2': found no temperature"),
    "no column": (warm("pose,kelvin\nC01,3.0\n"), "found column 'kelvin'.* expected pose, temperature_celsius"),
    "no pose": (warm("pose,temperature_celsius\nC01,3.0\n"), "pose 'C02': missing"),
    "other machine": (
        lambda path: session_studies.write_other_machine(path.parent),
        "session 'S2': found leg . off by",
    ),
    "copied": (
        lambda path: path.write_text(path.read_text().replace("data/2/", "data/1/")),
        "session 'S2': found the readings of 'S1'",
    ),
    "order": (edit("time_days = 60.0", "time_days = 20.0"), "session 'S2': found time_days 20 after 30"),
    "no day": (edit("time_days = 60.0", ""), "session 'S2': found no time_days"),
    "twice": (edit('label = "S2"', 'label = "S1"'), "found 'S1' twice"),
    "variant": (edit("six_pus/none", "six_pus/linear"), "variant: found 'six_pus/linear', expected"),
    "symbol": (edit('symbols = ["l"]', 'symbols = ["a_x"]'), "found 'a_x', expected one of l"),
    "instrument": (
        edit('actuators = "data/2', 'probe = "data/2'),
        "session 'S2': data: found probe, expected none for",
    ),
    "uniform": (
        edit('{ prior = "normal", sd = 2.0 }', '{ prior = "uniform", half_width = 2.0 }', "study.toml"),
        "found a uniform prior of l",
    ),
}
FAULTS_OF_CHANNELS = {
    "missing": (edit("month_2.csv", "month_7.csv"), r"month_7\.csv: no such file"),
    "no readings": (edit('data = [{ file = "month_2.csv" }]\n', ""), "sessions.1.data: missing"),
    "of legs": (
        edit('"month_2.csv" }', '"month_2.csv", actuators = "a.csv" }'),
        "data: found actuators, expected none for readings",
    ),
    "copied": (edit("month_2.csv", "month_1.csv"), "session 'M2': found the readings of 'M1'"),
    "slipped": (exchange, r"session 'M2': .*readings of s\[1\] and s\[2\] seem to be exchanged"),
    "symbol": (edit('symbols = ["s0"]', 'symbols = ["q"]'), "drift.symbols: found 'q', expected one of x, y, l, s0"),
    "angle": (edit('symbols = ["s0"]', 'symbols = ["t_x"]'), "found 't_x' in rad without scale_arcsec"),
    "body": (edit('symbols = ["l"]', 'symbols = ["t_x"]'), "thermal.rods: found no length 't_x'"),
    "struts": (edit('bodies.rods = { symbols = ["l"],', "base = {"), "thermal.base: found no length 'a_x'"),
    "variant": (edit('variant = "one_rod"', 'variant = "rods"'), "variant: found 'rods', expected one of all"),
    "which variant": (edit('variant = "one_rod"\n', ""), "variant: found 'none', expected one of all, one_rod"),
    "robust": (
        edit('tied = ["l"]', 'tied = ["l"]\nstudent_t_dof = 4.0', "study.toml"),
        "found a robust variant, expected another",
    ),
    "common": (
        edit("[sampler]", FUNCTION, "study.toml"),
        r"found functions of \[error_terms\]",
    ),
    "uniform": (
        edit('s0 = { prior = "normal", sd', 's0 = { prior = "uniform", half_width', "study.toml"),
        r"found a uniform prior of s0\[1\]",
    ),
}
CASES = [("legs", one) for one in FAULTS_OF_LEGS.values()] + [("channels", one) for one in FAULTS_OF_CHANNELS.values()]


@pytest.mark.parametrize(("name", "fault"), CASES, ids=[*FAULTS_OF_LEGS, *FAULTS_OF_CHANNELS])
def test_what_is_at_fault_is_one_line(name, fault, written, refuse, tmp_path):
    path = session_studies.copy_sessions(written[name], tmp_path / "here")
    change, expected = fault
    change(path)
    refuse(expected, path.parent / "new", "run", path, "--workers", "1")


def test_several_machines_take_no_days(written, tmp_path):
    """Another machine is welcome where several are stated; a pose's own temperature counts as the session's does."""
    path = session_studies.copy_sessions(written["legs"], tmp_path)
    session_studies.write_other_machine(tmp_path)
    text = (
        path.read_text().replace("[drift]", '[drift]\nmodel = "population"').replace("scale_um = 20", "scale_um = 999")
    )
    rows = "".join(f"C{k:02d},20.0\n" for k in range(1, 14))
    (tmp_path / "warm.csv").write_text(f"pose,temperature_celsius\n{rows}")
    text = text.replace("temperature_celsius = 20.0", 'temperatures = "warm.csv"')
    path.write_text(re.sub(r"(?m)^time_days = .*$", "", text))
    kind, config = load(path)
    model = kind.read(config, tmp_path).model
    np.testing.assert_array_equal(model.drift.loadings, np.eye(3))
    assert [part.warmth for part in model.parts] == [-5.0, 0.0, 5.0]


def test_the_only_variant_of_a_study_needs_no_name(written, tmp_path):
    path = session_studies.copy_sessions(written["legs"], tmp_path)
    edit('variant = "six_pus/none"\n', "")(path)
    kind, config = load(path)
    assert kind.read(config, tmp_path).first.name == "six_pus/none"


def test_temperatures_that_nothing_is_made_of_are_doubted(written, call, tmp_path):
    path = session_studies.copy_sessions(written["legs"], tmp_path)
    text = path.read_text()
    path.write_text(text.replace(session_studies.THERMAL, ""))
    code, said, _ = call("validate", path)
    assert code == 0
    assert "without [thermal]" in said


def test_a_denied_slip_is_said_and_not_refused(written, tmp_path, monkeypatch):
    found = FoundSlip("rows", "rows of s seem to be shifted by one", 50.0, 4.0)
    monkeypatch.setattr(inputs, "find_slip", lambda measured, denied=(): None if "rows" in denied else found)
    path = session_studies.copy_sessions(written["channels"], tmp_path)
    for k in (1, 2, 3):
        studies.edit(path, f'label = "M{k}"', f'label = "M{k}"\nignored_data_errors = ["rows"]')
    kind, config = load(path)
    assert {f"month_{k}.csv" for k in (1, 2, 3)} <= set(kind.files(config, tmp_path))  # results belong to all of them
    denied = kind.read(config, tmp_path).denied
    assert denied[1] == f"Session 'M2': {found.say()}"
