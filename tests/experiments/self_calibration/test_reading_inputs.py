"""What a self-calibration reads, and what it refuses: code 2, one line, nothing written."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import studies
from reading_machines import EXPERIMENT
from reading_studies import describe_variant, load_small, write_small

from bayescal.errors import InputError
from bayescal.experiments.frame import memory
from bayescal.experiments.frame.load import load
from bayescal.experiments.self_calibration.blunders import list_denied, refuse_slip


@pytest.fixture
def small(tmp_path, monkeypatch) -> Path:
    """Return the config of a small self-calibration in the current directory."""
    monkeypatch.chdir(tmp_path)
    return write_small(tmp_path).relative_to(tmp_path)


def refuse(call, *arguments) -> str:
    before = studies.snapshot(Path())
    code, out, err = call(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("bayescal: ")
    assert err.count("\n") == 1
    assert studies.snapshot(Path()) == before
    return err


def change_cell(path: Path, row: int, column: str, change) -> None:
    """Change a cell, rows counted from the first below the header."""
    lines = path.read_text().splitlines()
    header = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    k = lines[header].split(",").index(column)
    cells = lines[header + 1 + row].split(",")
    cells[k] = str(change(cells[k]))
    lines[header + 1 + row] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")


def drop_column(path: Path, column: str) -> None:
    lines = path.read_text().splitlines()
    header = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    k = lines[header].split(",").index(column)
    cut = [",".join(c for i, c in enumerate(line.split(",")) if i != k) for line in lines[header:]]
    path.write_text("\n".join([*lines[:header], *cut]) + "\n")


CELLS = [
    (2, "phi_2_rad", lambda _: "47.5", "line 6: phi_2_rad: found 47.5, expected radians"),
    (2, "psi_3_rad", lambda _: "-6.3", "line 6: psi_3_rad: found -6.3, expected radians"),
    (4, "s_2_mm", lambda _: "", "line 8: s_2_mm: found '', expected a number"),
    (4, "s_2_mm", lambda _: "nan", "line 8: s_2_mm: found nan, expected a finite number"),
    (4, "phi_1_rad", lambda _: "inf", "line 8: phi_1_rad: found inf, expected a finite number"),
    (4, "s_2_mm", lambda _: "1e12", "line 8: s_2_mm: found 1e12, expected at most"),
    (1, "pose", lambda _: "C001", "line 5: pose 'C001' stands already on line 4, expected it once"),
    (1, "use", lambda _: "test", "line 5: use: found 'test', expected calibration or verification"),
    (7, "s_1_mm", lambda x: float(x) + 5000.0, "pose 'C008': found readings of s[1], s[2], s[3], phi[1]"),
    (7, "s_1_mm", lambda x: float(x) + 40.0, "pose 'C008': found readings"),
    (7, "s_1_mm", lambda x: float(x) + 0.03, "pose 'C008': found readings of s[1], s[2], s[3], phi[1]"),
    (5, "phi_2_rad", lambda x: float(x) + 2e-4, "pose 'C006': found readings of s[1], s[2], s[3], phi[1]"),
    (21, "s_3_mm", lambda x: float(x) - 40.0, "pose 'V02': found readings"),
    (21, "s_3_mm", lambda x: float(x) - 0.05, "pose 'V02': found readings"),
]


@pytest.mark.parametrize(("row", "column", "change", "expected"), CELLS)
def test_bad_readings_are_named_by_row_or_pose(call, small, row, column, change, expected):
    change_cell(Path("data/readings.csv"), row, column, change)
    message = refuse(call, "run", small, "--out", "new/out", "--workers", 1)
    assert "study.toml: " in message
    assert "data/readings.csv" in message
    assert expected in message


def test_readings_beyond_the_tolerances_are_refused_before_any_fit(call, small):
    """Of a variant too in which something is fixed, whose misfit might be the model's."""
    studies.edit(small, "sensors = ['s', 'phi']", "sensors = ['s', 'phi']\nfixed = ['beta']")
    change_cell(Path("data/readings.csv"), 7, "phi_2_rad", lambda x: float(x) + 0.6)
    message = refuse(call, "run", small)
    assert "pose 'C008'" in message
    assert "as tolerances and noise allow" in message


