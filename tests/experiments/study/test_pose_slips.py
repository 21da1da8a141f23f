"""Slips of measured poses planted in a study by poses: the cause is found by trying it, clean ones pass."""

import numpy as np
import pytest
import studies
import test_instrument_study as instruments
from scipy.spatial.transform import Rotation
from shares import run_rest

from bayescal.errors import InputError
from bayescal.experiments.shared.slip_causes import list_rereads


@pytest.fixture(scope="module")
def fed(tmp_path_factory):
    """Return a tiny study by poses."""
    folder = tmp_path_factory.mktemp("pose_slips")
    config = studies.write_tiny_study(folder)
    studies.edit(config, 'deformation = "matrix"', 'deformation = "linear"')
    (folder / "data" / "poses.csv").write_text(studies.feed_poses(config))
    config.write_text(config.read_text().replace(studies.BY_TARGETS, studies.BY_POSES))
    return config


def look(config, table="poses.csv", change=None):
    """Return what is said of a study, some rows of a table changed: a doubt, or why it is refused; empty for none."""
    with studies.changed_table(config.parent / "data" / table, change or (lambda rows: rows)):
        try:
            slip = studies.load_study(config).slip
        except InputError as error:
            return str(error)
    return "" if slip is None else slip.text


def negate(*names):
    """Return what changes the sign of columns."""

    def change(rows):
        own = [rows[0].index(name) for name in names]
        return [rows[0], *([str(-float(x)) if k in own else x for k, x in enumerate(row)] for row in rows[1:])]

    return change


def exchange(one, other):
    """Return what exchanges the cells of two columns below their names."""

    def change(rows):
        i, j = rows[0].index(one), rows[0].index(other)
        for row in rows[1:]:
            row[i], row[j] = row[j], row[i]
        return rows

    return change


CAUSES = {
    "turned back": (negate("rx_deg", "ry_deg", "rz_deg"), "rotations seem to be those of the base"),
    "mirrored": (negate("y_mm", "rx_deg", "rz_deg"), "left-handed, y of the other sign"),
    "z": (negate("z_mm"), "readings of z seem to be of the other sign"),
    "exchanged": (exchange("x_mm", "y_mm"), "readings of x and y seem to be exchanged"),
}


@pytest.mark.parametrize("cause", run_rest(CAUSES, 1))
def test_likely_cause_is_found(fed, cause):
    change, said = CAUSES[cause]
    assert said in look(fed, change=change)


def test_clean_poses_are_not_suspected(fed):
    assert look(fed) == ""


@pytest.mark.parametrize("axes", ["xyz", "zyx", "yxz"])
def test_angles_that_were_read_as_vectors_become_the_rotations_they_are(axes, rng):
    angles = rng.uniform(-0.3, 0.3, (4, 3))
    truth = Rotation.from_euler(axes, angles[:, ["xyz".index(axis) for axis in axes]]).as_matrix()
    read = list_rereads(np.ones((4, 3)), Rotation.from_rotvec(angles).as_matrix())
    (right,) = [text for text, _, rotation in read if np.allclose(rotation, truth, atol=1e-12)]
    assert f"fixed axes {', '.join(axes)}:" in right


def test_poses_of_the_base_are_turned_round_into_those_of_the_platform():
    turned = Rotation.from_rotvec([[0.1, 0.2, 0.3], [0.0, -0.4, 0.2]]).as_matrix()
    position = np.arange(6.0).reshape(2, 3) + 200.0
    back = np.swapaxes(turned, 1, 2)
    read = list_rereads(-np.einsum("pij,pj->pi", back, position), back)
    (found,) = [poses for text, *poses in read if "poses seem to be those of the base" in text]
    np.testing.assert_allclose(found[0], position, atol=1e-12)
    np.testing.assert_allclose(found[1], turned, atol=1e-12)


@pytest.mark.runs
@pytest.mark.parametrize("probe", [instruments.PROBE[: instruments.PROBE.index("P2")], instruments.PROBE])
def test_exchanged_legs_are_found_from_points_in_free_frames(probe, tmp_path, monkeypatch):
    """A single point, which does not tell the pose, and four, which do."""
    monkeypatch.setattr(instruments, "PROBE", probe)
    path = instruments.write_points(tmp_path)
    assert look(path, "actuators.csv") == ""
    found = look(path, "actuators.csv", exchange("rho_2_mm", "rho_3_mm"))
    assert "of rho[2] and rho[3]" in found


def swap_two(rows):
    rows[4][2:], rows[5][2:] = rows[5][2:], rows[4][2:]
    return rows


def shift_calibration(rows, first=5):
    """Of the poses for calibration each from some place on has what belongs to the one before."""
    own = [row for row in rows if "calibration" in row]
    values = [row[2:] for row in own]
    for row, known in zip(own[first:], values[first - 1 :], strict=False):
        row[2:] = known
    return rows


ELSEWHERE = {
    "two rows": (swap_two, "rows 4 (pose 'C04') and 5 (pose 'C05') seem to have each other's rho"),
    "from a row on": (shift_calibration, "rows of rho seem to be shifted by one from row 6 (pose 'C06')"),
    "all": (lambda rows: shift_calibration(rows, 1), "rows of rho seem shifted by one, readings of the row earlier"),
}


@pytest.mark.parametrize("where", run_rest(ELSEWHERE, 1))
def test_rows_of_actuators_that_stand_elsewhere_are_found(fed, where):
    change, said = ELSEWHERE[where]
    assert said in look(fed, "actuators.csv", change)


def test_a_single_pose_that_is_off_is_found(fed):
    def spoil(rows):
        rows[6][rows[0].index("x_mm")] = str(float(rows[6][rows[0].index("x_mm")]) + 0.5)
        return rows

    assert "row 6 (pose 'C06')" in look(fed, change=spoil)
