"""`bayescal validate` tells all faults at once that do not depend on one another."""

from __future__ import annotations

import shutil

import pytest

from bayescal.projects.start import start_project


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("faults") / "mine"
    start_project(folder, "hexapod", "poses")
    return folder


def edit(folder, name, *changes):
    text = (folder / name).read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / name).write_text(text)


def test_faults_of_config_machine_and_tables_come_in_one_go(call, project, tmp_path):
    folder = tmp_path / "mine"
    shutil.copytree(project, folder)
    edit(folder, "study.toml", ("seed = 1", "sed = 1"), ("scale_um = 10.0", 'scale_um = "ten"'))
    edit(folder, "machine.toml", ("actuator_range_mm", "range_mm"))
    edit(folder, "data/actuators.csv", ("C02,calibration,", "C02,calibrated,"))
    poses = folder / "data" / "poses.csv"
    lines = [line for line in poses.read_text().splitlines() if not line.startswith("#")]
    poses.write_text("pose;x;y_mm;z;rx_deg;ry_deg;rz_deg\n" + "\n".join(lines[1:]) + "\n")
    code, said, complaint = call("validate", folder / "study.toml")
    assert (code, said) == (2, "")
    told = complaint.splitlines()
    expected = (
        "study.toml, line 5: sed: unknown key, did you mean 'seed'?",
        "study.toml: seed: missing",
        "scale_um: found 'ten'",
        "range_mm: unknown key, did you mean 'actuator_range_mm'?",
        "legs.actuator_range_mm: missing",
        "found 'calibrated', expected one of calibration, verification",
        "found cells separated by semicolons",
        "found column 'x', did you mean 'x_mm'?",
        "found column 'z', did you mean 'z_mm'?",
        "found no noise, expected the columns",
    )
    for part in expected:
        assert sum(part in line for line in told) == 1, (part, complaint)
    assert len(told) == len(expected), complaint
    assert all(line.startswith("bayescal: ") for line in told)


def test_actuators_out_of_range_are_told_beside_a_fault_of_the_config(call, project, tmp_path):
    folder = tmp_path / "mine"
    shutil.copytree(project, folder)
    edit(folder, "study.toml", ("walkers = 96", "walkers = 0"))
    edit(folder, "machine.toml", ("initial_actuator_position_mm = 450.0", "initial_actuator_position_mm = 700.0"))
    code, _, complaint = call("validate", folder / "study.toml")
    assert code == 2
    assert "sampler.walkers" in complaint.splitlines()[0]
    assert "expected at most the actuator range of 40 mm" in complaint.splitlines()[1]


def test_one_fault_is_told_once_and_other_commands_stay_with_one_line(call, project, tmp_path):
    folder = tmp_path / "mine"
    shutil.copytree(project, folder)
    edit(folder, "data/actuators.csv", ("C02,calibration,", "C02,calibrated,"))
    assert len(call("validate", folder / "study.toml")[2].splitlines()) == 1
    edit(folder, "study.toml", ("seed = 1", "sed = 1"))
    assert len(call("run", folder / "study.toml")[2].splitlines()) == 1


def test_the_machine_of_an_audit_is_looked_at_beside_its_config(call, project, tmp_path):
    folder = tmp_path / "mine"
    shutil.copytree(project, folder)
    edit(folder, "audit.toml", ("seed = 1", "sed = 1"))
    edit(folder, "machine.toml", ("actuator_range_mm", "range_mm"))
    told = call("validate", folder / "audit.toml")[2].splitlines()
    assert "audit.toml" in told[0]
    assert any("legs.range_mm: unknown key" in line for line in told)
