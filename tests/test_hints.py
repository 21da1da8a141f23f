"""Slips that everybody makes are said with what to do about them; `bayescal validate` says all faults at once."""

from __future__ import annotations

import re

import pytest

from bayescal.config.load import find_line
from bayescal.projects.start import start_project

TEXT = """kind = "study"
[[variants]]
model = "six_ups"
free = [
    "l",
]
[[variants]]
model = "six_uxs"
[parameters]
l = { prior = "normal", sd = -1.0 }
[sensors.tracker]
noise_um = 1.0
[[legs]]
[legs.joint]
x = 1.0
[[legs]]
[legs.joint]
x = 2.0
"""


@pytest.mark.parametrize(
    ("location", "line"),
    [
        (("kind",), 1),
        (("variants",), 2),
        (("variants", 0, "free", 0), 4),
        (("variants", 1, "model"), 8),
        (("variants", 2, "model"), 2),
        (("parameters", "l", "sd"), 10),
        (("sensors", "tracker", "noise_um"), 12),
        (("legs", 1, "joint", "x"), 18),
        (("unknown",), None),
    ],
)
def test_lines_of_keys(location, line):
    assert find_line(TEXT, location) == line


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hints") / "mine"
    start_project(folder, "hexapod", "poses")
    return folder


@pytest.fixture
def edit(project):
    """Return a function that edits a file of the project until the test is over."""
    kept = {}

    def replace(name, old, new):
        path = project / name
        kept.setdefault(path, path.read_text())
        text = re.sub(old, new, path.read_text(), count=1, flags=re.MULTILINE)
        assert text != path.read_text()
        path.write_text(text)

    yield replace
    for path, text in kept.items():
        path.write_text(text)


def test_a_file_that_is_no_experiment_is_told_what_it_is(call, project):
    assert "a mechanism's file" in call("run", project / "machine.toml")[2]
    assert "poses.csv: found a CSV" in call("run", project / "data" / "poses.csv")[2]
    assert "study.toml: found" in call("report", project / "study.toml")[2]


def test_a_machine_in_metres(call, project, edit):
    edit("machine.toml", "radius_mm = 300.0", "radius_mm = 0.3")
    edit("machine.toml", "radius_mm = 180.0", "radius_mm = 0.18")
    edit("machine.toml", r"0\.0, 380\.0", "0.0, 0.38")
    _, _, complaint = call("validate", project / "study.toml")
    assert re.search(r"strut 1, 0\.429 mm.*\bmetres", complaint)


def test_a_pose_that_is_not_found_is_told_with_its_row_and_name(call, project, edit, tmp_path):
    edit("calibration_configurations.csv", r"\A((?:.*\n){4})[^,]*,", r"\g<1>390.0,")
    code, said, complaint = call("simulate", project / "simulate.toml", "--out", tmp_path / "data")
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert re.search(r"calibration_configurations\.csv: row 3, pose 'C03': .*\b390", complaint)
    assert not (tmp_path / "data").exists()


# --- all at once ------------------------------------------------------------------------------------------------------


def test_faults_of_config_machine_and_tables_come_in_one_go(call, project, edit):
    edit("study.toml", "^seed = 1", "sed = 1")
    edit("study.toml", "^walkers = 96", 'walkers = "ten"')
    edit("machine.toml", "actuator_range_mm", "range_mm")
    edit("data/actuators.csv", "C02,calibration,", "C02,calibrated,")
    edit("data/poses.csv", r"(?s)\A.*?^pose,.*?$", "pose;x;y_mm;z;rx_deg;ry_deg;rz_deg")
    code, said, complaint = call("validate", project / "study.toml")
    assert (code, said) == (2, "")
    told = complaint.splitlines()
    expected = (
        "study.toml, line 5: sed: unknown key, did you mean 'seed'?",
        "study.toml: seed: missing",
        "walkers: found 'ten'",
        "range_mm: unknown key, did you mean 'actuator_range_mm'?",
        "legs.actuator_range_mm: missing",
        "found 'calibrated', expected one of calibration, verification",
        "found cells separated by semicolons",
        "found column 'x', did you mean 'x_mm'?",
        "found column 'z', did you mean 'z_mm'?",
        "found no noise, expected columns",
    )
    for part in expected:
        assert sum(part in line for line in told) == 1, (part, complaint)
    assert len(told) == len(expected), complaint
    assert all(line.startswith("bayescal: ") for line in told)


def test_actuators_out_of_range_are_told_beside_a_fault_of_the_config(call, project, edit):
    edit("study.toml", "walkers = 96", "walkers = 0")
    edit("machine.toml", "initial_actuator_position_mm = 450.0", "initial_actuator_position_mm = 700.0")
    code, _, complaint = call("validate", project / "study.toml")
    assert code == 2
    assert "sampler.walkers" in complaint.splitlines()[0]
    assert "40 mm" in complaint.splitlines()[1]


def test_one_fault_is_told_once_and_other_commands_stay_with_one_line(call, project, edit):
    edit("data/actuators.csv", "C02,calibration,", "C02,calibrated,")
    assert len(call("validate", project / "study.toml")[2].splitlines()) == 1
    edit("study.toml", "^seed = 1", "sed = 1")
    assert len(call("run", project / "study.toml")[2].splitlines()) == 1


def test_the_machine_of_an_audit_is_looked_at_beside_its_config(call, project, edit):
    edit("audit.toml", "^seed = 1", "sed = 1")
    edit("machine.toml", "actuator_range_mm", "range_mm")
    told = call("validate", project / "audit.toml")[2].splitlines()
    assert "audit.toml" in told[0]
    assert any("legs.range_mm: unknown key" in line for line in told)
