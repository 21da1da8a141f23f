"""Accuracy counts where poses were measured, unless a workspace is stated."""

from __future__ import annotations

import numpy as np
import pytest
from function_machines import point_on_lines

from bayescal.experiments.shared.readings.workspace import build_workspace, find_region
from bayescal.experiments.shared.schema import UnitsConfig

UNITS = UnitsConfig(length="mm", angle="deg")


def find(given, pose):
    model = point_on_lines()
    workspace = build_workspace(model, given, UNITS)
    return workspace, find_region(workspace, given, model, pose)


def test_it_is_that_of_the_measured_poses(rng):
    pose = rng.uniform((10.0, -5.0), (30.0, 5.0), (400, 2))
    workspace, found = find({}, pose)
    assert workspace.low.tolist() == [-150.0, -150.0]
    np.testing.assert_allclose(found.low, (10.0, -5.0), atol=1.0)
    np.testing.assert_allclose(found.high, (30.0, 5.0), atol=1.0)
    assert found.n_poses == workspace.n_poses


def test_what_is_stated_holds(rng):
    pose = rng.uniform(-10.0, 10.0, (50, 2))
    assert find({"x": [-100.0, 100.0], "y": [-50.0, 50.0]}, pose)[1] is None
    found = find({"x": [-100.0, 100.0]}, pose)[1]
    assert (found.low[0], found.high[0]) == (-100.0, 100.0)
    assert -11.0 < found.low[1] < -9.0


@pytest.mark.parametrize("pose", [np.empty((0, 2)), np.full((3, 2), np.nan)])
def test_without_poses_it_is_the_machine_s(pose):
    assert find({}, pose)[1] is None


def test_one_wrong_row_of_many_does_not_widen_it(rng):
    pose = rng.uniform(-10.0, 10.0, (200, 2))
    pose[7] = 149.0
    assert find({}, pose)[1].high.max() < 12.0
