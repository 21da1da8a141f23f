"""Studies by an instrument: poses fed back from targets, tracked points, and every fault of their tables."""

import re
import shutil

import numpy as np
import pytest
import studies

from bayescal.data.truth import PARAMETER_COLUMNS
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.run import compute_experiment
from bayescal.experiments.shared.readings.errors import drop_model_error
from bayescal.experiments.simulation.compute import POSE_COORDINATES, build_twin
from bayescal.experiments.study.readings import fit_variant
from bayescal.files.csv_tables import read_table
from bayescal.inference.mode import find_modes
from bayescal.machines.kinematics import solve_forward_kinematics

pytestmark = pytest.mark.runs

FRAMES = "frames.base = { position = 0.5, rotation = 0.05 }\nframes.tool = { position = 0.5, rotation = 0.05 }\n\n"
POINTS = """kind = "points"
file = "data/points.csv"
probe = "probe.csv"
stations = "stations.csv"
actuators = "data/actuators.csv"
range_um = 5.0
range_ppm = 0.5
azimuth_arcsec = 1.0
elevation_arcsec = 1.0
"""
INSTRUMENT = """
[instrument]
kind = "points"
probe = "probe.csv"
stations = "stations.csv"
range_um = 5.0
range_ppm = 0.5
azimuth_arcsec = 1.0
elevation_arcsec = 1.0
missing_fraction = 0.3

[instrument.frames]
base = [{ position_mm = [0.3, -0.2, 0.1], rotation_deg = [0.02, 0.01, -0.03] }, { position_mm = [-0.4, 0.2, 0.3] }]
tool = { position_mm = [0.2, 0.5, -0.1] }
"""
PROBE = """point,x_mm,y_mm,z_mm
P1,100,0,40
P2,-60,80,20
P3,-50,-90,60
P4,10,20,150
"""
STATIONS = """station,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg
north,2000,100,300,0,0,160
south,-1500,-1200,200,0,0,20
"""


@pytest.fixture(scope="module")
def fed(tmp_path_factory):
    """Return a folder with a tiny study by targets, and the same by the poses extracted from them."""
    folder = tmp_path_factory.mktemp("fed")
    config = studies.write_tiny_study(folder)
    studies.edit(config, 'deformation = "matrix"', 'deformation = "linear"')
    (folder / "data" / "poses.csv").write_text(studies.feed_poses(config))
    (folder / "poses.toml").write_text(config.read_text().replace(studies.BY_TARGETS, studies.BY_POSES))
    return folder


def write_points(folder):
    """Write the tiny twin's points as two stations see them, and its study."""
    config = studies.write_tiny_study(folder)
    studies.edit(config, 'deformation = "matrix"', 'deformation = "linear"')
    studies.write_texts(folder, {"probe.csv": PROBE, "stations.csv": STATIONS})
    text = (folder / "simulate.toml").read_text()
    text = text[: text.index("[targets]")].replace("target_um = 3.0\n", "") + INSTRUMENT
    text = re.sub(r"kappa = \[.*\]\n", "", text).replace('deformation_matrix = "deformation_matrix.csv"\n', "")
    (folder / "simulate.toml").write_text(text)
    made = compute_experiment(load_experiment(folder / "simulate.toml"), folder).files
    studies.write_texts(folder, {f"data/{name}": str(one) for name, one in made.items()})
    text = config.read_text().replace(studies.BY_TARGETS, POINTS).replace("[sensors]\n", FRAMES + "[sensors]\n")
    (folder / "points.toml").write_text(text)
    return folder / "points.toml"


@pytest.fixture(scope="module")
def pointed(tmp_path_factory):
    return write_points(tmp_path_factory.mktemp("pointed"))


def leave_positions(table):
    """Return a table of poses without its rotations."""
    rows = table.splitlines()
    head = next(row for row in rows if row.startswith("pose,")).split(",")
    kept = [k for k, name in enumerate(head) if not re.search(r"r[xyz]", name)]
    return "\n".join(row if row.startswith("#") else ",".join(row.split(",")[k] for k in kept) for row in rows) + "\n"


def compare_modes(one, other):
    """Return differences of log-evidence (Laplace) and of the modes in posterior sds, variant by variant."""
    for variant in one.config.variants:
        first, second = (inputs.variants[variant.name].posterior().with_pose_guesses() for inputs in (one, other))
        a, b = find_modes(first)[0], find_modes(second)[0]
        assert first.names == second.names
        yield abs(a.log_evidence - b.log_evidence), np.abs((a.y - b.y) / np.sqrt(np.diagonal(a.covariance))).max()


