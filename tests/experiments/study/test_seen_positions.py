"""Which channels are a position: by their names, of one target, whatever else is measured in mm."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayescal.density.prediction import Prediction
from bayescal.experiments.study.tables import find_seen, list_seen
from bayescal.machines.readings import Channel


@pytest.mark.parametrize(
    ("names", "seen"),
    [
        ("cam_x cam_y", {"x": "cam_x", "y": "cam_y"}),
        ("tracker[x] tracker[y] tracker[z]", {"x": "tracker[x]", "y": "tracker[y]", "z": "tracker[z]"}),
        ("x y z", {"x": "x", "y": "y", "z": "z"}),
        ("x[1] x[2] x[3] y[1] y[2] y[3]", {"x": "x[1]", "y": "y[1]"}),
        ("t1_x t2_x t3_x t1_z t1_y t2_y", {"x": "t1_x", "y": "t1_y", "z": "t1_z"}),
        ("x1 y1 x2 y2", {"x": "x1", "y": "y1"}),
        ("targetX targetY", {"x": "targetX", "y": "targetY"}),
        ("height probe_z", {"z": "probe_z"}),
        ("d e", {}),
        ("max index", {}),
        ("distance gap[1] gap[2]", {}),
    ],
)
def test_positions_are_told_by_their_names(names, seen):
    channels = [Channel("s", "mm"), *(Channel(name, "mm", external=True) for name in names.split())]
    found = find_seen(SimpleNamespace(channels=channels))[:3]
    assert {axis: channels[k].name for axis, k in zip("xyz", found, strict=True) if k is not None} == seen


def test_what_is_no_length_or_the_machine_s_own_is_no_position():
    channels = [Channel("x", "mm"), Channel("y", "us", external=True), Channel("z", "N", external=True)]
    assert find_seen(SimpleNamespace(channels=channels)) == [None] * 6


def test_every_target_of_most_axes_is_a_position():
    names = "p_x p_y p_z q_x q_y q_z r_x"
    channels = [Channel("s", "mm"), *(Channel(name, "mm", external=True) for name in names.split())]
    found = list_seen(SimpleNamespace(channels=channels))
    assert found == [[1, 2, 3, None, None, None], [4, 5, 6, None, None, None]]


def test_poses_that_one_target_did_not_show_are_those_of_another():
    parts = {name: np.full((3, 6), np.nan) for name in ("error", "low", "high")}
    first = Prediction(**parts, position_bound=np.ones(3), orientation_bound=np.ones(3))
    first.error[0] = 1.0
    filled = first.fill(replace(first, error=np.full((3, 6), 2.0)), np.array([False, True, False]))
    np.testing.assert_array_equal(filled.error[:, 0], [1.0, 2.0, np.nan])
    assert np.isnan(first.error[1]).all()
