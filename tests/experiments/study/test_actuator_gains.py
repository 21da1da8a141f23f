"""Gains of actuators among the parameters of machines on legs: from simulated data to a machine in use."""

from __future__ import annotations

import re

import numpy as np
import pytest

import bayescal as bc
from bayescal.calibrated.predict import compensate_poses, predict_poses
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.calibrating import load_calibrated
from bayescal.files.csv_tables import read_table
from bayescal.projects.start import start_project

GAINS = [1.01, 0.99, 1.005, 0.992, 1.009, 0.997]
FREE = 'gain = { prior = "normal", sd = 0.01 }\n'
EFFORT = "walkers = 24\nburn_in = 10\nsteps = 20\n\n[evidence]\ndraws = 1000\nmax_draws = 1000\n"


def offer_gains(text: str) -> str:
    """Return a study's or audit's text with gains free."""
    text = text.replace("[parameters]\n", f"[parameters]\n{FREE}").replace("free = [", 'free = ["gain", ')
    return f"{text.partition('walkers')[0]}{EFFORT}" if "walkers" in text else text


def simulate(folder, left_out="none"):
    """Write the data of a machine with gains, the other offsets as they are but for those that are left out."""
    config = folder / "simulate.toml"
    gains = f"[truth.offsets]\ngain = {[round(gain - 1.0, 6) for gain in GAINS]}\n"
    text = re.sub(rf"(?m)^({left_out}) = \[.*\n", "", config.read_text())
    config.write_text(text.replace("[truth.offsets]\n", gains))
    experiment, known = load(config)
    files, _ = experiment.read(known, folder).simulate(np.random.default_rng(4))
    for name, text in files.items():
        (folder / "data" / name).write_text(text)


@pytest.fixture(scope="module", params=["hexapod", "carriages"])
def folder(request, tmp_path_factory):
    """Return a project whose actuators travel by a hundredth more or less than they read, simulated with 2 µm."""
    folder = tmp_path_factory.mktemp(request.param) / "mine"
    start_project(folder, request.param, "poses")
    simulate(folder)
    for name in ("study.toml", "audit.toml"):
        (folder / name).write_text(offer_gains((folder / name).read_text()))
    return folder


def read(path):
    experiment, config = load(path)
    return experiment.read(config, path.parent)


def test_the_truth_is_written_and_taken_again(folder):
    table = read_table(folder / "data" / "true_parameters.csv", ("parameter", "unit", "value"))
    written = dict(zip(table.text("parameter"), table.numbers(("value",))[:, 0], strict=True))
    assert [written[f"gain[{leg}]"] for leg in range(1, 7)] == pytest.approx(GAINS)
    text = (folder / "simulate.toml").read_text()
    before, _, after = text.partition("[truth.offsets]")
    again = folder / "again.toml"
    again.write_text(
        f'{before}[truth]\nparameters = "data/true_parameters.csv"\n\n[poses]{after.partition("[poses]")[2]}'
    )
    files, _ = read(again).simulate(np.random.default_rng(4))
    assert files["poses.csv"] == (folder / "data" / "poses.csv").read_text()


def test_the_machine_that_explains_the_data_best_has_them(folder):
    variant = next(iter(read(folder / "study.toml").variants.values()))
    posterior = variant.posterior()
    theta = posterior.theta(posterior.least_squares_start())
    places = [posterior.sampling.names.index(f"gain[{leg}]") for leg in range(1, 7)]
    index = variant.model.layout.index["gain"]
    assert len(places) == 6
    np.testing.assert_allclose(theta[index], GAINS, rtol=0, atol=1.5e-3)
    assert "position of rho[1], rho[2]" in variant.missing  # they are these gains


def test_a_study_that_does_not_name_them_has_none(folder):
    plain = folder / "plain.toml"
    plain.write_text((folder / "study.toml").read_text().replace(FREE, "").replace('"gain", ', ""))
    variant = next(iter(read(plain).variants.values()))
    assert "gain" not in variant.whole.layout.symbols
    assert not variant.whole.has_gains