def change_columns(path: Path, columns: list[str], mend) -> None:
    """Change whole columns of numbers, (P, K), rows in their order."""
    lines = path.read_text().splitlines()
    header = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    places = [lines[header].split(",").index(column) for column in columns]
    cells = [line.split(",") for line in lines[header + 1 :]]
    values = mend(np.array([[float(row[k]) for k in places] for row in cells]))
    for row, one in zip(cells, values, strict=True):
        for k, value in zip(places, one, strict=True):
            row[k] = repr(float(value))
    path.write_text("\n".join([*lines[: header + 1], *(",".join(row) for row in cells)]) + "\n")


SLIPS = {
    "columns exchanged": (["s_1_mm", "s_2_mm"], lambda x: x[:, ::-1], "readings of s[1] and s[2] seem to be exchanged"),
    "a column shifted": (["phi_2_rad"], lambda x: np.roll(x, 1, axis=0), "rows of phi[2] seem to be shifted by one"),
    "the other sign": (
        ["phi_1_rad", "phi_2_rad", "phi_3_rad"],
        lambda x: -x,
        "readings of phi seem to be of the",
    ),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_the_likely_cause_of_readings_that_no_pose_explains_is_said(call, small, slip):
    columns, mend, said = SLIPS[slip]
    change_columns(Path("data/readings.csv"), columns, mend)
    message = refuse(call, "run", small)
    assert "if corrected: " + said in message


@pytest.mark.parametrize(("denied", "refused"), [([], True), (["legs"], False), (["rows", "unit"], True)])
def test_a_denied_slip_is_said_and_not_refused(small, denied, refused):
    experiment, config = load(small)
    inputs, where = experiment.read(config, small.parent), Path("readings.csv")
    values = inputs.table.values.copy()
    values[:, [0, 1]] = values[:, [1, 0]]
    data = config.data.model_copy(update={"denied_slips": denied})
    config = config.model_copy(update={"data": data})
    inputs = replace(inputs, config=config, table=replace(inputs.table, values=values))
    variant = next(iter(inputs.variants.values()))
    if refused:
        with pytest.raises(InputError, match=r"s\[1\] and s\[2\] seem to be exchanged; .* data.denied_slips"):
            refuse_slip(inputs, variant, where)
        return
    refuse_slip(inputs, variant, where)
    said = list_denied(inputs)
    assert said
    assert "readings of s[1] and s[2] seem to be exchanged" in said[0]


def test_a_single_blunder_is_no_slip(call, small):
    change_cell(Path("data/readings.csv"), 7, "phi_2_rad", lambda x: float(x) + 0.6)
    assert "if corrected" not in refuse(call, "run", small)


def test_degrees_are_told_by_their_size(call, small):
    """All angles in degrees: the first cell beyond a turn is named."""
    for row in range(23):
        change_cell(Path("data/readings.csv"), row, "phi_1_rad", lambda x: np.degrees(float(x)))
    assert "phi_1_rad: found" in refuse(call, "run", small)


TEXTS = [
    (
        "data/readings.csv",
        "s_1_mm",
        "s_1_m",
        "found column 's_1_m', did you mean 's_1_mm'?, expected pose, use, s_1_mm",
    ),
    ("data/readings.csv", "pose,use", "use,use", "found a column twice"),
    ("data/readings.csv", "verification", "calibration,1", "expected"),
    ("data/true_parameters.csv", "l[2]", "l[7]", "line 14: parameter: found 'l[7]', did you mean"),
    ("data/true_poses.csv", "C003", "C033", "poses: found 'C033' in row 3, expected 'C003'"),
    ("machine.toml", "length_mm = 800.0", "length_mm = 20.0", "machine 'star_3': home: leg 1 cannot reach it"),
    ("machine.toml", "[-300.000000, 519.615242]", "[-300.0, 2519.6]", "machine 'star_3'"),
    ("study.toml", "sensors = ['s', 'phi']", "sensors = ['s', 'phy']", "sensor 'phy': unknown here"),
    ("study.toml", "s = { noise_um = 1.0 }\n", "", "sensor s[1]: found no noise, expected an entry in [sensors]"),
    ("study.toml", "phi = { noise_arcsec", "phi = { noise_um", "found noise_um, expected noise_arcsec"),
    (
        "study.toml",
        "sensors = ['s', 'phi']",
        "sensors = ['s']",
        "variant 's6': sensors s[1], s[2], s[3]: found 0 equations",
    ),
    ("study.toml", "sensors = ['s', 'phi']", "sensors = ['s[1]']", "found 0 equations"),
    (
        "study.toml",
        "sensors = ['s', 'phi']",
        "sensors = ['s', 'phi']\nfixed = ['bta']",
        "found 'bta', did you mean 'beta'?",
    ),
    ("study.toml", "sensors = ['s', 'phi']", "sensors = ['s', 'phi']\nfixed = ['psi0']", "fixed: found 'psi0'"),
    ("study.toml", "sensors = ['s', 'phi']", "sensors = ['s', 'phi']\ncommon = ['xi_B[2]']", "expected at least two"),
    ("study.toml", "sensors = ['s', 'phi']", "sensors = ['s', 'phi']\nalso_free = ['l[1]']", "also_free: found 'l[1]'"),
    (
        "study.toml",
        "sensors = ['s', 'phi']",
        "sensors = ['s', 'phi']\nfixed = ['x_P', 'y_P', 'beta', 'l', 'xi_B', 'eta_B', 'phi0']",
        "fixed: found no parameter left free",
    ),
    (
        "study.toml",
        "sensors = ['s', 'phi']",
        "sensors = ['s[1]', 's[2]', 'x_V', 'y_V']",
        "found 2 sensors of the machine itself, expected at least 3",
    ),
    ("study.toml", "position_mm = 150.0", "position_mm = 60.0", "found its tool's centre"),
    ("study.toml", 'true_poses = "data/true_poses.csv"\n', "", "expected true_parameters and true_poses both or none"),
    ("study.toml", "readings.csv", "reading.csv", "reading.csv: no such file"),
    ("study.toml", "steps = 12", "step = 12", "sampler.step: unknown key, did you mean 'steps'?"),
    (
        "study.toml",
        "[sampler]",
        "[model_error]\nkernel_length = 0.0\n[sampler]",
        "model_error.kernel_length: found 0.0",
    ),
    (
        "study.toml",
        "[sampler]",
        "[model_error]\nkernel_scale_arcsec = -1.0\n[sampler]",
        "kernel_scale_arcsec: found -1.0",
    ),
    ("study.toml", "[sampler]", "[model_error]\nkernel = 'cubic'\n[sampler]", "model_error.kernel: found 'cubic'"),
    ("study.toml", "[sampler]", "[model_error]\nscale_um = 5.0\n[sampler]", "model_error.scale_um: unknown key"),
    (
        "study.toml",
        "[sampler]",
        "[model_error]\nkernel = 'smooth'\nkernel_length = 0.02\n[sampler]",
        "model_error.kernel_length: found smooth errors of a length down to 0.02 ranges, expected longer ones",
    ),
    (
        "study.toml",
        "[sampler]",
        "[model_error]\nkernel = 'smooth'\nkernel_length_spread = 3.0\n[sampler]",
        "model_error.kernel_length: found smooth errors of a length down to 0.00062 ranges",
    ),
    (
        "study.toml",
        "[sampler]",
        "[model_error]\nkernel = 'linear'\nkernel_sensors = ['phy']\n[sampler]",
        "model_error.kernel_sensors: sensor 'phy': unknown here",
    ),
    (
        "study.toml",
        "[sampler]",
        "[model_error]\nkernel = 'linear'\nkernel_sensors = ['psi']\n[sampler]",
        "model_error.kernel_sensors: found psi, expected some of s[1]",
    ),
]


@pytest.mark.parametrize(("name", "old", "new", "expected"), TEXTS)
def test_bad_files_are_one_line(call, small, name, old, new, expected):
    studies.edit(Path(name), old, new)
    assert expected in refuse(call, "run", small, "--out", "new/out", "--workers", 1)


def test_functions_that_take_too_much_memory(small, monkeypatch):
    studies.edit(small, "[sampler]", "[model_error]\nkernel = 'smooth'\n[sampler]")
    load_small(small)
    monkeypatch.setattr(memory, "measure_available", lambda: 0.5 * memory.PROCESS)  # enough for the poses
    with pytest.raises(InputError, match=r"memory: found 23 poses with \d+ coefficients of functions, which take"):
        load_small(small)
    studies.edit(small, "kernel = 'smooth'", "kernel = 'independent'")
    load_small(small)


def test_functions_are_of_the_sensors_that_may_err(small):
    block = "[model_error]\nkernel = 'linear'\nkernel_sensors = ['phi']\nkernel_scale_arcsec = 7.0\n[sampler]"
    studies.edit(small, "[sampler]", block)
    functions = load_small(small).variants["s6"].functions
    assert functions.names == ("sigma_g(phi)",)
    assert list(functions.places) == [3, 4, 5]
    np.testing.assert_allclose(functions.scale, np.radians(7.0 / 3600.0))
    np.testing.assert_allclose(functions.travel.home, 0.0, atol=1e-12)
    studies.edit(small, "kernel_sensors = ['phi']", "kernel_per_leg = true")
    studies.edit(small, "sensors = ['s', 'phi']", "sensors = ['s', 'phi', 'x_V', 'y_V']\nmodel_error = 'smooth'")
    functions = load_small(small).variants["s6"].functions
    assert functions.names == tuple(f"sigma_g({kind}[{k}])" for kind in ("s", "phi") for k in (1, 2, 3))
    assert functions.kernel == "smooth"


def test_two_variants_of_one_name(call, small):
    with small.open("a") as file:
        file.write(describe_variant("s6", ["s", "phi"]))
    assert "variants: found 's6' twice, expected each name once" in refuse(call, "run", small)


def test_fewer_equations_than_parameters(call, small):
    lines = Path("data/readings.csv").read_text().splitlines()
    Path("data/readings.csv").write_text("\n".join([*lines[:7], *lines[-3:]]) + "\n")
    poses = Path("data/true_poses.csv").read_text().splitlines()
    Path("data/true_poses.csv").write_text("\n".join([*poses[:7], *poses[-3:]]) + "\n")
    assert "found 12 equations (4 poses with 6 readings" in refuse(call, "run", small)


def test_poses_where_legs_cross(call, tmp_path, monkeypatch):
    """The shipped machine turned by 70 degrees: its legs cross, whatever its readings."""
    monkeypatch.chdir(tmp_path)
    import shutil

    shutil.copytree(EXPERIMENT, "star")
    from bayescal.experiments.shared.reading_machine import poses_about_home
    from bayescal.machines.read import read_sliding_platform

    model = read_sliding_platform(Path("star/machine.toml"))
    turned = poses_about_home(model, np.array([[0.0, 0.0, np.radians(120.0)]]))
    readings = model.read(model.layout.nominal, turned)[0]
    lines = Path("star/data/readings.csv").read_text().splitlines()
    cells = lines[3].split(",")[:2] + [f"{x:.9f}" for x in readings]
    Path("star/data/readings.csv").write_text("\n".join([*lines[:3], ",".join(cells), *lines[4:]]) + "\n")
    studies.edit(Path("star/study.toml"), "angle_deg = 30.0", "angle_deg = 30.0")
    message = refuse(call, "run", Path("star/study.toml"), "--out", "out")
    assert re.search(r"pose 'C001'.*legs \d and \d cross", message)


def test_columns_that_no_variant_uses_may_be_missing(small):
    for column in ("x_V_mm", "y_V_mm", "phi_V_rad", "psi_2_rad"):
        drop_column(Path("data/readings.csv"), column)
    inputs = load_small(small)
    assert np.isnan(inputs.table.values).any(axis=0).sum() == 4
    assert np.isfinite(inputs.measured(inputs.variants["s6"].sensors, False)).all()
    drop_column(Path("data/readings.csv"), "phi_2_rad")
    with pytest.raises(InputError, match="found no column 'phi_2_rad', expected pose, use, s_1_mm"):
        load_small(small)


def test_frames_are_given_and_an_instrument_frees_them(tmp_path):
    free = 'also_free = ["x_P[1]", "eta_B[2]"]'
    names = ["s", "phi", "x_V", "y_V", "phi_V"]
    path = write_small(tmp_path, describe_variant("in", names[:2]), describe_variant("out", names, free))
    inputs = load_small(path)
    frames = set(inputs.model.frame_parameters())
    inside, outside = (set(inputs.variants[name].free_names) for name in ("in", "out"))
    assert not inside & frames
    assert outside - inside == {"x_P[1]", "eta_B[2]", "xi_V", "eta_V"}
    assert inputs.variants["out"].internal.names == inputs.variants["in"].sensors.names


def test_commons_and_fixed_leave_the_rest(tmp_path):
    extra = 'fixed = ["beta", "phi0[2]"]\ncommon = ["l"]'
    inputs = load_small(write_small(tmp_path, describe_variant("few", ["s", "phi"], extra)))
    posterior = inputs.posterior(inputs.variants["few"])
    assert posterior.names == (
        *("x_P[2]", "x_P[3]", "y_P[2]", "y_P[3]", "l", "xi_B[2]", "xi_B[3]", "eta_B[3]", "phi0[1]", "phi0[3]"),
    )
    assert inputs.variants["few"].together.shape == (12, 10)


@pytest.mark.parametrize(("n_legs", "sensors"), [(3, ["s", "psi"]), (5, ["s"]), (6, ["s", "phi[1]", "psi[4]"])])
def test_poses_are_found_whatever_the_legs_and_sensors(tmp_path, n_legs, sensors):
    variant = describe_variant("one", sensors, 'fixed = ["x_P", "eta_B"]')
    inputs = load_small(write_small(tmp_path, variant, n_legs=n_legs))
    assert inputs.truth is not None
    off = inputs.variants["one"].pose - inputs.truth.pose
    assert np.abs(off[:, :2]).max() < 5.0  # a machine within tolerances of 0.3 mm and 2 deg
    assert np.abs(off[:, 2]).max() < 0.02


def test_simulated_readings_are_those_shipped(call, tmp_path):
    code, out, err = call("simulate", EXPERIMENT / "simulate.toml", "--out", tmp_path)
    assert (code, err) == (0, "")
    assert out.count("wrote ") == 3
    assert studies.snapshot(tmp_path) == studies.snapshot(EXPERIMENT / "data")
    call("simulate", EXPERIMENT / "simulate.toml", "--out", tmp_path, "--seed", 1)
    assert studies.snapshot(tmp_path) != studies.snapshot(EXPERIMENT / "data")
    assert "never measured" in (EXPERIMENT / "data" / "readings.csv").read_text().splitlines()[0]


def test_truth_fed_back_gives_the_same_readings(call, tmp_path, monkeypatch):
    import shutil

    monkeypatch.chdir(tmp_path)
    shutil.copytree(EXPERIMENT, tmp_path / "star")
    config = tmp_path / "star" / "simulate.toml"
    call("simulate", config, "--out", tmp_path / "first", "--seed", 3)
    shutil.copy(tmp_path / "first" / "true_parameters.csv", tmp_path / "star" / "given.csv")
    studies.edit(config, "[poses]", '[truth]\nparameters = "given.csv"\n\n[poses]')
    code, _, err = call("simulate", config, "--out", tmp_path / "again", "--seed", 3)
    assert (code, err) == (0, "")
    assert studies.snapshot(tmp_path / "again") == studies.snapshot(tmp_path / "first")
    call("simulate", config, "--out", tmp_path / "other", "--seed", 4)
    first, other = (studies.snapshot(tmp_path / name) for name in ("first", "other"))
    assert first["true_parameters.csv"] == other["true_parameters.csv"]
    assert first["readings.csv"] != other["readings.csv"]
    studies.edit(tmp_path / "star" / "given.csv", "l[2],mm", "l[2],m")
    assert "given.csv, line" in refuse(call, "simulate", config, "--out", "new")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('common = ["l"]', 'common = ["legs"]', "common: found 'legs', expected one of x_P"),
        ("position_mm = 200.0", "position_mm = 900.0", "cannot reach it"),
        ("n_poses = 60", "n_pose = 60", "poses.n_pose: unknown key"),
        ('"machine.toml"', '"machin.toml"', "machin.toml: no such file"),
    ],
)
def test_bad_simulations_are_one_line(call, tmp_path, monkeypatch, old, new, expected):
    import shutil

    monkeypatch.chdir(tmp_path)
    shutil.copytree(EXPERIMENT, "star")
    studies.edit(Path("star/simulate.toml"), old, new)
    assert expected in refuse(call, "simulate", "star/simulate.toml", "--out", "new")


def test_simulated_noise_has_its_size():
    from bayescal.experiments.frame.load import load_experiment

    config = load_experiment(EXPERIMENT / "study.toml")
    inputs = load_small(EXPERIMENT / "study.toml")
    assert inputs.truth is not None
    left = inputs.table.values - inputs.model.read(inputs.truth.theta, inputs.truth.pose)
    for k, channel in enumerate(inputs.model.channels):
        section = config.sensors[channel.name.partition("[")[0]]
        noise = 1e-3 * section.noise_um if section.noise_um else np.radians(section.noise_arcsec / 3600)
        assert np.std(left[:, k]) == pytest.approx(noise, rel=0.35)  # 72 readings: 0.08 is one standard deviation
    assert np.ptp(inputs.model.layout.take(inputs.truth.theta, "l")) < 1e-9
