"""Sessions as a user runs them: what moved is found, the temperature is told apart, and what is at fault is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import session_studies
import studies

from bayescal.experiments.frame.load import load
from bayescal.experiments.frame.run import run_experiment
from bayescal.report.pictures import Picture

pytestmark = pytest.mark.runs


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return session_studies.write_sessions(tmp_path_factory.mktemp("sessions"))


@pytest.fixture(scope="module")
def finished(written):
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("bayescal.report.page.render_picture", lambda draw, stacked=True: Picture(b"not drawn"))
        return run_experiment(load(written)[1], written.parent, written.parent / "out")


def test_the_leg_that_moved_is_found(finished):
    legs = finished.results.table("legs")
    whole = legs[(legs["since"] == "S1") & (legs["session"] == "S3")].set_index("leg")
    moved, sd = whole.loc[session_studies.LEG, ["mean", "sd"]]
    truth = session_studies.MOVED_UM[2]
    assert abs(moved - truth) < 4.0 * sd < 40.0
    others = whole.drop(session_studies.LEG)
    assert (np.abs(others["mean"]) < 4.0 * others["sd"]).all()
    assert finished.summary["log_evidence_drift"] > 5.0
    assert "moved, odds of" in finished.summary["headline"]


def test_expansion_is_told_apart_from_drift(finished):
    one = finished.results.table("expansion").iloc[0]
    assert abs(one["mean"] - session_studies.PPM) < 4.0 * one["sd"]
    assert one["sd"] < 0.9 * one["prior_sd"]


def test_every_number_of_the_page_has_its_status(finished):
    models = finished.results.table("models")
    assert list(models["model"]) == ["drift", "no drift"]  # one scale: nothing to hold still by itself
    assert (models["exact_efficiency"] > 0.9).all()
    assert all(finished.summary["sound"].values())
    assert len(finished.results.table("parameters")) == 3 * 6
    page = (finished.results.folder / "report.html").read_text()
    assert "Expansion" in page
    assert "Motion of the legs" in page


def edit(old: str, new: str) -> Callable[[Path], None]:
    return lambda path: studies.edit(path, old, new)


def leave_out_a_column(path: Path) -> None:
    (path.parent / "warm.csv").write_text("pose,kelvin\nC01,3.0\n")
    studies.edit(path, "temperature_celsius = 20.0", 'temperatures = "warm.csv"')


def leave_out_a_pose(path: Path) -> None:
    (path.parent / "warm.csv").write_text("pose,temperature_celsius\nC01,3.0\n")
    studies.edit(path, "temperature_celsius = 20.0", 'temperatures = "warm.csv"')


def repeat(path: Path) -> None:
    path.write_text(path.read_text().replace("data/2/", "data/1/"))


FAULTS = {
    "missing": (edit("data/2/targets.csv", "data/7/targets.csv"), r"data/7/targets\.csv: no such file"),
    "no temperature": (edit("temperature_celsius = 20.0", ""), "session 'S2': found no temperature"),
    "no column": (leave_out_a_column, "found column 'kelvin'.* expected pose, temperature_celsius"),
    "no pose": (leave_out_a_pose, "found no row of pose 'C02'"),
    "other machine": (
        lambda path: session_studies.write_other_machine(path.parent),
        "session 'S2': found leg . off by",
    ),
    "copied": (repeat, "session 'S2': found the readings of session 'S1' to the last digit"),
    "order": (edit("day = 60.0", "day = 20.0"), "session 'S2': found day 20 after day 30"),
    "no day": (edit("day = 60.0", ""), "session 'S2': found no day"),
    "twice": (edit('label = "S2"', 'label = "S1"'), "found 'S1' twice"),
    "variant": (edit("six_pus/none", "six_pus/linear"), "variant 'six_pus/linear': unknown here"),
    "symbol": (edit('symbols = ["l"]', 'symbols = ["a_x"]'), "found 'a_x', expected one of l"),
    "instrument": (edit('targets = "data/2', 'poses = "data/2'), "session 'S2': found no targets"),
    "uniform": (
        lambda path: studies.edit(
            path.parent / "study.toml", '{ prior = "normal", sd = 2.0 }', '{ prior = "uniform", half_width = 2.0 }'
        ),
        "found a uniform prior of l",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_at_fault_is_one_line(fault, written, call, tmp_path):
    path = session_studies.copy_sessions(written, tmp_path / "here")
    change, expected = FAULTS[fault]
    change(path)
    before = studies.snapshot(path.parent)
    code, said, complaint = call("run", path, "--out", tmp_path / "new", "--workers", "1")
    assert (code, said, complaint.count("\n")) == (2, "", 1), complaint
    assert re.search(expected, complaint), complaint
    assert studies.snapshot(path.parent) == before
    assert not (tmp_path / "new").exists()


def test_several_machines_take_no_days(written, tmp_path):
    """Another machine is welcome where several are stated; a pose's own temperature counts as the session's does."""
    path = session_studies.copy_sessions(written, tmp_path)
    session_studies.write_other_machine(tmp_path)
    text = (
        path.read_text()
        .replace("[drift]", '[drift]\nhierarchy = "machines"')
        .replace("scale_um = 20", "scale_um = 999")
    )
    rows = "".join(f"C{k:02d},20.0\n" for k in range(1, 14))
    (tmp_path / "warm.csv").write_text(f"pose,temperature_celsius\n{rows}")
    text = text.replace("temperature_celsius = 20.0", 'temperatures = "warm.csv"')
    path.write_text(re.sub(r"(?m)^day = .*$", "", text))
    kind, config = load(path)
    model = kind.read(config, tmp_path).model
    np.testing.assert_array_equal(model.drift.loadings, np.eye(3))
    assert [part.warmth for part in model.parts] == [-5.0, 0.0, 5.0]


def test_temperatures_that_nothing_is_made_of_are_doubted(written, call, tmp_path):
    path = session_studies.copy_sessions(written, tmp_path)
    text = path.read_text()
    path.write_text(text.replace(session_studies.THERMAL, ""))
    code, said, _ = call("validate", path)
    assert code == 0
    assert "there is no [thermal]" in said