def test_poses_fed_back_are_the_targets(fed):
    """The digits of the table are all that is lost."""
    one, other = studies.load_study(fed / "study.toml"), studies.load_study(fed / "poses.toml")
    poses, fed_back = one.measured[0].poses, other.measured[0].poses
    np.testing.assert_allclose(fed_back.position, poses.position, atol=1e-7)
    np.testing.assert_allclose(fed_back.covariance, poses.covariance, rtol=1e-5, atol=1e-16)
    for evidence, mean in compare_modes(one, other):
        assert evidence < 0.02
        assert mean < 0.02


@pytest.mark.slow
def test_poses_of_the_telescope_fed_back_give_its_evidence(tmp_path):
    """By sampling, as the study itself does; κ free instead of K, which targets alone tell."""
    shutil.copytree(studies.TELESCOPE, tmp_path, dirs_exist_ok=True)
    config = tmp_path / "study.toml"
    studies.edit(config, 'published_claims = "claims.py:Rr8096"\n', "")
    (tmp_path / "data" / "poses.csv").write_text(studies.feed_poses(config))
    text = config.read_text().replace('matrix = "targets"', 'matrix = "unused.csv"')
    for start in ('kind = "targets', "file =", "reference =", "target_noise_um =", "pose_estimator ="):
        text = re.sub(rf"^{start}.*\n", "", text, flags=re.MULTILINE)
    text = text.replace("[[data]]\n", '[[data]]\nkind = "poses"\nfile = "data/poses.csv"\n')
    blocks = text.split("[[variants]]")
    kept = [b for b in blocks[1:] if '"matrix"' not in b and '"six_pus"' in b]
    tail = blocks[-1][blocks[-1].index("[sampler]") :]
    (tmp_path / "unused.csv").write_text("k1,k2,k3,k4,k5,k6\n" + "0,0,0,0,0,0\n" * 6)
    (tmp_path / "poses.toml").write_text("[[variants]]".join([blocks[0], *kept]) + tail)
    one, other = studies.load_study(config), studies.load_study(tmp_path / "poses.toml")
    for variant in other.config.variants:
        first, second = (fit_variant(inputs, variant.name) for inputs in (one, other))
        assert abs(first.importance.log_evidence - second.importance.log_evidence) < 0.02
        assert np.abs((first.mean - second.mean) / first.sd).max() < 0.02


def test_points_of_two_stations_find_the_machine_and_their_frames(pointed):
    """Every parameter within four posterior sds of the truth, a third of the points unseen."""
    inputs = studies.load_study(pointed)
    posterior = drop_model_error(inputs.variants["six_pus/none"].posterior()).with_pose_guesses()
    mode = find_modes(posterior)[0]
    assert mode.converged
    truth = dict.fromkeys(posterior.names, 0.0)
    truth |= {f"base1_{axis}": x for axis, x in zip("xyz", (0.3, -0.2, 0.1), strict=True)}
    truth |= {f"base1_r{axis}": np.radians(x) for axis, x in zip("xyz", (0.02, 0.01, -0.03), strict=True)}
    truth |= {f"base2_{axis}": x for axis, x in zip("xyz", (-0.4, 0.2, 0.3), strict=True)}
    truth |= {f"tool_{axis}": x for axis, x in zip("xyz", (0.2, 0.5, -0.1), strict=True)}
    nominal = dict(zip(posterior.likelihood.layout.names, posterior.likelihood.layout.nominal, strict=True))
    offsets = (0.37, -0.45, 1.02, 0.25, 0.43, 0.58)
    truth |= {f"l[{leg}]": nominal[f"l[{leg}]"] + x for leg, x in enumerate(offsets, start=1)}
    sd = np.array([posterior.priors[name].sd for name in posterior.names]) * np.sqrt(np.diagonal(mode.covariance))
    z = (posterior.natural(mode.y[None])[0] - [truth[name] for name in posterior.names]) / sd
    assert np.abs(z).max() < 4.0
    assert sd.min() < 0.02 * 0.5  # so that it is not the prior that says so


