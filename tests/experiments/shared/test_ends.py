"""Readings that there cannot be: limits of joints, travel, horizon; files of other programs through every reader."""

from __future__ import annotations

import json

import numpy as np
import pytest
from refusals import line_of
from serial_arms import write_small

import bayescal as bc
from bayescal.data.actuators import check_travel
from bayescal.data.instruments.read_poses import PoseNoise, read_poses
from bayescal.experiments.shared.readings.data_schema import ReadingsDataConfig
from bayescal.experiments.shared.readings.reading_tables import read_tables
from bayescal.machines.readings.mount import Mount, MountConfig

JOINTS = "pose,joint_1_rad,joint_2_mm,joint_3_rad\n"


def read(folder, channels, text, name="r.csv"):
    (folder / name).write_text(text)
    return read_tables([ReadingsDataConfig(file=name)], folder, channels, ())


def test_joints_keep_to_their_limits_but_for_a_margin(tmp_path):
    channels = bc.load_machine(write_small(tmp_path)).channels
    assert [one.ends for one in channels] == [(-1.2, 2.0), (-100.0, 350.0), (-np.inf, np.inf)]
    read(tmp_path, channels, JOINTS + "A,2.07,-110,99\n")
    for row, said in (
        ("2.1,0,0", "line 3: joint_1_rad: found 2.1, expected -1.2 to 2, all that joint[1] can read"),
        ("0,-112,0", "line 3: joint_2_mm: found -112, expected -100 to 350, all that joint[2] can read"),
    ):
        assert line_of(read, tmp_path, channels, f"{JOINTS}A,0,0,0\nB,{row}\n").endswith(said)
    said = line_of(read, tmp_path, channels, JOINTS + "A,90,0,0\nB,-60,0,0\n")
    assert said.endswith("joint_1_rad: found 90, expected -1.2 to 2, all that joint[1] can read; degrees?")


def test_positions_beyond_a_range_are_named_as_their_table_has_them(tmp_path):
    channels, path = bc.load_machine(write_small(tmp_path)).channels, tmp_path / "c.csv"
    path.write_text("pose,joint_1_deg,joint_2_m,joint_3_rad\nA,90,0,0\nB,126,0,0\n")
    limits, commands = np.tile([-np.inf, np.inf], (3, 1)), np.array([[1.5, 0.0, 0.0], [np.radians(126.0), 0.0, 0.0]])
    said = line_of(check_travel, commands, limits, channels, "AB", path)
    assert said.startswith(f"{path}, line 3: pose 'B', joint_1_deg: found 126 deg")


def test_rows_of_joints_have_limits_where_somebody_states_them(tmp_path):
    (tmp_path / "m.toml").write_text(
        "kind = 'arm'\nname = 'a'\ntitle = 'a'\n[machine]\njoints = [{ d_mm = 100.0, range_deg = [-90.0, 90.0] }, "
        "{ a_mm = 300.0 }]\n"
    )
    ends = [one.ends for one in bc.load_machine(tmp_path / "m.toml").channels]
    np.testing.assert_allclose(ends, [(-np.pi / 2, np.pi / 2), (-np.inf, np.inf)])


def test_stars_stand_above_the_horizon(tmp_path):
    text = "pose,azimuth_deg,elevation_deg,encoder_1_deg,encoder_2_deg\nS,10,-0.1,10,-0.1\n"
    said = line_of(read, tmp_path, Mount(MountConfig()).channels, text)
    assert said.endswith("line 2: elevation_deg: found -0.1, expected 0 to 90, all that elevation can read")


@pytest.mark.parametrize("form", ["semicolons", "json"])
def test_a_recording_of_poses_is_read_as_poses(tmp_path, form):
    values = {"x": 0.5, "y": -0.25, "z": 1.0, "qx": 0.0, "qy": 0.6, "qz": 0.0, "qw": 0.8}
    if form == "json":
        (tmp_path / "t.jsonl").write_text(json.dumps({"q": [0.1, 0.2], "t": values}) + "\n")
        columns = ", ".join(f'"t_{one}" = "{one}{"_m" if one in "xyz" else ""}"' for one in values)
        columns, keys = f'"q_{{1}}" = "joint_{{1}}_rad", {columns}', "table = 't.jsonl'\n"
    else:
        row = ";".join(str(one).replace(".", ",") for one in (0.1, 0.2, *values.values()))
        (tmp_path / "t.csv").write_text(f"q1;q2;{';'.join(values)}\n{row}\n")
        columns = '"q{1}" = "joint_{1}_rad", x = "x_m", y = "y_m", z = "z_m"'
        keys = "table = 't.csv'\nseparator = ';'\ndecimal = ','\n"
    (tmp_path / "t.toml").write_text(f"{keys}columns = {{ {columns} }}\npose = 'A{{7}}'\n")
    joints = {"joint_1_rad": 1.0, "joint_2_rad": 1.0}
    tracked, taken = read_poses(tmp_path / "t.toml", None, PoseNoise(1.0, 1.0), joints)
    np.testing.assert_allclose(tracked.values, [[500.0, -250.0, 1000.0, 0.0, 2.0 * np.arcsin(0.6), 0.0]])
    np.testing.assert_array_equal(taken.actuators, [[0.1, 0.2]])
    assert (taken.names, taken.verification.any()) == (("A7",), False)