@pytest.mark.runs
def test_an_audit_plans_with_them(folder):
    plans = read(folder / "audit.toml").plans
    assert {f"gain[{leg}]" for leg in range(1, 7)} <= set(next(iter(plans.values())).names)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('free = ["gain"', 'free = ["gain[7]"', r"free: found 'gain\[7\]'"),
        ("sd = 0.01 }\n", "sd = [0.01, 0.01] }\n", "parameters.gain: found 2 values, expected 1 or 6, one per leg"),
        (FREE, "", "frees 'gain', which has no prior"),
    ],
)
def test_gains_where_no_actuator_is_are_refused(folder, refuse, old, new, message):
    path = folder / "bad.toml"
    path.write_text((folder / "study.toml").read_text().replace(old, new, 1))
    refuse(message, folder / "out", "run", path, "--quiet")


def test_a_machine_without_actuators_by_legs_has_none(tmp_path, refuse):
    start_project(tmp_path / "mine", "own", None)
    path = tmp_path / "mine" / "study.toml"
    path.write_text(path.read_text().replace("[parameters]\n", f"[parameters]\n{FREE}"))
    refuse("parameters: found 'gain', expected one of", tmp_path / "mine" / "out", "run", path, "--quiet")


@pytest.mark.runs
def test_gains_of_actuators_that_are_not_read_are_refused(folder, refuse):
    path = folder / "bad.toml"
    text = (folder / "audit.toml").read_text()
    path.write_text(text.replace('deformation = "none"\n', 'deformation = "none"\nsensors = ["instrument"]\n', 1))
    refuse("found gain.1. free, expected rho", folder / "out", "audit", path, "--quiet")


@pytest.mark.slow
@pytest.mark.parametrize("machine_kind", ["hexapod", "carriages"])
def test_they_come_back_and_stay_with_the_machine(machine_kind, tmp_path, call):
    """Within their intervals; results, export and what is read of it agree, and reverifications plan with them."""
    folder = tmp_path / "mine"
    start_project(folder, machine_kind, "poses")
    simulate(folder, "[abu]_.|rho0")  # what is not free in the study is as drawn
    text = offer_gains((folder / "study.toml").read_text())
    (folder / "study.toml").write_text(re.sub(r"(?m)^free = .*$", 'free = ["gain", "l"]', text))
    assert call("run", folder / "study.toml", "--out", tmp_path / "out", "--quiet")[0] in (0, 3)
    results = bc.load_results(tmp_path / "out")
    rows = results.tables["parameters"].set_index("parameter")
    found = rows.loc[[f"gain[{leg}]" for leg in range(1, 7)]]
    assert (np.abs(found["mean"] - GAINS) < 4.0 * found["sd"]).all()
    assert (found["sd"] < 1e-3).all()
    error = results.tables["model_error"].set_index("term")["median"]
    assert error.max() < 10.0
    assert results.summary["gains"]["rho[3]"] == "gain[3]"
    machine = load_calibrated(tmp_path / "out", allow_unconverged=True)
    assert call("export", tmp_path / "out", "--out", tmp_path / "exported", "--allow-unconverged")[0] == 0
    exported = load_calibrated(tmp_path / "exported", allow_unconverged=True)
    table = read_table(folder / "data" / "actuators.csv", None)
    actuators = table.numbers([f"rho_{leg}_mm" for leg in range(1, 7)])
    one, other = (predict_poses(some, actuators) for some in (machine, exported))
    np.testing.assert_allclose(other.tool, one.tool, rtol=0, atol=1e-9)
    truth = read_table(folder / "data" / "true_poses.csv", None).numbers(["x_mm", "y_mm", "z_mm"])
    assert np.abs(one.tool[:, :3] - truth).max() < 0.1
    np.testing.assert_allclose(compensate_poses(exported, one.tool).commands, actuators, rtol=0, atol=1e-6)
    plan = ("verify", tmp_path / "exported", "--allow-unconverged", "--position-um", "10", "--orientation-arcsec", "5")
    code, said, _ = call(*plan, "--parameters", "gain", "--shift-sd", "50", "--out", tmp_path / "plan.csv")
    assert code == 0, said
    nothing = call(*plan, "--measured", folder / "data" / "poses.csv", "--actuators", folder / "data" / "actuators.csv")
    assert nothing[0] == 0