def test_positions_alone_are_a_study_with_a_page(fed, tmp_path, call, no_pictures, search_little):
    (fed / "data" / "positions.csv").write_text(leave_positions((fed / "data" / "poses.csv").read_text()))
    text = (fed / "poses.toml").read_text().replace("poses.csv", "positions.csv")
    text = text.replace("[sensors]\n", FRAMES + "[sensors]\n")
    text = re.sub(r"kappa = \{.*\n", "", text)
    first = text.index("[[variants]]")
    second = text.index("[[variants]]", first + 1)
    (fed / "positions.toml").write_text(text[:second] + text[text.index("[sampler]") :])
    code, _, err = call("run", fed / "positions.toml", "--out", tmp_path / "out", "--workers", 1, "--quiet")
    assert code in (0, 3), err  # so few steps may not converge
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Frames found" in page
    assert "orientation error" not in page.split("Accuracy")[1][:400]
    assert "Rejected targets" not in page
    assert "base" in (tmp_path / "out" / "tables" / "parameters.csv").read_text()


def test_the_truth_stands_beside_simulated_readings(pointed):
    """Of machine and platform, not of frames, which the config states; fed back it is the same machine."""
    folder = pointed.parent
    inputs = studies.load_study(pointed)
    twin = build_twin(load_experiment(folder / "simulate.toml"), folder)
    parameters = read_table(folder / "data" / "true_parameters.csv", PARAMETER_COLUMNS)
    assert parameters.text("parameter") == list(twin.machine.layout.names)
    poses = read_table(folder / "data" / "true_poses.csv", ("pose", *POSE_COORDINATES))
    seen = inputs.measured[0].poses
    assert poses.text("pose") == list(seen.names)
    commanded = solve_forward_kinematics(twin.machine, twin.theta, seen.actuators)
    off = np.abs(commanded.position - poses.numbers(POSE_COORDINATES[:3]))
    assert 1e-4 < off.max() < 0.05  # the actuators' 1 µm, some times over
    text = (folder / "simulate.toml").read_text()
    fed = folder / "fed_back.toml"
    truth = re.sub(
        r"\[truth.*?(?=\n\[poses\])", '[truth]\nparameters = "data/true_parameters.csv"\n', text, flags=re.DOTALL
    )
    fed.write_text(truth)
    made = compute_experiment(load_experiment(fed), folder).files
    assert {name: (folder / "data" / name).read_text() for name in made} == made


# --- faults ------------------------------------------------------------------------------------------------------


def swap_column(name, other):
    return lambda text: text.replace(name, other)


def scale_columns(names, factor):
    def change(text):
        rows = text.splitlines()
        start = next(k for k, row in enumerate(rows) if row.startswith("pose,"))
        index = [rows[start].split(",").index(name) for name in names]
        for k in range(start + 1, len(rows)):
            cells = rows[k].split(",")
            for i in index:
                cells[i] = f"{float(cells[i]) * factor:.12g}"
            rows[k] = ",".join(cells)
        return "\n".join(rows) + "\n"

    return change


def set_cell(row_start, name, value):
    def change(text):
        rows = text.splitlines()
        head = next(row for row in rows if row.startswith("pose,")).split(",")
        k = next(k for k, row in enumerate(rows) if row.startswith(row_start))
        cells = rows[k].split(",")
        cells[head.index(name)] = value
        rows[k] = ",".join(cells)
        return "\n".join(rows) + "\n"

    return change


