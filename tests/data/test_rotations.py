"""Rotations of a table: the forms that instruments write, and what they are refused for."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bayescal.data.instruments.read_poses import MATRIX, SEQUENCES, name_angles, read_rotation_vectors
from bayescal.errors import InputError
from bayescal.files.csv_tables import read_table

TURNS = Rotation.from_rotvec([[0.1, -0.2, 0.3], [-0.9, 0.4, 0.05], [0.0, 0.0, 0.0]])


def write(path, columns, values):
    rows = "\n".join(",".join(f"{x:.12f}" for x in row) for row in values)
    path.write_text(f"{','.join(columns)}\n{rows}\n")
    return read_table(path, None)


@pytest.mark.parametrize(
    ("columns", "values"),
    [
        (("rx_deg", "ry_deg", "rz_deg"), np.degrees(TURNS.as_rotvec())),
        (("qx", "qy", "qz", "qw"), TURNS.as_quat()),
        (("qx", "qy", "qz", "qw"), -TURNS.as_quat()),
        (("rx_rad", "ry_rad", "rz_rad"), TURNS.as_rotvec()),
        (("roll_rad", "pitch_rad", "yaw_rad"), TURNS.as_euler("xyz")),
        (MATRIX, TURNS.as_matrix().reshape(-1, 9)),
        (("roll_deg", "pitch_deg", "yaw_deg"), TURNS.as_euler("xyz", degrees=True)),
        (("yaw_deg", "pitch_deg", "roll_deg"), TURNS.as_euler("ZYX", degrees=True)),
        (name_angles("XYZ"), TURNS.as_euler("XYZ", degrees=True)),
        (name_angles("zyx"), TURNS.as_euler("zyx", degrees=True)),
        (name_angles("ZXZ"), TURNS[:2].as_euler("ZXZ", degrees=True)),
    ],
)
def test_every_form_is_the_same_turn(tmp_path, columns, values):
    found = read_rotation_vectors(write(tmp_path / "t.csv", columns, values))
    np.testing.assert_allclose(found, TURNS.as_rotvec()[: len(values)], atol=1e-10)


def test_there_are_twelve_sequences_about_fixed_axes_and_twelve_about_turning_ones():
    assert len(SEQUENCES) == 24


def test_a_rotation_that_was_not_measured_is_none(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("pose,roll_deg,pitch_deg,yaw_deg\na,1,2,3\nb,,,\n")
    found = read_rotation_vectors(read_table(path, None))
    assert np.isfinite(found[0]).all()
    assert np.isnan(found[1]).all()
    path.write_text("pose,x_mm\na,1\n")
    assert np.isnan(read_rotation_vectors(read_table(path, None))).all()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("rx_deg,qw\n1,1\n", "found 'rx_deg' and 'qw'"),
        ("qw,qx,qy\n1,0,0\n", "found column 'qw' without 'qz'"),
        ("qw,qx,qy,qz\n2,0,0,0\n", "line 2: found a quaternion of length 2, expected 1"),
        ("roll_deg,pitch_deg,yaw_deg\n1,2,\n", "line 2: found part of a rotation"),
        (
            f"{','.join(MATRIX)}\n1,0,0,0,1,0,0,0,-1\n",
            "line 2: found a matrix of determinant -1, expected 1: mirrored",
        ),
        (
            f"{','.join(MATRIX)}\n1,0,0,0,1.01,0,0,0,1\n",
            "line 2: found a matrix whose columns are off unit axes by 0.02",
        ),
        ("roll_rad,pitch_rad,yaw_rad\n0,0,0\n1,2,90\n", "line 3: yaw_rad: found 90, .* degrees in columns of radians?"),
        (
            "rx_rad\n90\n",
            "rx_rad: found 90, .* at most 3.14159 .* degrees in columns of radians?",
        ),
        ("rx_deg\n190\n", "rx_deg: found 190, expected a rotation vector of at most 180"),
    ],
)
def test_faults_are_said_in_a_line(tmp_path, text, said):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_rotation_vectors(read_table(tmp_path / "t.csv", None))
