"""Which channels are a position: by their names, of one target, whatever else is measured in mm."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from bayescal.experiments.study.tables import find_seen
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