FAULTS = {
    "poses.toml": {
        "no columns": ("data/poses.csv", lambda text: re.sub("pose,use.*", "pose,use,foo", text), "found column 'foo'"),
        "another unit": (
            "data/poses.csv",
            swap_column("rx_deg", "rx_rad"),
            "readings of rx seem to be in degrees",
        ),
        "metres": ("data/poses.csv", scale_columns(("x_mm", "y_mm", "z_mm"), 1e-3), "metres, expected mm"),
        "radians": (
            "data/poses.csv",
            scale_columns(("rx_deg", "ry_deg", "rz_deg"), np.pi / 180),
            "radians, expected degrees",
        ),
        "negative variance": ("data/poses.csv", set_cell("C03,", "cov_x_x", "-1"), "covariance: found variance -1"),
        "no covariance": (
            "data/poses.csv",
            set_cell("C03,", "cov_x_y", "1e6"),
            "covariance: found an indefinite matrix",
        ),
        "missing entry": ("data/poses.csv", set_cell("C03,", "cov_x_y", ""), "cov_x_y: found nothing"),
        "no coordinate": (
            "data/poses.csv",
            lambda text: re.sub(r"^C03,calibration(,[^,]*){6}", "C03,calibration,,,,,,", text, flags=re.MULTILINE),
            "found no coordinate",
        ),
        "another use": ("data/poses.csv", set_cell("C03,", "use", "verification"), "use: differs from"),
        "unknown pose": ("data/poses.csv", swap_column("C03,", "C99,"), "pose 'C99': not in"),
        "missing pose": ("data/poses.csv", lambda text: re.sub("\nC03,.*", "", text), "found nothing of pose 'C03'"),
        "key of another measurement": (
            "poses.toml",
            swap_column('kind = "poses"', 'kind = "poses"\ntarget_noise_um = 3.0'),
            "data.0.target_noise_um: unknown key, expected one of actuators, file, frames, kind, name, ",
        ),
        "noise twice": (
            "poses.toml",
            swap_column('kind = "poses"', 'kind = "poses"\nposition_um = 3.0'),
            "found noise columns and position_um",
        ),
        "unknown instrument": (
            "poses.toml",
            swap_column('"poses"', '"theodolite"'),
            "found 'theodolite', expected one of",
        ),
    },
    "points.toml": {
        "unknown station": ("data/points.csv", swap_column(",north,", ",nord,"), "station 'nord' is not in"),
        "unknown point": ("data/points.csv", swap_column(",P4,", ",P9,"), "point 'P9': not in"),
        "no points": ("data/points.csv", lambda text: re.sub(r"\nC02,.*", "", text), "found nothing of pose 'C02'"),
        "metres": ("data/points.csv", scale_columns(("range_mm",), 1e-3), "expected"),
        "radians": (
            "data/points.csv",
            scale_columns(("azimuth_deg", "elevation_deg"), np.pi / 180),
            "station 'north': found points 826",
        ),
        "another unit": ("data/points.csv", swap_column("azimuth_deg", "azimuth_rad"), "azimuth_rad: found"),
        "no noise": (
            "points.toml",
            lambda text: re.sub(r"(range|azimuth|elevation)_\w+ = .*\n", "", text),
            "found no noise",
        ),
        "half a noise": ("points.toml", swap_column("azimuth_arcsec = 1.0\n", ""), "together"),
        "one station twice": ("stations.csv", swap_column("south", "north"), "is already on line"),
    },
    "study.toml": {
        "no frame for targets": (
            "study.toml",
            swap_column("[sensors]\n", FRAMES + "[sensors]\n"),
            "data.0.frames: unknown key",
        ),
    },
}
"""By config: what happens to a file, and what is said of it."""


@pytest.mark.parametrize(("config", "name"), [(config, name) for config, own in FAULTS.items() for name in own])
def test_faults_of_tables_are_one_line(fed, pointed, tmp_path, call, config, name):
    shutil.copytree(fed if config == "poses.toml" else pointed.parent, tmp_path, dirs_exist_ok=True)
    file, change, expected = FAULTS[config][name]
    text = (tmp_path / file).read_text()
    assert change(text) != text
    (tmp_path / file).write_text(change(text))
    before = studies.snapshot(tmp_path)
    code, out, err = call("run", tmp_path / config, "--out", tmp_path / "out")
    assert (code, out) == (2, ""), err
    (line,) = studies.list_errors(err)
    assert expected in line, line
    assert studies.snapshot(tmp_path) == before


# --- the shipped example -----------------------------------------------------------------------------------------

CAMERA = studies.EXPERIMENTS / "camera_hexapod"


def test_shipped_example_finds_its_machine_and_frames():
    """The 54 errors in posterior sds: their mean square is one within four standard errors of independent ones."""
    inputs = studies.load_study(CAMERA / "study.toml")
    variant = inputs.variants[inputs.config.variants[0].name]
    posterior = drop_model_error(variant.posterior()).with_pose_guesses()
    mode = find_modes(posterior)[0]
    truth = compute_experiment(load_experiment(CAMERA / "simulate.toml"), CAMERA).tables["truth"]
    true = truth.set_index("parameter")["true"]
    assert set(true.index) == set(posterior.names)
    sd = np.array([posterior.priors[name].sd for name in posterior.names]) * np.sqrt(np.diagonal(mode.covariance))
    z = (posterior.natural(mode.y[None])[0] - true[list(posterior.names)].to_numpy()) / sd
    assert abs(np.mean(z**2) - 1.0) < 4.0 * np.sqrt(2.0 / len(z))
