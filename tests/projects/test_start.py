"""`bayescal init`: projects that are whole, honest about their data, and fit to run as they are."""

from __future__ import annotations

import numpy as np
import pytest
from shares import run_rest

from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import check_experiment
from bayescal.machines.models import MODELS
from bayescal.machines.read import load_mechanism
from bayescal.projects.start import INSTRUMENTS, MACHINES, OWN, TEMPLATES, start_project

SHIPPED = "examples/own_machine"
LEGS = [machine for machine in MACHINES if machine != OWN]
PROJECTS = [(machine, instrument) for instrument in INSTRUMENTS for machine in LEGS]


@pytest.mark.parametrize("project", run_rest(PROJECTS, 2), ids="-".join)
def test_a_project_is_fit_to_run_and_says_that_it_is_simulated(tmp_path, project):
    machine, instrument = project
    folder = tmp_path / "mine"
    files = start_project(folder, machine, instrument)
    for name in ("study.toml", "audit.toml", "simulate.toml"):
        _, config = load(folder / name)
        check_experiment(config, folder)
        if name != "simulate.toml":
            assert set(config.parameters) == list_free(folder, machine)
    later = folder / "audit_measured.toml"
    assert later.exists() == (instrument != "points")  # audits take whole poses
    if later.exists():
        check_experiment(load(later)[1], folder)
    measured = [path for path in files if path.parent.name == "data"]
    assert measured
    for path in (*measured, folder / "README.md"):
        assert "never measured" in path.read_text()
    assert load(folder / "study.toml")[1].provenance.status == "simulated"


def list_free(folder, machine):
    """All symbols of a machine's model but for the one that moves what others move."""
    blocks = MODELS[MACHINES[machine].model]().blocks(load_mechanism(folder / "machine.toml"))
    return {block.symbol for block in blocks} - {"rho0"}


@pytest.mark.parametrize("machine", LEGS)
def test_simulated_poses_fill_six_tenths_of_every_actuators_range(machine):
    tables = [
        np.loadtxt(TEMPLATES / "legs" / f"{use}_configurations.csv", delimiter=",", skiprows=2)
        for use in ("calibration", "verification")
    ]
    assert [len(one) for one in tables] == [30, 10]
    moves = np.concatenate(tables) / MACHINES[machine].range
    assert moves.shape[1] == len(MACHINES[machine].base_azimuth)
    assert np.abs(moves).max() <= 0.6
    assert np.ptp(moves, axis=0).min() > 0.95 * 1.2
    assert np.histogram(moves, 6, (-0.6, 0.6))[0].tolist() == pytest.approx([40] * 6, abs=4)


def test_the_own_machine_is_the_shipped_example(tmp_path, pytestconfig):
    start_project(tmp_path / "mine", OWN, None)
    shipped = pytestconfig.rootpath / SHIPPED
    for name in ("linear_delta.py", "machine.toml", "study.toml", "audit.toml", "simulate.toml", "data/readings.csv"):
        assert (tmp_path / "mine" / name).read_bytes() == (shipped / name).read_bytes()


def test_from_the_command_line(call, tmp_path):
    code, said, complaint = call("init", tmp_path / "mine", "--machine", "hexapod", "--instrument", "poses")
    assert (code, complaint) == (0, "")
    assert "next: cd" in said
    code, _, complaint = call("init", tmp_path / "mine", "--machine", "hexapod", "--instrument", "poses")
    assert code == 2
    assert "mine: expected" in complaint


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        (("--machine", "hexapd"), "--machine: found 'hexapd', did you mean 'hexapod'?"),
        (("--machine", "hexapod", "--instrument", "eyes"), "--instrument: found 'eyes', expected one of"),
        (("--machine", "own", "--instrument", "poses"), "found 'poses', expected none with machine 'own'"),
        ((), "--machine: missing, expected one of hexapod, carriages, own"),
    ],
)
def test_what_is_wrong_is_told_and_nothing_written(call, tmp_path, monkeypatch, options, fault):
    monkeypatch.setattr("sys.stdin.isatty", lambda: False)
    if options[:2] == ("--machine", "hexapd"):
        options = (*options, "--instrument", "poses")
    code, _, complaint = call("init", tmp_path / "mine", *options)
    assert code == 2
    assert fault in complaint
    assert not list(tmp_path.iterdir())


def test_what_is_not_said_is_asked(call, tmp_path, monkeypatch):
    answers = iter(["carriages", "points"])
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("bayescal.cli.project.typer.prompt", lambda *_, **__: next(answers))
    assert call("init", tmp_path / "mine")[0] == 0
    assert (tmp_path / "mine" / "probe.csv").exists()
