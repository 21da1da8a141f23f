"""From a study's results to the machine and its use, as a user does it: bayescal export, command and predict."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import studies

from bayescal.calibrated.predict import predict_poses
from bayescal.data.actuators import name_actuators
from bayescal.data.instruments.read_poses import PoseNoise, read_poses
from bayescal.errors import InputError
from bayescal.experiments.runner import run as frame
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.shared.calibrating import load_calibrated
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.machines.read import load_mechanism
from bayescal.numerics.geometry import rotation_vector_from_matrix

pytestmark = pytest.mark.runs

COMMITTED = Path(__file__).parents[3] / "results"
VARIANT = "six_pus/matrix"


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """Return a tiny study with its results, which are too few draws to converge."""
    folder = tmp_path_factory.mktemp("finished")
    path = studies.write_tiny_study(folder)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(frame, "write_page", lambda page, folder, *more: folder)
        for name, value in {"MAX_PILOTS": 0, "MAX_ROUNDS": 0, "TRIAL_DRAWS": 100}.items():
            patched.setattr(f"bayescal.inference.exploration.{name}", value)
        frame.run_experiment(load_experiment(path), folder, folder / "out")
    return folder


@pytest.fixture
def study(finished, tmp_path, monkeypatch) -> Path:
    """Return a copy of the study in the current directory, its results passed off as converged."""
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    change_summary(lambda fit: fit.update(problems=[], converged=True))
    return tmp_path


def change_summary(change) -> None:
    path = Path("out/summary.json")
    summary = json.loads(path.read_text())
    for fit in summary["variants"].values():
        change(fit)
    path.write_text(json.dumps(summary))


def write_actuators(path: Path, rows: np.ndarray) -> None:
    header = "pose," + ",".join(f"rho_{leg}_mm" for leg in range(1, 7))
    cells = [f"P{k}," + ",".join(repr(float(x)) for x in row) for k, row in enumerate(rows)]
    path.write_text("\n".join([header, *cells]) + "\n")


def draw_actuators(n: int) -> np.ndarray:
    return 10.0 + 1.3 * np.random.default_rng(4).uniform(-1, 1, (n, 6))


def test_exported_machine_predicts_as_the_posterior_mean_of_the_study(study, call):
    code, out, _ = call("export", "out")
    folder = Path("machines/tiny-six_pus-matrix")
    assert code == 0
    assert f"wrote {folder / 'mechanism.toml'}" in out
    machine = studies.load_study(study / "study.toml").variants[VARIANT].whole.machine
    theta = machine.layout.nominal.copy()
    parameters = studies.read_posterior(Path("out"), VARIANT)
    for k, name in enumerate(machine.layout.names):
        theta[k] = parameters.get(name, {"mean": theta[k]})["mean"]
    actuators = draw_actuators(50)
    expected = solve_forward_kinematics(machine, theta, actuators)
    for path in (folder, Path("out")):
        found = predict_poses(load_calibrated(path), actuators)
        np.testing.assert_allclose(found.position, expected.position, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.rotation, expected.rotation, rtol=0, atol=1e-12)
    assert load_mechanism(folder / "mechanism.toml").n_legs == 6


def test_every_command_takes_the_exported_mechanism(study, call):
    """The study again, about the machine as calibrated: its first guess is now what it found."""
    call("export", "out", "--out", "machine")
    text = Path("study.toml").read_text().replace('"mechanism.toml"', '"machine/mechanism.toml"')
    Path("again.toml").write_text(text.replace('matrix = "targets"', 'matrix = "machine/deformation_matrix.csv"'))
    first, again = (studies.load_study(study / name) for name in ("study.toml", "again.toml"))
    errors = []
    for inputs in (first, again):
        machine, poses = inputs.variants[VARIANT].whole.machine, inputs.measured[0].poses.select(inputs.verification)
        there = solve_forward_kinematics(machine, machine.layout.nominal, poses.actuators)
        errors.append(np.abs(there.position - poses.position).max())
    assert errors[1] < 0.05 < errors[0]  # mm: nominal against calibrated


def test_command_and_predict_undo_each_other(study, call):
    actuators = draw_actuators(20)
    write_actuators(Path("actuators.csv"), actuators)
    assert (
        call("predict", "out", "actuators.csv", "--out", "poses.csv", "--draws-out", "draws.csv", "--n-draws", 5)[0]
        == 0
    )
    assert call("compensate", "out", "poses.csv", "--out", "commanded.csv")[0] == 0
    rows = [line.split(",") for line in Path("commanded.csv").read_text().splitlines() if not line.startswith("#")]
    assert rows[0][:3] == ["pose", "reached", "rho_1_mm"]
    assert {row[1] for row in rows[1:]} == {"yes"}
    np.testing.assert_allclose([[float(x) for x in row[2:8]] for row in rows[1:]], actuators, rtol=0, atol=1e-6)
    assert all(0.1 < float(x) < 50.0 for row in rows[1:] for x in row[8:])  # µm
    code, again, _ = call("predict", "out", "commanded.csv")
    assert code == 0
    assert again.count("\n") == Path("poses.csv").read_text().count("\n")
    assert sum(not line.startswith("#") for line in Path("draws.csv").read_text().splitlines()) == 1 + 5 * 20


def test_predicted_table_is_one_of_measured_poses(study, call):
    """Covariances are in the units of `poses-from-targets`, and come back."""
    write_actuators(Path("actuators.csv"), draw_actuators(4))
    call("predict", "out", "actuators.csv", "--out", "poses.csv")
    lines = Path("actuators.csv").read_text().splitlines()
    Path("taken.csv").write_text("\n".join([f"use,{lines[0]}", *(f"calibration,{line}" for line in lines[1:])]) + "\n")
    readings, _ = read_poses(Path("poses.csv"), Path("taken.csv"), PoseNoise(), name_actuators(6))
    expected = predict_poses(load_calibrated(Path("out")), draw_actuators(4))
    np.testing.assert_allclose(readings.covariance, expected.covariance, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(readings.values[:, :3], expected.position, rtol=0, atol=1e-8)


def test_poses_out_of_reach_are_named_row_by_row(study, refuse_here, call):
    home = predict_poses(load_calibrated(Path("out")), np.full((1, 6), 10.0))
    z, turn = home.position[0, 2], ",".join(map(str, np.degrees(rotation_vector_from_matrix(home.rotation[0]))))
    x, y = home.position[0, :2]
    rows = [f"home,{x},{y},{z},{turn}", f"high,{x},{y},{z + 9},{turn}", f"far,{x},{y + 800},{z},{turn}"]
    Path("poses.csv").write_text("\n".join(["pose,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg", *rows]) + "\n")
    message = refuse_here("compensate", "out", "poses.csv", "--out", "commanded.csv")
    assert "poses.csv: found 2 of 3" in message
    assert "line 3, pose 'high': rho[1]" in message
    assert "line 4, pose 'far': rho[1]" in message
    code, out, _ = call("compensate", "out", "poses.csv", "--allow-unreachable")
    rows = [line for line in out.splitlines() if not line.startswith("#")]
    assert code == 0
    assert rows[1].startswith("home,yes,")
    assert rows[2].startswith('high,"rho[1] would be ')
    assert rows[2].endswith("," * 12)
    assert rows[3] == "far,rho[1] is unreachable there" + "," * 12


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("export", "out", "--variant", "six_pus"), "--variant: found 'six_pus', expected one of six_pus/"),
        (("export", "out", "--format", "urdf"), "format urdf: found a flexible platform in variant 'six_pus/matrix'"),
        (("export", "out", "--format", "step"), "--format: found 'step', expected one of"),
        (("export", "out", "--experiment", "other.toml"), "other.toml: found another study"),
        (("export", "nowhere"), "nowhere/provenance.json: no such file"),
        (("export", "out", "--out", "study.toml"), "study.toml:"),
        (("predict", "out", "far.csv"), "far.csv, line 2: pose 'P0', rho_1_mm: found 20 mm"),
        (("compensate", "out", "far.csv"), "far.csv: found no column 'x_mm'"),
    ],
)
def test_refusals(study, refuse_here, arguments, expected):
    Path("other.toml").write_text(Path("study.toml").read_text().replace("seed = 11", "seed = 12"))
    write_actuators(Path("far.csv"), np.full((1, 6), 20.0))
    assert expected in refuse_here(*arguments)


def test_without_convergence_only_by_force_and_the_file_says_so(study, refuse_here, call):
    change_summary(lambda fit: fit.update(problems="R-hat 1.2, limit 1.01", converged=False))
    write_actuators(Path("actuators.csv"), draw_actuators(2))
    for arguments in (("export", "out"), ("predict", "out", "actuators.csv")):
        assert "(R-hat 1.2, limit 1.01)" in refuse_here(*arguments)
    assert call("export", "out", "--allow-unconverged", "--out", "machine")[0] == 0
    assert "with --allow-unconverged: R-hat 1.2" in Path("machine/mechanism.toml").read_text()
    assert "R-hat 1.2" in refuse_here("predict", "machine", "actuators.csv")
    code, out, _ = call("predict", "machine", "actuators.csv", "--allow-unconverged")
    assert code == 0
    assert "# NOT CONVERGED" in out


def test_results_of_earlier_versions_take_the_studys_config(study, refuse_here, call):
    shutil.rmtree("out/machine")
    assert "no machine" in refuse_here("export", "out")
    call("export", "out", "--experiment", "study.toml", "--out", "machine")
    assert load_calibrated(Path("machine")).covariance is not None


def test_results_without_draws_say_what_is_missing(study, call):
    shutil.rmtree("out/posterior")
    write_actuators(Path("actuators.csv"), draw_actuators(2))
    code, out, err = call("predict", "out", "actuators.csv")
    assert (code, err.count("\n")) == (0, 1)
    assert "posterior draws" in err
    assert "cov_x_x" not in out


def test_results_without_a_machine_are_refused():
    with pytest.raises(InputError, match="expected a study"):
        load_calibrated(COMMITTED / "hexapod_table8")


def test_committed_hexapod_with_its_config():
    """The shipped results have no draws; the machine is as far from nominal as the table of parameters says."""
    config = studies.EXPERIMENTS / "m2_hexapod" / "study.toml"
    found = load_calibrated(COMMITTED / "m2_hexapod", None, config)
    assert found.source.variant == "six_ups/none"
    expected = studies.read_posterior(COMMITTED / "m2_hexapod", "six_ups/none")
    for name, value in zip(found.legs.layout.names, found.theta, strict=True):
        assert value == expected[name]["mean"]


# --- a certificate -----------------------------------------------------------------------------------------------


def test_a_certificate_states_a_budget_and_how_it_was_checked(study, call):
    code, out, _ = call("certificate", "out", "--out", "machine.html", "--poses", 32, "--cube", 0.2)
    assert code == 0
    assert out.splitlines()[0].startswith("Position: x ±")
    page, figures = Path("machine.html").read_text(), json.loads(Path("machine.json").read_text())
    for said in ("actuator noise", "ISO 9283 pose accuracy AP", "ISO 230-2 accuracy A of z", "predicted"):
        assert said in page
    assert "targets.csv" in page  # the files that it goes back to
    n_measured = len(Path("out/machine/commands_six_pus-matrix.csv").read_text().splitlines()) - 2
    assert str(n_measured) in figures["workspace"].split()
    assert figures["share_extrapolated"] == 0.0
    parts = figures["standard_uncertainty"]
    combined = sum(parts[source]["x"] ** 2 for source in ("geometry", "actuator noise", "model error"))
    assert parts["combined"]["x"] ** 2 == pytest.approx(
        combined + parts.get("deformation matrix", {"x": 0.0})["x"] ** 2, rel=1e-4
    )
    expanded = figures["expanded_uncertainty"]
    method = (
        "k u"
        if all(abs(one - 1) <= 0.02 for one in expanded["propagated_over_monte_carlo"].values())
        else "Monte Carlo"
    )
    assert expanded["method"] == method
    chosen = {axis: figures["coverage_factor"] * one for axis, one in parts["combined"].items()}
    assert expanded["stated"] == pytest.approx(chosen if method == "k u" else expanded["monte_carlo"], rel=0.2)


def test_a_certificate_is_refused_in_a_line(study, refuse_here):
    assert "expected NAME.html" in refuse_here("certificate", "out", "--out", "machine.pdf")
    assert "cube: " in refuse_here("certificate", "out", "--cube", 500, "--poses", 16)
    found = refuse_here("certificate", "out", "--full-range", "--position-mm", 1, 1, 1)
    assert "--full-range: found with --position-mm" in found
    assert "--rotation-deg: expected --position-mm" in refuse_here("certificate", "out", "--rotation-deg", 1, 1, 1)
    assert "--position-mm: found -1" in refuse_here("certificate", "out", "--position-mm", -1, 1, 1)
    shutil.rmtree("out/posterior")
    assert "posterior draws" in refuse_here("certificate", "out")


def test_a_certificate_by_force_says_first_what_is_wrong(study, refuse_here, call):
    change_summary(lambda fit: fit.update(problems="R-hat 1.2, limit 1.01", converged=False))
    assert "R-hat 1.2" in refuse_here("certificate", "out")
    arguments = ("certificate", "out", "--allow-unconverged", "--out", "machine.html", "--poses", 16, "--cube", 0.2)
    assert call(*arguments)[0] == 0
    assert "R-hat 1.2, limit 1.01." in Path("machine.html").read_text()
    assert json.loads(Path("machine.json").read_text())["problems"] == ["R-hat 1.2, limit 1.01"]
