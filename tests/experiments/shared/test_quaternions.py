"""Rotations as unit quaternions, in every table that has rotations: of any sign, and of length one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bayescal.calibrated.tables import list_columns, read_quantities
from bayescal.data.instruments.read_points import read_stations
from bayescal.errors import InputError
from bayescal.experiments.shared.readings.data_schema import ReadingsDataConfig
from bayescal.experiments.shared.readings.reading_tables import read_tables
from bayescal.files.csv_tables import read_table
from bayescal.machines.readings import Channel
from bayescal.machines.readings.base import POSE_CHANNELS

VECTORS = np.array([[0.1, -0.2, 0.3], [0.0, 0.0, 0.0], [2.0, 1.0, -1.5]])
CAMERA = [Channel(f"cam_r[{axis}]", "rad", external=True, rotation="cam_r") for axis in "xyz"]
PLATFORM = list(POSE_CHANNELS[3:])


def write(path, prefix="", scale=1.0, key="pose", more="", cells=""):
    quaternions = scale * Rotation.from_rotvec(VECTORS).as_quat(scalar_first=True)
    quaternions[1] *= -1.0  # the same turn
    names = ",".join(f"{prefix}{name}" for name in ("qw", "qx", "qy", "qz"))
    rows = [f"P{k},{cells}{','.join(map(str, row))}" for k, row in enumerate(quaternions)]
    path.write_text("\n".join([f"{key},{more}{names}", *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("channels", "prefix"), [(PLATFORM, ""), (CAMERA, "cam_"), ([Channel("s", "mm"), *CAMERA], "cam_")]
)
def test_readings(tmp_path, channels, prefix):
    write(tmp_path / "r.csv", prefix)
    read = read_tables([ReadingsDataConfig(file="r.csv")], tmp_path, channels, ())
    np.testing.assert_allclose(read.values[:, -3:], VECTORS, atol=1e-12)
    with pytest.raises(InputError, match=r"length 0\.5"):
        read_tables([ReadingsDataConfig(file=write(tmp_path / "s.csv", prefix, 0.5).name)], tmp_path, channels, ())
    write(tmp_path / "r.csv", "cam_", more="cam_r_x_deg,", cells="1.0,")
    with pytest.raises(InputError, match="rotation form"):
        read_tables([ReadingsDataConfig(file="r.csv")], tmp_path, CAMERA, ())


def test_stations(tmp_path):
    write(tmp_path / "s.csv", key="station", more="x_mm,y_mm,z_mm,", cells="1,2,3,")
    found = read_stations(tmp_path / "s.csv")
    np.testing.assert_allclose(found.rotation, Rotation.from_rotvec(VECTORS).as_matrix(), atol=1e-12)
    with pytest.raises(InputError, match=r"length 0\.5"):
        read_stations(write(tmp_path / "t.csv", scale=0.5, key="station", more="x_mm,y_mm,z_mm,", cells="1,2,3,"))


@pytest.mark.parametrize("prefix", ["", "tool_"])
def test_poses_that_are_commanded(tmp_path, prefix):
    table = read_table(write(tmp_path / "p.csv", prefix), None)
    assert {f"{prefix}qw", f"{prefix}rx_deg"} <= set(list_columns(PLATFORM, prefix))
    np.testing.assert_allclose(read_quantities(table, PLATFORM, prefix), VECTORS, atol=1e-12)
    with pytest.raises(InputError, match=r"length 0\.5"):
        read_quantities(read_table(write(tmp_path / "q.csv", prefix, 0.5), None), PLATFORM, prefix)
    with pytest.raises(InputError, match="rotation"):
        read_quantities(read_table(write(tmp_path / "n.csv", "other_"), None), PLATFORM, prefix)
