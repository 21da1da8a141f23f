"""Slips of measured poses planted in a study by poses: the cause is found by trying it, clean ones pass."""

import numpy as np
import pytest
import studies
import test_instrument_study as instruments
from scipy.spatial.transform import Rotation
from shares import run_rest

from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.shared.slip_causes import list_rereads
from bayescal.experiments.study.doubts import find_study_slip
from bayescal.experiments.study.inputs import load_inputs
from bayescal.experiments.study.tables import format_poses
from bayescal.files.csv_tables import read_table


@pytest.fixture(scope="module")
def fed(tmp_path_factory):
    """Return a folder with a tiny study by poses, and its table's columns."""
    folder = tmp_path_factory.mktemp("pose_slips")
    config = studies.write_tiny_study(folder)
    studies.edit(config, 'deformation = "matrix"', 'deformation = "linear"')
    (folder / "data" / "poses.csv").write_text(format_poses(studies.load_study(config)))
    config.write_text(config.read_text().replace(studies.BY_TARGETS, studies.BY_POSES))
    return folder


def look(folder, change=None):
    """Return the slip that is found where a change was made to named columns of the poses."""
    path = folder / "data" / "poses.csv"
    original = path.read_text()
    if change is not None:
        table = read_table(path, None)
        columns = {name: table.text(name) for name in table.columns}
        columns = change(columns)
        rows = zip(*columns.values(), strict=True)
        path.write_text("\n".join(",".join(row) for row in [tuple(columns), *rows]) + "\n")
    try:
        return find_study_slip(load_inputs(load_experiment(folder / "study.toml"), folder))
    finally:
        path.write_text(original)


def turn_back(columns):
    return columns | {name: [str(-float(x)) for x in columns[name]] for name in ("rx_deg", "ry_deg", "rz_deg")}


def flip_z(columns):
    return columns | {"z_mm": [str(-float(x)) for x in columns["z_mm"]]}


def exchange(columns):
    return columns | {"x_mm": columns["y_mm"], "y_mm": columns["x_mm"]}


def mirror(columns):
    return columns | {name: [str(-float(x)) for x in columns[name]] for name in ("y_mm", "rx_deg", "rz_deg")}


CAUSES = {
    "turned back": (turn_back, "poses", "the other way round"),
    "mirrored": (mirror, "poses", "left-handed frame, y of the other sign"),
    "z": (flip_z, "unit", "readings of z seem to be of the other sign"),
    "exchanged": (exchange, "legs", "readings of x and y seem to be exchanged"),
}


@pytest.mark.parametrize("cause", run_rest(CAUSES, 2))
def test_likely_cause_is_found(fed, cause):
    change, fault, said = CAUSES[cause]
    slip = look(fed, change)
    assert slip is not None
    assert slip.fault == fault
    assert said in slip.text


def test_clean_poses_are_not_suspected(fed):
    assert look(fed) is None


@pytest.mark.parametrize("axes", ["xyz", "zyx", "yxz"])
def test_angles_that_were_read_as_vectors_become_the_rotations_they_are(axes, rng):
    angles = rng.uniform(-0.3, 0.3, (4, 3))
    truth = Rotation.from_euler(axes, angles[:, ["xyz".index(axis) for axis in axes]]).as_matrix()
    read = list_rereads(np.ones((4, 3)), Rotation.from_rotvec(angles).as_matrix())
    (right,) = [text for text, _, rotation in read if np.allclose(rotation, truth, atol=1e-12)]
    assert f"the fixed axes {', '.join(axes)} one after the other" in right


def test_poses_of_the_base_are_turned_round_into_those_of_the_platform():
    turned = Rotation.from_rotvec([[0.1, 0.2, 0.3], [0.0, -0.4, 0.2]]).as_matrix()
    position = np.arange(6.0).reshape(2, 3) + 200.0
    back = np.swapaxes(turned, 1, 2)
    read = list_rereads(-np.einsum("pij,pj->pi", back, position), back)
    (found,) = [poses for text, *poses in read if "those of the base in the platform's frame" in text]
    np.testing.assert_allclose(found[0], position, atol=1e-12)
    np.testing.assert_allclose(found[1], turned, atol=1e-12)


@pytest.mark.parametrize("probe", run_rest([instruments.PROBE[: instruments.PROBE.index("P2")], instruments.PROBE], 1))
def test_exchanged_legs_are_found_from_points_in_free_frames(probe, tmp_path, monkeypatch):
    """A single point, which does not tell the pose, and four, which do."""
    monkeypatch.setattr(instruments, "PROBE", probe)
    path = instruments.write_points(tmp_path)
    assert find_study_slip(load_inputs(load_experiment(path), tmp_path)) is None
    table = tmp_path / "data" / "actuators.csv"
    comments = [line for line in table.read_text().splitlines() if line.startswith("#")]
    header, *rows = [line.split(",") for line in table.read_text().splitlines() if not line.startswith("#")]
    two, three = header.index("rho_2_mm"), header.index("rho_3_mm")
    for row in rows:
        row[two], row[three] = row[three], row[two]
    table.write_text("\n".join([*comments, *map(",".join, [header, *rows])]) + "\n")
    found = find_study_slip(load_inputs(load_experiment(path), tmp_path))
    assert found is not None
    assert "readings of rho[2] and rho[3] seem to be exchanged" in found.text


def edit_actuators(folder, change):
    """Change the table of actuators, a list of rows by column, and return its original text."""
    path = folder / "data" / "actuators.csv"
    original = path.read_text()
    comments = [line for line in original.splitlines() if line.startswith("#")]
    header, *rows = [line.split(",") for line in original.splitlines() if not line.startswith("#")]
    own = [k for k, name in enumerate(header) if name.startswith("rho")]
    change(rows, own)
    path.write_text("\n".join([*comments, *map(",".join, [header, *rows])]) + "\n")
    return path, original


def swap_two(rows, own):
    for k in own:
        rows[3][k], rows[4][k] = rows[4][k], rows[3][k]


def shift_calibration(rows, own, first=5):
    """Of the poses for calibration each from some place on has what belongs to the one before."""
    places = [k for k, row in enumerate(rows) if "calibration" in row]
    values = [[rows[k][i] for i in own] for k in places]
    for k, known in zip(places[first:], values[first - 1 :], strict=False):
        for i, value in zip(own, known, strict=True):
            rows[k][i] = value


ELSEWHERE = {
    "two rows": (swap_two, "rows 4 (pose 'C04') and 5 (pose 'C05') seem to have each other's rho"),
    "from a row on": (shift_calibration, "rows of rho seem to be shifted by one from row 6 (pose 'C06')"),
    "all": (lambda *table: shift_calibration(*table, 1), "they belong to the readings of the row earlier"),
}


@pytest.mark.parametrize("where", run_rest(ELSEWHERE, 2))
def test_rows_of_actuators_that_stand_elsewhere_are_found(fed, where):
    change, said = ELSEWHERE[where]
    path, original = edit_actuators(fed, change)
    try:
        slip = look(fed)
    finally:
        path.write_text(original)
    assert slip is not None
    assert slip.fault == "rows"
    assert said in slip.text, slip.text


def test_a_single_pose_that_is_off_is_found(fed):
    def spoil(columns):
        values = list(columns["x_mm"])
        values[5] = str(float(values[5]) + 0.5)
        return columns | {"x_mm": values}

    slip = look(fed, spoil)
    assert slip is not None
    assert "row 6 (pose 'C06') does not belong to the others" in slip.text
