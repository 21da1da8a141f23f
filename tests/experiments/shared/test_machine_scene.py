"""Drawings of machines: joints as far apart as legs are long, and the pages that show them."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import tiny_experiments
from html_reader import Reader

from bayescal.experiments.shared.joints import HOME, tabulate_joints
from bayescal.experiments.shared.machine_scene import build_scene, read_joint_columns
from bayescal.machines.read import load_mechanism

SHIPPED = tiny_experiments.SHIPPED
MACHINES = ("telescope/mechanism", "hexaglide/mechanism", "audit/m2_hexapod_mechanism", "audit/yu2023_mechanism")


@pytest.mark.parametrize("name", MACHINES)
def test_joints_are_as_far_apart_as_the_legs_are_long(name):
    mechanism = load_mechanism(SHIPPED / f"{name}.toml")
    start = mechanism.initial_actuator_positions
    moved = start + 0.1 * mechanism.actuator_range * np.linspace(-1.0, 1.0, mechanism.n_legs)
    joints = tabulate_joints(mechanism, moved[None], ["moved"])
    assert list(dict.fromkeys(joints["pose"])) == [HOME, "moved"]
    for pose, actuators in ((HOME, start), ("moved", moved)):
        base, platform = (
            joints[(joints["pose"] == pose) & (joints["joint"] == joint)][["x_mm", "y_mm", "z_mm"]].to_numpy()
            for joint in ("base", "platform")
        )
        lengths = mechanism.leg_lengths + (actuators - start if mechanism.drive == "strut" else 0.0)
        np.testing.assert_allclose(np.linalg.norm(platform - base, axis=1), lengths, atol=0.003)
        if mechanism.drive == "base":
            travelled = np.sum((base - mechanism.base_points) * mechanism.directions, axis=1)
            np.testing.assert_allclose(travelled, actuators, atol=0.003)


def test_offsets_stand_at_their_joints():
    mechanism = load_mechanism(SHIPPED / "audit/yu2023_mechanism.toml")
    joints = tabulate_joints(mechanism, np.empty((0, 6)), [])
    scene = build_scene(joints, {("platform", 2): (0.0, 0.1, 0.0)})
    assert scene is not None
    found = {point.name: point.offset for point in scene.points if any(point.offset)}
    assert found == {"b of leg 2": (0.0, 0.1, 0.0)}
    assert scene.magnified > 100
    assert build_scene(joints.iloc[:0]) is None


def test_coordinates_that_are_no_parameters_count_as_zero():
    rows = pd.DataFrame({"symbol": ["a_x", "b_z", "l"], "leg": [1, 1, 1], "sd": [0.1, 0.2, 9.0]})
    assert read_joint_columns(rows, "sd") == {("base", 1): (0.1, 0.0, 0.0), ("platform", 1): (0.0, 0.0, 0.2)}


@pytest.mark.parametrize(
    "name",
    [
        *("hexaglide/mechanism", "hangprinter/machine", "sliding_star/machine", "mmt_mount/machine"),
        *("flsun_v400/machine", *(f"../examples/machines/{one}" for one in ("five_bar", "rotary_delta", "scara"))),
    ],
)
def test_a_machine_is_shown(name, tmp_path, call):
    out = tmp_path / "new" / "machine.html"
    assert call("show", str(SHIPPED / f"{name}.toml"), "--out", str(out))[0] == 0
    text = out.read_text(encoding="utf-8")
    assert Reader(text).open == []
    assert len(re.findall("data-scene=", text)) == 1
    assert "nan" not in re.findall(r'data-scene="([^"]*)"', text)[0]


@pytest.mark.parametrize(("name", "word"), [("telescope/study", "kind"), ("telescope/nothing", "no such file")])
def test_what_cannot_be_shown_is_refused(tmp_path, call, name, word):
    out = tmp_path / "machine.html"
    code, _, error = call("show", SHIPPED / f"{name}.toml", "--out", out)
    assert code == 2
    assert word in error
    assert not out.exists()
