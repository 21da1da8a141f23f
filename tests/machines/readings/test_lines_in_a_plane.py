"""Lines to a point that keeps to a plane: their lengths, motors that locate it, what a plane cannot have."""

from __future__ import annotations

import machine_registry
import numpy as np
import pytest

from bayescal.experiments.shared.show import describe_machine
from bayescal.files.toml import format_toml
from bayescal.machines.readings.line_machine import LineMachine, LineMachineConfig

SLED = machine_registry.SLED


def test_motors_unwind_what_the_lines_grow(rng):
    model = machine_registry.MACHINES["lines in a plane"]()
    theta, _, _ = machine_registry.draw(model, rng, 1)
    place = np.array([[300.0, -200.0], [-800.0, 450.0]])
    named = dict(zip(model.layout.names, theta[0], strict=True))
    anchors = np.array([[named[f"A_{axis}[{k}]"] for axis in "xy"] for k in (1, 2)])
    lengths, before = (np.hypot(np.linalg.norm(at - anchors, axis=-1), 12.0) for at in (place[:, None], np.zeros(2)))
    read = model.read(theta[0], place)
    radius = np.array([named["R[1]"], named["R[2]"]])
    wound = np.sqrt(radius**2 - named["Q"] * (lengths - before))  # the radius where line has left
    # turns of layers: between two radii line leaves at their mean
    np.testing.assert_allclose(read[:, :2] / SLED["gear"] * 0.5 * (radius + wound), lengths - before, rtol=1e-12)
    np.testing.assert_allclose(read[:, -2:], lengths)
    turned = place + named["omega"] * np.stack([-place[:, 1], place[:, 0]], axis=-1)
    seen = np.array([named["o_x"], named["o_y"]]) + (1.0 + named["s"]) * turned
    np.testing.assert_allclose(read[:, 2:4], seen)


def test_two_motors_locate_the_point(rng):
    model = machine_registry.MACHINES["lines in a plane"]()
    theta, place, _ = machine_registry.draw(model, rng)
    found, good = model.locate(theta[0], model.read(theta[0], place)[:, :2])
    assert good.all()
    np.testing.assert_allclose(found, place, atol=1e-6)


def test_weight_in_a_plane_is_refused():
    with pytest.raises(ValueError, match="tension: found 'hanging' in a plane, expected 'none' or 'measured'"):
        LineMachine(LineMachineConfig(**SLED, tension="hanging"))


def test_a_plane_is_drawn(tmp_path):
    lines = SLED["lines"]
    content = {"kind": "line_machine", "name": "sled", "title": "A router on chains", "machine": SLED}
    (tmp_path / "machine.toml").write_text(format_toml([], content))
    scene = describe_machine(tmp_path / "machine.toml").sections[0].blocks[0]
    assert [point.at[0] for point in scene.points[:2]] == [tuple(one["anchor_mm"]) for one in lines]
    assert len(scene.poses) == 5
