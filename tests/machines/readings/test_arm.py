"""Arms: the errors of their joints as products of matrices, moments of weight by energy, commands, sockets."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation
from serial_arms import JOINTS, SMALL, build_arm, list_masses, multiply, place_links
from studies import EXPERIMENTS

from bayescal.machines.read import read_reading_model
from bayescal.machines.readings import FunctionModel, Parameters
from bayescal.machines.readings.arm import Arm, ArmConfig
from bayescal.machines.readings.sockets import SocketConfig, SocketInstrument

UR10 = EXPERIMENTS / "ur10" / "machine.toml"
GRAVITY = 9.80665
BUILDERS = {
    "ur10": lambda: read_reading_model(UR10),
    "panda": lambda: read_reading_model(EXPERIMENTS / "panda_socket" / "machine.toml"),
    "small": lambda: FunctionModel("small", build_arm()),
}


@pytest.fixture(params=BUILDERS)
def model(request):
    """Return an arm of six rows, one of seven joints in a file, one with a joint that slides."""
    return BUILDERS[request.param]()


def draw_far(model, rng, *shape):
    """Return parameters (*shape, D) that are far off nominal, and poses (4, n) all over the workspace."""
    size = np.array([{"mm": 20.0, "rad": 0.2}.get(unit, 0.01) for unit in model.layout.units])
    pose = model.home_pose + model.pose_scale * rng.uniform(-1.0, 1.0, (4, len(model.home_pose)))
    return model.layout.nominal + size * rng.standard_normal((*shape, model.layout.size)), pose


# --- where the tip is ------------------------------------------------------------------------------------------------


def test_errors_stand_before_their_joints_move(model, rng):
    theta, pose = draw_far(model, rng)
    known, chain = Parameters(model.layout, theta), model.machine.chain

    def stand(position, axes):
        found = np.eye(4)
        found[:3, :3], found[:3, 3] = axes, position
        return found

    for v in pose:
        here = np.eye(4)
        for k, joint in enumerate(chain.joints):
            slide, turn = [known[one][k] for one in "xyz"], [known[one][k] for one in ("rx", "ry", "offset")]
            here = here @ stand(joint.place.position, joint.place.axes)
            here = here @ stand(slide, Rotation.from_rotvec(turn).as_matrix())
            along, about = (np.array([0.0, 0.0, v[k]]) * one for one in (joint.slides, not joint.slides))
            here = here @ stand(along, Rotation.from_rotvec(about).as_matrix())
        here = here @ stand(chain.tip.position, chain.tip.axes)
        here = here @ stand(known["tool"], Rotation.from_rotvec(known["tool_r"]).as_matrix())
        found = model.tool_values(theta, v)
        np.testing.assert_allclose(found[:3], here[:3, 3], atol=1e-9)
        np.testing.assert_allclose(Rotation.from_rotvec(found[3:]).as_matrix(), here[:3, :3], atol=1e-12)


def test_slopes_are_those_of_complex_steps_far_off_nominal(model, rng):
    theta, pose = draw_far(model, rng, 4)
    for found, expected in zip(model.tool(theta, pose), model.step_tool(theta, pose), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_many_machines_at_once_stand_where_each_does(model, rng):
    theta, pose = draw_far(model, rng, 3, 1)
    machine, known = model.machine, Parameters(model.layout, theta)
    for v in (pose, np.stack([pose, pose[::-1], 0.5 * pose])):
        position, axes = machine._follow_many(known, v)
        at = machine._follow(known, np.broadcast_to(v, (3, *pose.shape)))
        np.testing.assert_allclose(position, at["origins"][..., -1, :], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(axes, at["axes"][..., -1, :, :], rtol=0.0, atol=1e-12)


# --- what commands read ----------------------------------------------------------------------------------------------


def read_moments(model, pose):
    """Return moments about the joints, N m, by how a compliance of one radian each moves what is read."""
    theta = model.layout.nominal.copy()
    theta[model.layout.index["k"]] = 1e6
    return pose - model.read(theta, pose)


def fall(energy, v, steps):
    """Return by how much an energy falls with each coordinate, by central differences."""
    each = np.diag(steps)
    return np.array([energy(v - one) - energy(v + one) for one in each]) / (2.0 * steps)


@pytest.mark.parametrize("down", [[0.0, 0.0, -1.0], [3.0, -1.0, 0.5]])
def test_moments_are_how_potential_energy_falls(rng, down):
    payload, masses = 2.0, list_masses(SMALL)
    masses.pop("plinth")  # on which no joint acts
    up = -np.array(down) / np.linalg.norm(down)

    def energy(v):
        links = place_links(SMALL, dict(zip(JOINTS, v * [1.0, 1e-3, 1.0], strict=True)))
        found = payload * up @ links["flange"][:3, 3]
        return GRAVITY * (found + sum(m * up @ (links[one] @ centre)[:3] for one, (m, centre) in masses.items()))

    model = FunctionModel("small", build_arm(down=down))
    _, pose = draw_far(model, rng)
    for v, found in zip(pose, read_moments(model, pose), strict=True):
        turning = [1.0, 0.0, 1.0]  # a moment bends no slide
        np.testing.assert_allclose(found, fall(energy, v, np.full(3, 1e-5)) * turning, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("convention", ["classical", "modified"])
def test_masses_of_rows_stand_in_the_frames_of_their_rows(rng, convention):
    section = tomllib.loads(UR10.read_text())["machine"] | {"convention": convention, "payload_kg": 3.0}
    model = FunctionModel("ur10", Arm(ArmConfig.model_validate(section)))
    rows = section["joints"]

    def energy(v):
        here, found = np.eye(4), 0.0
        for row, q in zip(rows, v, strict=True):
            numbers = row.get("d_mm", 0.0), row.get("a_mm", 0.0), np.radians(row.get("alpha_deg", 0.0))
            here = here @ multiply(*numbers, q, convention == "modified")
            found += row["mass_kg"] * (here @ [*row.get("centre_mm", [0.0, 0.0, 0.0]), 1.0])[2]
        return 1e-3 * GRAVITY * (found + 3.0 * here[2, 3])

    _, pose = draw_far(model, rng)
    for v, found in zip(pose, read_moments(model, pose), strict=True):
        np.testing.assert_allclose(found, fall(energy, v, np.full(6, 1e-5)), rtol=0.0, atol=1e-6)


def test_what_commands_read_of_gains_and_sines(rng):
    model = FunctionModel("small", build_arm())
    theta, pose = draw_far(model, rng)
    theta[model.layout.index["k"]] = 0.0
    known = Parameters(model.layout, theta)
    turns = np.array([1.0, 0.0, 1.0])
    sines = known["s1"] * np.sin(pose) + known["c1"] * np.cos(pose)
    sines = sines + known["s2"] * np.sin(2.0 * pose) + known["c2"] * np.cos(2.0 * pose)
    np.testing.assert_allclose(model.read(theta, pose), pose - known["gain"] * pose - turns * sines, atol=1e-12)


def test_slopes_of_commands_are_those_of_complex_steps(model, rng):
    theta, pose = draw_far(model, rng, 3, 1)
    if "k" in model.layout.symbols:
        theta[..., model.layout.index["k"]] = 1e4 * rng.standard_normal(len(model.layout.index["k"]))
    every = np.eye(theta.shape[-1] + pose.shape[-1])[theta.shape[-1] :]
    _, stepped = model.differentiate(theta, pose, {}, every)
    np.testing.assert_allclose(model.closed_slopes(theta, pose, {}), np.moveaxis(stepped, 0, -1), rtol=0.0, atol=1e-12)


def test_no_compliance_without_masses():
    assert "k" not in BUILDERS["panda"]().layout.symbols
    assert "k" in BUILDERS["ur10"]().layout.symbols


# --- ranges ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("limit", "expected"),
    [
        ('lower="-1.2" upper="2.0"', (-1.2, 2.0)),
        ('lower="-6.2" upper="6.2"', (-np.pi, np.pi)),
        ('lower="3.5" upper="6.0"', (3.5, 6.0)),
        ('soft="1"', (-np.pi, np.pi)),
    ],
)
def test_a_joint_is_where_its_limits_are(limit, expected):
    arm = build_arm(SMALL.replace('lower="-1.2" upper="2.0"', limit))
    one = arm.coordinates[0]
    np.testing.assert_allclose([one.home - one.reach, one.home + one.reach], expected)


def test_a_workspace_is_in_degrees_and_of_slides_in_mm():
    arm = build_arm(workspace_deg=[[-90.0, 0.0], [10.0, 30.0], [-10.0, 10.0]])
    np.testing.assert_allclose([one.home for one in arm.coordinates], [-np.pi / 4.0, 20.0, 0.0])
    np.testing.assert_allclose([one.reach for one in arm.coordinates], [np.pi / 4.0, 10.0, np.pi / 18.0])


FAULTS = {
    "nothing": ({}, "found both or neither of urdf and joints, expected one"),
    "both": ({"urdf": "a.urdf", "joints": [{}]}, "found both or neither of urdf and joints, expected one"),
    "links": ({"joints": [{}], "tip": "hand"}, "found base or tip beside joints, expected them beside urdf"),
    "down": ({"joints": [{}], "down": [0.0, 0.0, 0.0]}, "down: found a zero vector, expected a direction"),
    "workspace": ({"joints": [{}], "workspace_deg": [[0, 1], [0, 1]]}, "workspace_deg: found 2 joints, expected 1"),
    "range": ({"joints": [{"range_deg": [90.0, -90.0]}]}, "found a range from 90 to -90, expected the smaller first"),
    "one name": ({"joints": [{"name": "a"}, {"name": "a"}]}, "joints: found 'a' twice, expected unique names"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_sections_that_are_no_arm_are_refused(name):
    section, said = FAULTS[name]
    with pytest.raises(ValidationError, match=said):
        ArmConfig.model_validate(section)


# --- a ball in a socket ----------------------------------------------------------------------------------------------


def test_a_socket_reads_how_far_the_ball_is_off(rng):
    place, ball = np.array([500.0, -100.0, 250.0]), np.array([3.0, -4.0, 60.0])
    socket = SocketInstrument(SocketConfig(place_mm=list(place), target_mm=list(ball)))
    assert [one.name for one in socket.channels] == ["[x]", "[y]", "[z]"]
    known = {one.symbol: np.array(one.nominal) for one in socket.parameters}
    rotation = Rotation.from_rotvec(rng.standard_normal((5, 3)))
    position = place - rotation.apply(ball)
    off = rng.standard_normal((5, 3))
    seen = socket.see(known, position + off, rotation.as_matrix())
    np.testing.assert_allclose(seen, off, atol=1e-12)
    stated = {"target": ball}
    seen[2, 1] = np.nan
    (found,) = socket.propose(stated, seen, position + off, rotation.as_matrix())
    np.testing.assert_allclose(found["place"], place, atol=1e-12)


def test_a_ball_at_the_tools_centre_needs_no_rotation(rng):
    socket = SocketInstrument(SocketConfig())
    assert [one.symbol for one in socket.parameters] == ["place"]
    assert np.isnan(socket.parameters[0].nominal).all()
    position = rng.standard_normal((4, 3))
    np.testing.assert_array_equal(socket.see({"place": np.zeros(3)}, position, None), position)
    found = SocketInstrument(SocketConfig(target_mm="found"))
    assert [one.symbol for one in found.parameters] == ["place", "target"]


def test_an_arm_is_drawn_from_its_base_to_its_tip(rng):
    model = read_reading_model(UR10)
    theta = model.layout.nominal + 1e-3 * rng.standard_normal(model.layout.size)
    points, pairs = model.machine.outline(Parameters(model.layout, theta), model.home_pose)
    np.testing.assert_allclose(points[-1], model.tool_values(theta, model.home_pose)[:3], atol=1e-9)
    assert pairs == [(k, k + 1) for k in range(len(points) - 1)]


SCARA = EXPERIMENTS.parent / "examples" / "machines" / "scara.toml"
LINKS_AND_TILTS = ("x[2]", "x[4]", "offset[2]", *(f"{turn}[{k}]" for k in (2, 3, 4) for turn in ("rx", "ry")))


def test_what_a_tracker_determines_of_a_scara(rng):
    """The parameters that its documentation names, and not one more beside the tracker's frame."""
    model = read_reading_model(SCARA)
    theta, names = model.layout.nominal, model.layout.names
    pose = model.home_pose + model.pose_scale * rng.uniform(-1.0, 1.0, (100, 4))
    tool, by_pose, by_parameters = model.tool(theta, pose)
    here = model.linearise(theta, pose)
    moved = (by_parameters - by_pose @ np.linalg.solve(here.by_pose, here.by_parameters))[:, :3]
    frame = np.concatenate(
        [np.broadcast_to(np.eye(3), (100, 3, 3)), np.cross(np.eye(3), tool[:, None, :3]).swapaxes(1, 2)], -1
    )

    def count(free):
        rows = np.concatenate([moved[..., [names.index(one) for one in free]], frame], axis=-1).reshape(300, -1)
        return np.linalg.matrix_rank(rows / np.linalg.norm(rows, axis=0).clip(1e-12), tol=1e-6)

    free = [*LINKS_AND_TILTS, "tool[x]", "tool[y]"]
    assert count(free) == len(free) + 6 == 17
    drawn = ("x", "y", "z", "rx", "ry", "offset", "tool", "tool_r")
    assert count([one for one in names if one.partition("[")[0] in drawn]) == 17
