"""Files for other tools, read by small readers of their own and held against the machine's kinematics."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import calibrated_machines as calibrated
import hexapods
import numpy as np
import pandas as pd
import pytest
import studies
import telescope_machines as machines
from refusals import line_of
from scipy.spatial.transform import Rotation

from bayescal.calibrated.formats import export_machine
from bayescal.calibrated.machine import Source, build_calibrated
from bayescal.calibrated.predict import predict_poses
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import build_machine
from bayescal.machines.models.six_ups import SixUps
from bayescal.machines.readings import Legs

NANOMETRE = 1e-6  # mm
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


@pytest.fixture
def hexapod(rng):
    """Return the M2 hexapod, calibrated by made-up draws."""
    return calibrated.build_made_up(build_machine(SixUps, hexapods.load_hexapod("m2"), NoDeformation()), rng, 50)


def strut_lengths(found, actuators: np.ndarray) -> np.ndarray:
    mechanism = found.legs.mechanism
    return mechanism.leg_lengths + actuators - mechanism.initial_actuator_positions


# --- genhexkins ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def genhex(tmp_path_factory) -> Path:
    """Return the compiled program of genhexkins' conventions."""
    if COMPILER is None:
        pytest.skip("no C compiler")
    program = tmp_path_factory.mktemp("c") / "genhex"
    command = [COMPILER, "-O1", "-o", program, Path(__file__).parent / "genhex.c", "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    return program


def ask(program: Path, hal: Path, what: str, rows: np.ndarray) -> np.ndarray:
    lines = "\n".join(f"{what} " + " ".join(repr(float(x)) for x in row) for row in rows)
    answer = subprocess.run([program, hal], input=lines, text=True, capture_output=True, check=True)
    return np.array([line.split() for line in answer.stdout.splitlines()], dtype=float)


def test_genhexkins_takes_the_same_poses(genhex, hexapod, rng, tmp_path):
    """Position to 1 nm and orientation to 1 nm at the joints, 1.7 m off; and strut lengths of given poses."""
    export_machine(hexapod, tmp_path, "genhexkins")
    actuators = calibrated.measurable_actuators(hexapod.legs, 30, rng)
    expected = predict_poses(hexapod, actuators)
    angles = Rotation.from_matrix(expected.rotation).as_euler("xyz", degrees=True)  # about fixed axes: R_z R_y R_x
    lengths = ask(genhex, tmp_path / "genhexkins.hal", "inverse", np.hstack([expected.position, angles]))
    np.testing.assert_allclose(lengths, strut_lengths(hexapod, actuators), rtol=0, atol=NANOMETRE)
    home = predict_poses(hexapod, hexapod.legs.mechanism.initial_actuator_positions[None]).position
    start = np.tile(np.hstack([home[0], np.zeros(3)]), (30, 1))
    poses = ask(genhex, tmp_path / "genhexkins.hal", "forward", np.hstack([strut_lengths(hexapod, actuators), start]))
    np.testing.assert_allclose(poses[:, :3], expected.position, rtol=0, atol=NANOMETRE)
    rotation = Rotation.from_euler("xyz", poses[:, 3:], degrees=True).as_matrix()
    points = hexapod.legs.mechanism.platform_points
    np.testing.assert_allclose(rotation @ points.T, expected.rotation @ points.T, rtol=0, atol=NANOMETRE)
    before = build_machine(SixUps, hexapods.load_hexapod("m2"), NoDeformation()).mechanism
    assert np.abs(before.leg_lengths - hexapod.legs.mechanism.leg_lengths).max() > 0.01  # as calibrated, not nominal


@pytest.mark.parametrize("name", ["genhexkins", "linuxcnc"])
def test_hal_file_has_nothing_but_comments_and_pins(hexapod, tmp_path, name):
    export_machine(hexapod, tmp_path, name)
    lines = (tmp_path / "genhexkins.hal").read_text().splitlines()
    pins = [line.split() for line in lines if not line.startswith("#")]
    assert all(len(pin) == 3 and pin[0] == "setp" and pin[1].startswith("genhexkins.") for pin in pins)
    assert len({pin[1] for pin in pins}) == len(pins) == 38
    first = next(line for line in lines if line.startswith("# joint 0: "))
    assert repr(float(hexapod.legs.mechanism.leg_lengths[0])) in first


# --- URDF ------------------------------------------------------------------------------------------------------------


class Tree:
    """A URDF's joints; places of links for values of the joints."""

    def __init__(self, path: Path) -> None:
        self.root = ElementTree.parse(path).getroot()
        self.links = [one.get("name") for one in self.root.iter("link")]
        self.joints = {joint.find("child").get("link"): joint for joint in self.root.findall("joint")}

    def place(self, link: str, values: dict[str, float]) -> np.ndarray:
        if link == "base":
            return np.eye(4)
        joint = self.joints[link]
        return self.place(joint.find("parent").get("link"), values) @ self.step(
            joint, values.get(joint.get("name"), 0.0)
        )

    def step(self, joint, value: float) -> np.ndarray:
        fixed, moved = np.eye(4), np.eye(4)
        origin = joint.find("origin")
        fixed[:3, 3] = [float(x) for x in origin.get("xyz").split()]
        fixed[:3, :3] = Rotation.from_euler("xyz", [float(x) for x in origin.get("rpy").split()]).as_matrix()
        if joint.get("type") != "fixed":
            axis = np.array([float(x) for x in joint.find("axis").get("xyz").split()])
            if joint.get("type") == "prismatic":
                moved[:3, 3] = value * axis
            else:
                moved[:3, :3] = Rotation.from_rotvec(value * axis).as_matrix()
        return fixed @ moved

    def loops(self) -> list[tuple[str, str]]:
        return [(one.find("link1").get("link"), one.find("link2").get("link")) for one in self.root.iter("loop_joint")]


def assert_closed(tree: Tree, values: dict[str, float]) -> None:
    for end, mark in tree.loops():
        np.testing.assert_allclose(tree.place(end, values), tree.place(mark, values), atol=1e-12)


def aim(tree: Tree, leg: int, values: dict[str, float], position, rotation, found) -> None:
    """Set the angles of a leg such that its joints lead to a pose, mm; the actuator stands already."""
    name = f"leg_{leg}"
    foot = tree.joints[f"{name}_base_universal_1_link"]
    start = tree.place(foot.find("parent").get("link"), values) @ tree.step(foot, 0.0)
    point = 1e-3 * (position + rotation @ found.legs.mechanism.platform_points[leg - 1])
    x, y, z = start[:3, :3].T @ (point - start[:3, 3])
    values[f"{name}_base_universal_1"] = np.arctan2(-y, z)
    values[f"{name}_base_universal_2"] = np.arctan2(x, np.hypot(y, z))
    end = tree.place(f"{name}_turn_link", values)
    last = tree.joints["platform"] if leg == 1 else tree.joints[f"{name}_platform_mark"]
    inner = tree.step(last, 0.0)[:3, :3]
    rest = end[:3, :3].T @ rotation @ (inner.T if leg == 1 else inner)
    turns = Rotation.from_matrix(rest).as_euler("ZXY")
    for joint, angle in zip(("turn", "platform_universal_1", "platform_universal_2"), turns, strict=True):
        values[f"{name}_{joint}"] = angle


@pytest.mark.parametrize("model", machines.PERFECT_JOINTS)
def test_urdf_closes_at_home_and_at_other_poses(model, rng, tmp_path):
    found = calibrated.build_made_up(machines.build_machine("none", model=model), rng, 50)
    export_machine(found, tmp_path, "urdf")
    tree = Tree(tmp_path / "machine.urdf")
    assert len(tree.loops()) == 5
    assert len(set(tree.links)) == len(tree.links) == len(tree.joints) + 1
    mechanism = found.legs.mechanism
    actuators = np.vstack([mechanism.initial_actuator_positions, calibrated.measurable_actuators(found.legs, 3, rng)])
    prediction = predict_poses(found, actuators)
    for rho, position, rotation in zip(actuators, prediction.position, prediction.rotation, strict=True):
        moved = 1e-3 * (rho - mechanism.initial_actuator_positions)
        values = {f"leg_{leg + 1}_actuator": value for leg, value in enumerate(moved)}
        if moved.any():
            for leg in range(1, 7):
                aim(tree, leg, values, position, rotation, found)
        platform = tree.place("platform", values)
        np.testing.assert_allclose(1e3 * platform[:3, 3], position, rtol=0, atol=1e-9)
        np.testing.assert_allclose(platform[:3, :3], rotation, rtol=0, atol=1e-12)
        assert_closed(tree, values)


# --- tables and refusals ---------------------------------------------------------------------------------------------


def test_json_and_csv_hold_the_same_numbers(hexapod, tmp_path):
    export_machine(hexapod, tmp_path, "json")
    export_machine(hexapod, tmp_path, "csv")
    content = json.loads((tmp_path / "machine.json").read_text())
    legs = pd.read_csv(tmp_path / "legs.csv", comment="#")
    mechanism = hexapod.legs.mechanism
    assert content["base_points_mm"] == mechanism.base_points.tolist()
    assert content["source"]["converged"]
    np.testing.assert_array_equal(content["covariance"], hexapod.covariance)
    np.testing.assert_allclose(legs[["b_x_mm", "b_y_mm", "b_z_mm"]], mechanism.platform_points, rtol=1e-15)
    np.testing.assert_allclose(legs["l_mm"], content["parameters"]["l"]["mean"], rtol=1e-15)
    covariance = pd.read_csv(tmp_path / "covariance.csv", comment="#", index_col=0)
    np.testing.assert_allclose(covariance, hexapod.covariance, rtol=1e-15)
    assert tuple(covariance.columns) == hexapod.names


@pytest.mark.parametrize(
    ("name", "model", "deformation", "n_legs", "expected"),
    [
        ("genhexkins", "six_pus", "none", 6, "found base actuators"),
        ("genhexkins", "six_ups", "linear", 6, "found a flexible platform"),
        ("genhexkins", "six_ups", "none", 7, "found 7 struts, expected 6"),
        ("urdf", "beam", "none", 6, "found model 'beam'"),
        ("urdf", "six_pus", "matrix", 6, "found a flexible platform"),
        ("mechanism", "jacobian", "none", 7, "found model 'jacobian' of 7 legs"),
        ("step", "six_pus", "none", 6, "--format: found 'step', expected one of"),
    ],
)
def test_formats_that_cannot_have_a_machine(name, model, deformation, n_legs, expected, rng, tmp_path):
    machine = machines.build_machine(deformation, machines.build_random_mechanism(n_legs, seed=n_legs), model)
    theta = machine.layout.nominal
    errors = calibrated.build_leg_errors(machine, theta, 0.0, np.zeros(n_legs))
    found = build_calibrated(Legs(machine), theta, None, errors, calibrated.SOURCE)
    assert expected in line_of(export_machine, found, tmp_path / "out", name)
    assert studies.snapshot(tmp_path) == {}


@pytest.mark.parametrize("name", ["mechanism", "parameters", "toml", "csv", "json", "urdf", "genhexkins"])
def test_every_file_says_that_it_was_forced(name, hexapod, tmp_path):
    problems = ("R-hat up to 1.2",)
    forced = replace(hexapod, source=Source("study", "six_ups/none", "simulated", problems))
    for path in export_machine(forced, tmp_path, name):
        content = path.read_bytes()
        assert b"R-hat up to 1.2" in content or path.name == "deformation_matrix.csv"
