"""Messages about values name the column and the value that the user wrote, whatever unit or name these have inside."""

from __future__ import annotations

import json

import pandas as pd
import pytest
from refusals import line_of

import bayescal as bc
from bayescal.data.instruments.read_points import PointNoise, read_points
from bayescal.data.instruments.read_poses import PoseNoise, read_poses
from bayescal.experiments.shared.readings.data_schema import ReadingsDataConfig
from bayescal.experiments.shared.readings.reading_tables import read_tables
from bayescal.files.csv_tables import read_table

NOISE = PointNoise(range_um=1.0, azimuth_arcsec=1.0, elevation_arcsec=1.0)


def read_seen(folder, name="seen.csv"):
    (folder / "probe.csv").write_text("point,x_mm,y_mm,z_mm\nA,0,0,0\n")
    (folder / "actuators.csv").write_text("pose,use\nP1,calibration\n")
    return read_points(folder / name, folder / "probe.csv", None, folder / "actuators.csv", NOISE, {})


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        ("range_m,azimuth_rad,elevation_rad", "1.5,20.74,0", "azimuth_rad: found 20.74, expected at most 6.28319"),
        ("range_m,azimuth_rad,elevation_rad", "1.5,0,2", "elevation_rad: found 2, expected at most 1.5708"),
        ("range_m,azimuth_rad,elevation_deg", "-1.5,0,2", "range_m: found -1.5, expected above 0"),
        ("range_m,azimuth_rad,elevation_deg", "1.5,,2", "azimuth_rad: found '', expected a number"),
        ("range_m,azimuth_rad,elevation_deg", "1e7,0,2", "range_m: found 1e7, expected at most 1e+06"),
    ],
)
def test_points(tmp_path, header, row, said):
    (tmp_path / "seen.csv").write_text(f"pose,point,{header}\nP1,A,{row}\n")
    assert f"seen.csv, line 2: {said}" in line_of(read_seen, tmp_path)


POSES = "pose,x_m,rx_rad,sd_x_mm,sd_rx_mrad\nA,0.1,{},{},{}\n"


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        ((20.74, 1, 1), "rx_rad: found 20.74, expected a rotation vector of at most 3.14159"),
        ((0, -0.25, 1), "sd_x_mm: found -0.25, expected above 0"),
        ((0, "", 1), "x_m: found no sd_x_mm, expected its noise"),
        ((0, "many", 1), "sd_x_mm: found 'many', expected a number"),
    ],
)
def test_poses(tmp_path, cells, said):
    (tmp_path / "poses.csv").write_text(POSES.format(*cells).replace("sd_rx_mrad", "sd_rx_urad"))
    noise = PoseNoise()
    assert f"poses.csv, line 2: {said}" in line_of(read_poses, tmp_path / "poses.csv", None, noise, {})


@pytest.mark.parametrize("form", ["csv", "jsonl", "parquet"])
def test_columns_renamed_by_a_toml_file(tmp_path, form):
    cells, table = {"name": "P1", "target": "A", "hz": 20.74, "v": 0.5, "d": 1.5}, tmp_path / f"t.{form}"
    if form == "parquet":
        pytest.importorskip("pyarrow")
        pd.DataFrame([cells]).to_parquet(table)
    else:
        written = f"{','.join(cells)}\n{','.join(map(str, cells.values()))}\n"
        table.write_text(json.dumps(cells) if form == "jsonl" else written)
    names = "name = 'pose', target = 'point', hz = 'azimuth_rad', v = 'elevation_rad', d = 'range_m'"
    (tmp_path / "seen.toml").write_text(f"table = '{table.name}'\ncolumns = {{ {names} }}\n")
    said = line_of(read_seen, tmp_path, "seen.toml")
    assert f"t.{form}, line {1 if form == 'jsonl' else 2}: hz: found 20.74, expected at most 6.28319" in said
    (tmp_path / "seen.toml").write_text(f"table = '{table.name}'\ncolumns = {{ {names.replace('_rad', '_arcsec')} }}\n")
    assert read_seen(tmp_path, "seen.toml")[1].names == ("P1",)


def test_readings_beyond_the_ends_of_a_channel(tmp_path):
    channels = [bc.Channel("q[1]", "rad", ends=(-1.0, 1.0)), bc.Channel("q[2]", "rad")]
    (tmp_path / "t.csv").write_text("row;first;second;spread\nA;90;0;-1\n")
    names = "row = 'pose', first = 'q_1_deg', second = 'q_2_deg', spread = 'q_2_sd_deg'"
    (tmp_path / "t.toml").write_text(f"table = 't.csv'\nseparator = ';'\ncolumns = {{ {names} }}\n")
    read = ([ReadingsDataConfig(file="t.toml")], tmp_path, channels, ())
    assert "t.csv, line 2: first: found 90, expected -57.2958 to 57.2958" in line_of(read_tables, *read)
    (tmp_path / "t.csv").write_text("row;first;second;spread\nA;9;0;-1\n")
    assert "t.csv, line 2: spread: found -1, expected no negative noise" in line_of(read_tables, *read)


def test_a_conversion_that_is_stated_twice_is_one(tmp_path):
    (tmp_path / "t.csv").write_text("pose,x_m\nA,0.25\n")
    table = read_table(tmp_path / "t.csv", ("pose", "x_mm"))
    assert table.convert(("x_mm",)).numbers(["x_mm"])[0, 0] == 250.0
    assert table.convert(("x_um",)).numbers(["x_um"])[0, 0] == 250e3
    assert table.convert(("x_um",)).show("x_um", 250e3) == "0.25"
