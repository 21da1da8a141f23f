"""Simulations: the twin's files and back recover poses and K; shipped data are what the shipped config gives."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import calibrations
import numpy as np
import pandas as pd
import pytest
import studies
from refusals import line_of
from scipy import stats

from bayescal.data.actuators import name_actuators
from bayescal.data.photogrammetry.poses import extract_poses
from bayescal.data.photogrammetry.survey import read_survey
from bayescal.errors import InputError
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.simulation.compute import Twin, build_twin, format_survey, read_model
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.files.csv_tables import read_matrix, read_table
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.machines.read import read_reading_model
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix

FILES = ("targets.csv", "actuators.csv", "target_reference.csv")
POSE_COLUMNS = ("x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad")
INSTRUMENT = '[instrument]\nkind = "poses"\nposition_um = 1.0\n'
TARGETS = (
    "[targets]\nbase = [{ count = 4, radius_mm = 90.0, height_mm = 0.0 }]\n"
    "platform = [{ count = 4, radius_mm = 30.0, height_mm = 5.0 }]\n"
)
SEEN_TARGETS = "[measurement_frame]\ndistance_mm = 1.0\nangle_deg = 1.0\n[noise]\ntarget_um = 1.0\n"
RARE = 1e-4
STAR = studies.EXPERIMENTS / "sliding_star"
FRAMES = ("x_P[1]", "y_P[1]", "beta[1]", "xi_B[1]", "eta_B[1]", "eta_B[2]")


def load_twin(path: Path) -> Twin:
    return build_twin(load_experiment(path), path.parent)


def survey_twin(twin: Twin, rng: np.random.Generator, theta=None):
    return twin.seen.survey(twin, rng, theta)


@pytest.fixture(scope="module")
def shipped():
    """Return what was seen of the shipped telescope."""
    config = load_experiment(studies.TELESCOPE / "study.toml")
    return StudyInputs.load(config, studies.TELESCOPE, ["six_pus/none"]).pads


@pytest.fixture
def config(tmp_path) -> Path:
    """Return the config of a tiny simulation."""
    studies.write_texts(tmp_path, studies.tiny_texts())
    return tmp_path / "simulate.toml"


def check_chi_square(value: float, dof: int) -> None:
    """Check that a sum of squares is neither too large nor too small for its degrees of freedom."""
    assert RARE < stats.chi2.sf(value, dof) < 1 - RARE


def test_files_and_back_recover_the_true_poses(config):
    studies.edit(config, "actuator_um = 1.0", "actuator_um = 0.0")
    studies.edit(config, "count = 5", "count = 12")
    twin = load_twin(config)
    survey = survey_twin(twin, np.random.default_rng(3))[0]
    for name, text in format_survey(survey, "test").items():
        (config.parent / name).write_text(text)
    read = read_survey(*(config.parent / name for name in FILES), name_actuators(6))
    found = extract_poses(read, 3e-3).poses
    truth = solve_forward_kinematics(twin.machine, twin.theta, read.actuators)
    turn = rotation_vector_from_matrix(found.rotation @ np.swapaxes(truth.rotation, -1, -2))
    error = np.concatenate([found.position - truth.position, turn], axis=1)
    chi2 = np.einsum("pi,pij,pj->", error, np.linalg.inv(found.covariance), error)
    check_chi_square(float(chi2), error.size)
    assert np.abs(error[:, :3]).max() < 0.05


def test_wrong_noise_fails_the_same_check(config):
    studies.edit(config, "target_um = 3.0", "target_um = 6.0")
    survey = survey_twin(load_twin(config), np.random.default_rng(3))[0]
    extraction = extract_poses(survey, 3e-3)
    dof = int(extraction.base.dof.sum() + extraction.platform.dof.sum())
    assert stats.chi2.sf(extraction.chi2_per_dof * dof, dof) < RARE


def test_round_trip_through_text_keeps_every_digit(config):
    twin = load_twin(config)
    survey = survey_twin(twin, np.random.default_rng(3))[0]
    texts = format_survey(survey, "test")
    for name, text in texts.items():
        (config.parent / name).write_text(text)
    read = read_survey(*(config.parent / name for name in FILES), name_actuators(6))
    assert read.poses == survey.poses
    np.testing.assert_array_equal(read.verification, survey.verification)
    np.testing.assert_allclose(read.platform.measured, survey.platform.measured, atol=5.1e-7, rtol=0)
    assert format_survey(read, "test") == texts


def test_same_seed_same_bytes_other_seed_others(config):
    twin = load_twin(config)
    one, same, other = (format_survey(survey_twin(twin, np.random.default_rng(seed))[0], "test") for seed in (1, 1, 2))
    assert one == same
    assert one["targets.csv"] != other["targets.csv"]
    assert one["actuators.csv"] == other["actuators.csv"]  # commanded, not noisy


def test_measurement_frame_differs_from_pose_to_pose(config):
    survey = survey_twin(load_twin(config), np.random.default_rng(3))[0]
    first = survey.base.measured[:, 0]
    assert np.ptp(first, axis=0).min() > 500


FOLDERS = ("telescope", "m2_hexapod", "m2_hexapod_table", "hexaglide", "camera_hexapod")
MONTHS = ("january", "february", "march", "april", "may", "june")
SIMULATED = {
    **{studies.EXPERIMENTS / name / "simulate.toml": "data" for name in FOLDERS},
    calibrations.OWN_MACHINE / "simulate.toml": "data",
    **{studies.EXPERIMENTS / "m2_hexapod_sessions" / f"{name}.toml": f"data/{name}" for name in MONTHS},
}
"""Shipped simulations, and where their data are beside them."""


@pytest.mark.parametrize("path", SIMULATED, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_shipped_data_are_those_of_the_shipped_config(path):
    texts, data = studies.simulate(path).files, path.parent / SIMULATED[path]
    assert set(texts) == {file.name for file in data.iterdir()}
    for name, text in texts.items():
        studies.assert_same_text(text, (data / name).read_text(), name)


def test_numbers_are_compared_as_numbers_and_all_else_as_text():
    shipped = "pose,x_mm\nC01,6.946746589799\n"
    studies.assert_same_text("pose,x_mm\nC01,6.946746589801\n", shipped)  # what another CPU's rounding makes of it
    for other in ("pose,x_mm\nC01,6.946746599799\n", "pose,x_m\nC01,6.946746589799\n", shipped + "C02,1.0\n"):
        with pytest.raises(AssertionError):
            studies.assert_same_text(other, shipped)


@pytest.mark.parametrize("name", FILES)
def test_shipped_headers_say_reconstructed_and_state_units(name):
    lines = (studies.TELESCOPE / "data" / name).read_text().splitlines()
    comments = [line for line in lines[:4] if line.startswith("#")]
    assert "Reconstructed" in comments[0]
    assert "never measured" in comments[0]
    assert " mm" in comments[1]
    assert "_mm" in lines[len(comments)]


def test_shipped_twin_is_the_one_described(shipped):
    targets = shipped.measured.targets
    assert targets.extraction.poses.n_poses == 46
    assert targets.survey.actuators.shape == (46, 6)
    np.testing.assert_allclose(np.unique(np.abs(shipped.displacement[:40])), [0, 1.3])
    dof = int(targets.extraction.base.dof.sum() + targets.extraction.platform.dof.sum())
    check_chi_square(targets.extraction.chi2_per_dof * dof, dof)


# --- the truth beside the data ---------------------------------------------------------------------------------------


def test_true_poses_are_those_that_the_targets_show(shipped):
    """Extracted poses lie about them as their covariance says; those of the commanded actuators are others."""
    table = read_table(studies.TELESCOPE / "data" / "true_poses.csv", ("pose", *POSE_COLUMNS))
    assert table.text("pose") == list(shipped.measured.targets.survey.poses)
    true, found = table.numbers(POSE_COLUMNS), shipped.measured.targets.extraction.poses
    turn = rotation_vector_from_matrix(found.rotation @ np.swapaxes(matrix_from_rotation_vector(true[:, 3:]), -1, -2))
    error = np.concatenate([found.position - true[:, :3], turn], axis=1)
    check_chi_square(float(np.einsum("pi,pij,pj->", error, np.linalg.inv(found.covariance), error)), error.size)
    twin = load_twin(studies.TELESCOPE / "simulate.toml")
    commanded = solve_forward_kinematics(twin.machine, twin.theta, shipped.measured.targets.survey.actuators)
    off = commanded.position - true[:, :3]
    assert 1e-4 < np.abs(off).max() < 0.05  # the actuators' 1 µm, some times over


def test_truth_fed_back_gives_the_same_bytes(config, tmp_path):
    def simulate(seed: int) -> dict[str, str]:
        return studies.simulate(config, seed=seed).files

    first = simulate(4)
    (tmp_path / "true_parameters.csv").write_text(first["true_parameters.csv"])
    text = config.read_text()
    start, end = text.index("[truth.offsets]"), text.index("[poses]")
    named = text[:start].rstrip() + '\nparameters = "true_parameters.csv"\n\n'
    config.write_text(named + text[end:])
    assert simulate(4) == first
    assert simulate(5)["targets.csv"] != first["targets.csv"]
    lines = first["true_parameters.csv"].splitlines()
    (tmp_path / "true_parameters.csv").write_text("\n".join([*lines[:3], *reversed(lines[3:])]))
    assert simulate(4) == first  # in any order
    line = next(line for line in lines if line.startswith("l[1],mm,"))
    studies.edit(tmp_path / "true_parameters.csv", line, f"l[1],mm,{float(line.split(',')[2]) + 0.01:.12f}")
    assert simulate(4)["targets.csv"] != first["targets.csv"]


# --- the ring follows eq. (4) ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def true_matrix() -> np.ndarray:
    return 1e-3 * read_matrix(studies.TELESCOPE / "deformation_matrix.csv", 6)


def test_ring_gives_back_the_matrix_of_eq_4(shipped, true_matrix):
    estimate = shipped.pads.matrix
    error = (estimate.matrix - true_matrix).ravel()
    check_chi_square(float(error @ np.linalg.solve(estimate.covariance, error)), 36)
    assert (np.abs(error) < 4 * estimate.sd.ravel()).all()
    assert estimate.sd.max() < 1e-3
    check_chi_square(estimate.chi2, estimate.dof)


def test_another_matrix_fails_the_same_check(shipped, true_matrix):
    error = (shipped.pads.matrix.matrix - true_matrix.T).ravel()
    assert stats.chi2.sf(float(error @ np.linalg.solve(shipped.pads.matrix.covariance, error)), 36) < RARE


def test_ring_gives_the_kappa_that_the_matrix_implies(shipped, true_matrix):
    travel = shipped.displacement[~shipped.measured.targets.survey.verification]
    implied = np.sum(travel * (travel @ true_matrix.T), axis=0) / np.sum(travel**2, axis=0)
    np.testing.assert_allclose(shipped.pads.kappa.kappa, implied, atol=1.5e-3)
    # the report's nominal value is 0.011; what K does beyond its diagonal is scatter to a linear ring
    assert ((shipped.pads.kappa.kappa > 0.005) & (shipped.pads.kappa.kappa < 0.025)).all()
    assert (shipped.pads.kappa.residual_sd > 5e-3).all()


def test_offset_of_kappa_leaves_the_ring_alone(config):
    twin = load_twin(config)
    without = twin.theta.copy()
    without[twin.machine.layout.index["kappa"]] = twin.machine.layout.nominal[twin.machine.layout.index["kappa"]]
    assert not np.array_equal(without, twin.theta)
    travel = np.concatenate([twin.calibration, twin.verification])
    expected = travel @ twin.machine.deformation.matrix.T
    studies.edit(config, "target_um = 3.0", "target_um = 1e-3")
    studies.edit(config, "actuator_um = 1.0", "actuator_um = 0.0")
    for theta in (twin.theta, without):
        survey = survey_twin(load_twin(config), np.random.default_rng(1), theta)[0]
        pads = survey.platform.leg > 0
        fit = extract_poses(survey, 1e-6).platform
        local = np.einsum("pmi,pi->pm", survey.platform.measured[:, pads] - fit.position[:, None], fit.rotation[..., 2])
        lift = local - survey.platform.reference[pads, 2]
        np.testing.assert_allclose(lift, np.repeat(expected, 2, axis=1), atol=2e-5)


# --- readings of any machine -----------------------------------------------------------------------------------------


def test_simulated_readings_are_of_the_machine_that_the_data_are_of():
    files, data = studies.simulate(STAR / "simulate.toml", seed=1).files, STAR / "data"
    written, given = (
        [line for line in text.splitlines() if line[:1] != "#"]
        for text in (files["true_parameters.csv"], (data / "true_parameters.csv").read_text())
    )
    assert written == given
    readings = (data / "readings.csv").read_text().splitlines()
    assert files["readings.csv"].splitlines()[2].split(",") == readings[2].split(",")


def test_simulated_frames_are_not_drawn():
    prior = load_experiment(STAR / "study.toml").parameters
    changed = {"truth": None, "parameters": prior, "fixed": [*FRAMES], "tied": ["l"]}
    truth = studies.simulate(STAR / "simulate.toml", seed=1, **changed).tables["truth"].set_index("parameter")
    names = read_reading_model(STAR / "machine.toml").layout.names
    assert set(names) - set(truth.index) == set(FRAMES)  # the table has what is off its nominal value
    assert truth["true"][["l[1]", "l[2]", "l[3]", "l[4]"]].nunique() == 1


def test_offsets_state_the_truth_of_any_machine_in_the_configs_units(tmp_path):
    path = calibrations.write_simulation(tmp_path)
    studies.edit(path, "[sensors]", "[truth.offsets]\nt_x = 0.5\nl = [1.0, 0.0, -2.0]\n\n[sensors]")
    truth = studies.simulate(path).tables["truth"].set_index("parameter")
    assert set(truth.index) == {"t_x", "l[1]", "l[3]"}
    off = truth["true"] - truth["nominal"]
    assert off[["l[1]", "l[3]", "t_x"]].to_list() == pytest.approx([1.0, -2.0, np.radians(0.5)], abs=1e-11)


def test_a_mechanism_has_readings_as_every_machine(config):
    """Its actuators' and its pose's, of the machine of the same truth as the survey is of."""
    text = config.read_text()
    truth = text[text.index("[truth]") : text.index("[poses]")]
    head = (
        text[: text.index("[provenance]")]
        + "n_poses = 4\n\n"
        + text[text.index("[provenance]") : text.index("[truth]")]
    )
    sensors = "[sensors]\nrho = { noise_um = 0.0 }\nx = { noise_um = 0.0 }\ntilt_a = { noise_deg = 0.1 }\n"
    config.write_text(head + truth + sensors)
    made = studies.simulate(config)
    assert made.tables["truth"].equals(studies.simulate(config, seed=9).tables["truth"])
    read = pd.read_csv(StringIO(made.files["readings.csv"]), comment="#")
    actuators = read[[f"rho_{leg}_mm" for leg in range(1, 7)]].to_numpy()
    assert [f"tilt_a_{leg}_rad" in read for leg in (1, 6)] == [True, True]
    machine = read_model(load_experiment(config), config.parent)
    theta = machine.layout.nominal.copy()
    for _, row in made.tables["truth"].iterrows():
        theta[machine.layout.names.index(row["parameter"])] = row["true"]
    found = solve_forward_kinematics(machine.machine, theta, actuators)
    np.testing.assert_allclose(found.position[:, 0], read["x_mm"], atol=2e-5)


def test_an_instrument_sees_the_tool_of_any_machine(tmp_path):
    """Its files are those of a study by poses: at the true machine they are explained to within their noise."""
    path = calibrations.write_simulation(tmp_path)
    frame = "[instrument.frames]\nbase = [{ position_mm = [100.0, -20.0, 3.0], rotation_deg = [0.0, 0.0, 90.0] }]\n"
    studies.edit(path, "[sensors]", f'[instrument]\nkind = "poses"\nposition_um = 5.0\n{frame}\n[sensors]')
    made = studies.simulate(path)
    table = {name: pd.read_csv(StringIO(text), comment="#") for name, text in made.files.items()}
    seen, true = table["poses.csv"], table["true_poses.csv"]
    assert list(table["actuators.csv"]) == ["pose", "use", "s_1_mm", "s_2_mm", "s_3_mm"]
    turned = np.column_stack([100.0 - true["y_mm"], -20.0 + true["x_mm"], 3.0 + true["z_mm"]])
    off = (seen[["x_mm", "y_mm", "z_mm"]].to_numpy() - turned) / 5e-3
    assert 0.5 < np.sqrt((off**2).mean()) < 1.6
    assert set(made.tables["truth"]["parameter"]) >= {"base_x", "base_rz"}


# --- faults ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('model = "six_pus"', 'model = "six_puss"', "model: found 'six_puss', did you mean 'six_pus'?"),
        ("kappa = [", "kapa = [", "truth.offsets: found 'kapa', did you mean 'kappa'?"),
        ("l = [0.37, ", "l = [", "truth.offsets.l: found 5 values, expected 1 or 6"),
        ('calibration = "calib', 'calibration = "kalib', "no such file"),
        ('calibration = "calibration_conf', 'calibration = "deformation_conf', "no such file"),
        ("[truth.offsets]", 'parameters = "t.csv"\n[truth.offsets]', "truth: expected offsets or parameters"),
        ("pad_radius_mm = 12.0", "", "targets_per_pad 2: expected pad_radius_mm"),
        ('model = "six_pus"', "", "model: missing"),
        ('status = "reconstructed"', 'status = "measured"', "provenance.status: found 'measured', expected"),
        ("[poses]", "[sensors]\nrho = { noise_um = 1.0 }\n[poses]", "sensors: found beside poses, expected either"),
        ("target_um = 3.0", "", "noise.target_um: missing"),
        ("[poses]", INSTRUMENT + "[poses]", "instrument: found with targets, expected either"),
        ('machine = "mechanism.toml"', 'mechanism = "mechanism.toml"', "mechanism: unknown key"),
    ],
)
def test_faulty_simulation(config, old, new, expected):
    studies.edit(config, old, new)
    assert expected in line_of(load_twin, config)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("n_poses = 6", "", "n_poses: found none, expected it, or [poses] with legs"),
        ("[sensors]", "[noise]\nactuator_um = 1.0\n[sensors]", "noise: found beside sensors, expected either"),
        ("[sensors]", f"{TARGETS}[noise]\ntarget_um = 1.0\n[sensors]", "measurement_frame: missing, expected it with"),
        (
            "[sensors]",
            f"{TARGETS}{SEEN_TARGETS}actuator_um = 1.0\n[sensors]",
            "noise.actuator_um: found beside sensors",
        ),
        ("[sensors]", f"{TARGETS}{SEEN_TARGETS}[sensors]", "targets: found a machine that does not say how its tool"),
        ("[sensors]", 'model = "six_ups"\n[sensors]', "provenance.model: unknown key"),
        (
            "[sensors]",
            '[instrument]\nkind = "poses"\nposition_um = 5.0\norientation_arcsec = 2.0\n[sensors]',
            "how its tool",
        ),
        (
            "n_poses = 6",
            'n_poses = 6\nmodel = "six_ups"',
            "model: found 'six_ups'",
        ),
        ("[sensors]", "[truth.offsets]\nt_x = [0.5, 1.0]\n[sensors]", "truth.offsets.t_x: found 2 values, expected 1"),
    ],
)
def test_faulty_simulation_of_readings(tmp_path, old, new, expected):
    path = calibrations.write_simulation(tmp_path)
    studies.edit(path, old, new)
    with pytest.raises(InputError) as caught:
        studies.simulate(path)
    assert expected in str(caught.value)


def test_only_legs_are_seen_by_an_instrument_of_their_platform(config):
    path = calibrations.copy_delta(config.parent) / "machine.toml"
    studies.edit(config, 'machine = "mechanism.toml"\nmodel = "six_pus"', f'machine = "{path}"')
    studies.edit(config, 'deformation_matrix = "deformation_matrix.csv"', "")
    with pytest.raises(InputError, match="without legs"):
        load_twin(config)


def test_table_of_another_machine(config):
    path = config.with_name("calibration_configurations.csv")
    path.write_text("drho_1,drho_2\n1,0\n")
    with pytest.raises(InputError, match="2 columns, expected 6,"):
        load_twin(config)
