"""Vectors in space are labelled by their axes; only what every member has one of is counted by members."""

from __future__ import annotations

import re
from pkgutil import resolve_name

import pytest
from serial_arms import PANDA, build_arm

from bayescal.experiments.audit.page.wording import list_names
from bayescal.machines.readings import INSTRUMENTS, FunctionModel, place
from bayescal.report.symbols import name_parameter

N_JOINTS = 7
VECTORS = ("frame_mm", "frame_deg", "anchor_mm", "place_mm", "target_mm", "target_deg")
EVERYTHING = {key: [1.0, 2.0, 3.0] for key in VECTORS} | {"tilt_deg": [0.0, 0.0], "offset_mm": 0.0, "mounted": "base"}


@pytest.mark.parametrize("kind", INSTRUMENTS)
def test_only_joints_are_counted(kind):
    instrument = resolve_name(INSTRUMENTS[kind])
    stated = {key: value for key, value in EVERYTHING.items() if key in instrument.Config.model_fields}
    machine = place(
        FunctionModel("arm", build_arm(PANDA.read_text(), tip="ball_link")),
        {"i": instrument(instrument.Config(**stated))},
    )
    counted = [block for block in machine.layout.blocks if re.search(r"\[\d+\]$", block.names[0])]
    assert {len(block.nominal) for block in counted} == {N_JOINTS}
    vectors = [block for block in machine.layout.blocks if len(block.nominal) in (2, 3)]
    assert len(vectors) >= 3
    for block in vectors:
        assert not any(machine.member in name_parameter(name, machine.member) for name in block.names)
        assert machine.member not in list_names(block.names, machine.member)
    assert machine.layout.block("tool").names == ("tool[x]", "tool[y]", "tool[z]")
    assert name_parameter("offset[2]", machine.member) == "offset of joint 2"


@pytest.mark.parametrize(
    ("normal", "axes"), [([0, 0, 1], "xy"), ([0, 1, 0], "xz"), ([-1, 0, 0], "yz"), ([1, 1, 1], "xy"), ([3, 1, 2], "yz")]
)
def test_a_plane_tilts_about_axes_across_it(normal, axes):
    plane = resolve_name(INSTRUMENTS["plane"])
    assert plane(plane.Config(normal=normal)).parameters[0].axes == axes
