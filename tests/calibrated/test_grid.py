"""A grid of corrections, read as a table: asked for tool and correction a nominal controller brings the tool there."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import test_every_machine as machines
from refusals import line_of
from scipy.spatial.transform import Rotation
from test_arm_formats import UR10, make_calibrated

from bayescal.calibrated.carried import describe_carried
from bayescal.calibrated.formats import export_machine
from bayescal.calibrated.predict import predict_poses

NANOMETRE = 1e-6  # mm


def read_grid(found, folder):
    """Return a machine's table and what the file says that it carries."""
    written = export_machine(found, folder / "out", "grid")
    return pd.read_csv(folder / "out" / "grid.csv", comment="#"), describe_carried(written)


def take(table, start, ends):
    """Return columns (P, n) that begin and end in some way."""
    return table[[f"{start}{end}" for end in ends]].to_numpy()


@pytest.mark.parametrize("name", ["hangprinter", "delta"])
def test_a_nominal_controller_with_the_grid_comes_to_the_tool(name, tmp_path):
    found = machines.build(name, tmp_path)
    model, ends = found.model, ("x_mm", "y_mm", "z_mm")
    table, said = read_grid(found, tmp_path)
    tool = take(table, "", ends)
    commands = model.read(model.layout.nominal, tool + take(table, "correction_", ends))[:, found.commanded]
    prediction = predict_poses(found, commands)
    np.testing.assert_allclose(prediction.tool, tool, rtol=0.0, atol=NANOMETRE)
    without = model.read(model.layout.nominal, tool)[:, found.commanded]
    assert np.abs(predict_poses(found, without).tool - tool).max() > 100.0 * NANOMETRE
    # simulated machines go elsewhere by the same commands, as far as is said
    some = slice(None, None, len(table) // 8)
    drawn = model.locate(found.thin(600)[:, None], commands[some], weights=found.weights)[0]
    spread = np.std(drawn, axis=0) * 1e3
    np.testing.assert_allclose(take(table[some], "sd_", ("x_um", "y_um", "z_um")) / spread, 1.0, atol=0.12)
    carried, of = re.match(r"Interpolated linearly the file carries (\S+) of (\S+) mm", said[0]).groups()
    assert 0.9 * float(of) < float(carried) <= float(of)


def test_an_arms_grid_has_rotations(tmp_path, rng):
    found = make_calibrated(UR10, rng, size=0.1)
    table, said = read_grid(found, tmp_path)
    drawn = found.model.layout.nominal
    q, position = take(table, "q", [f"{k}_rad" for k in range(1, 7)]), ("x_mm", "y_mm", "z_mm")
    vector = ("rx_deg", "ry_deg", "rz_deg")
    nominal = found.model.tool_values(drawn, q)
    np.testing.assert_allclose(take(table, "tool_", position), nominal[:, :3], atol=1e-9)
    # joints that have the nominal tool at tool and correction, from the corrections' own slopes
    for row in range(0, len(table), 97):
        turned = Rotation.from_rotvec(take(table, "correction_", vector)[row], degrees=True)
        goal = turned * Rotation.from_rotvec(nominal[row, 3:])
        place = nominal[row, :3] + take(table, "correction_", position)[row]
        here = q[row]
        for _ in range(20):
            tool, slopes, _ = found.model.tool(drawn, here)
            error = np.concatenate([place - tool[:3], goal.as_rotvec() - tool[3:]])
            here = here + np.linalg.lstsq(slopes, error, rcond=1e-9)[0]
        if np.abs(error).max() < 1e-9:  # not where the arm is stretched
            reached = found.model.tool_values(found.theta, here)
            np.testing.assert_allclose(reached[:3], nominal[row, :3], atol=NANOMETRE)
    assert "sd_x_um" not in table
    assert "the file carries 0 of" in said[0]  # every cell has an end where the elbow is straight


def test_a_drawing_that_is_no_longer_known_is_said(tmp_path):
    found = machines.build("struts without load", tmp_path)
    table, said = read_grid(found, tmp_path)
    assert len(table) == 3**6
    assert "Interpolated linearly the file carries" in said[0]
    settled = replace(found, drawn=None)
    assert "expected results of a study" in line_of(lambda: export_machine(settled, tmp_path / "again", "grid"))


def test_a_workspace_out_of_reach_is_said(tmp_path):
    found = machines.build("delta", tmp_path)
    far = replace(found, workspace=found.workspace + 1000.0)
    assert "found no pose of the workspace within reach" in line_of(lambda: export_machine(far, tmp_path / "o", "grid"))
