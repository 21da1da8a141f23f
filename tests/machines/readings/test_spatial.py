"""Spatial machines as their sensors see them: derivatives, independent forms, what each sensor depends on, frames."""

from __future__ import annotations

import numpy as np
import pytest
import studies

from bayescal.errors import InputError
from bayescal.machines.deformations import DEFORMATIONS, NominalDeformation
from bayescal.machines.kinematics import build_machine
from bayescal.machines.models import MODELS
from bayescal.machines.read import load_mechanism
from bayescal.machines.readings import SpatialMachine
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix

MACHINES = {
    "struts": ("audit/m2_hexapod_mechanism.toml", "six_ups", "none"),
    "base": ("telescope/mechanism.toml", "six_pus", "none"),
    "deformed": ("telescope/mechanism.toml", "six_pus", "linear"),
}
POSE_STEP = np.array([1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5])


def build(name: str) -> SpatialMachine:
    path, model, deformation = MACHINES[name]
    mechanism = load_mechanism(studies.EXPERIMENTS / path)
    nominal = NominalDeformation(0.011, lambda: np.zeros((6, 6)))
    deformed = DEFORMATIONS[deformation].from_nominal(nominal)
    return SpatialMachine(build_machine(MODELS[model], mechanism, deformed), np.array([10.0, -20.0, 30.0]))


@pytest.fixture(scope="module", params=MACHINES)
def model(request) -> SpatialMachine:
    return build(request.param)


@pytest.fixture(scope="module")
def struts() -> SpatialMachine:
    return build("struts")


def draw(model: SpatialMachine, n_machines: int = 2, n_poses: int = 4, turn: float = 0.02):
    """Return machines (C, 1, D) off nominal and poses (1, P, 6) off home."""
    rng = np.random.default_rng(3)
    layout = model.layout
    scale = np.array([{"mm": 0.2, "rad": 1e-2}.get(unit, 1e-3) for unit in layout.units])
    if "kappa" in layout.symbols:  # a deformation's gain is everywhere that of the nominal machine
        scale[layout.index["kappa"]] = 0.0
    theta = layout.nominal + scale * rng.standard_normal((n_machines, 1, layout.size))
    pose = model.home + rng.uniform(-1.0, 1.0, (1, n_poses, 6)) * np.array([1.0, 1.0, 1.0, turn, turn, turn])
    return theta, pose


def differentiate(function, point, steps):
    return np.stack(
        [
            (function(point + h * e) - function(point - h * e)) / (2 * h)
            for h, e in zip(steps, np.eye(len(steps)), strict=True)
        ],
        axis=-1,
    )


# --- derivatives -----------------------------------------------------------------------------------------------------


def test_derivatives_agree_with_differences(model):
    theta, pose = draw(model)
    found = model.linearise(theta, pose)
    np.testing.assert_array_equal(found.values, model.read(theta, pose))
    by_pose = differentiate(lambda v: model.read(theta, v), pose, POSE_STEP)
    size = np.abs(by_pose).max(axis=(0, 1, 2))
    np.testing.assert_allclose(found.by_pose / size, by_pose / size, atol=1e-8)
    steps = np.where(np.array(model.layout.units) == "mm", 1e-4, 1e-6)
    by_parameters = differentiate(lambda t: model.read(t, pose), theta, steps)
    scale = np.abs(by_parameters).max(axis=(0, 1, 2))
    np.testing.assert_allclose(found.by_parameters, by_parameters, atol=1e-6 * scale.max())


def test_poses_may_be_far_from_level(struts):
    """The rotation vector's own derivative matters there: rotations do not add up."""
    theta, pose = draw(struts, 1, 3, turn=0.2)
    by_pose = differentiate(lambda v: struts.read(theta, v), pose, POSE_STEP)
    np.testing.assert_allclose(struts.linearise(theta, pose).by_pose, by_pose, atol=1e-8 * np.abs(by_pose).max())
    position, by_pose, _ = struts.tool(theta, pose)
    expected = differentiate(lambda v: struts.tool(theta, v)[0], pose, POSE_STEP)
    np.testing.assert_allclose(by_pose, expected, atol=1e-8 * np.abs(expected).max())
    arm = np.einsum("...ij,j->...i", struts.rotation(pose), struts.tool_point)
    np.testing.assert_allclose(position, np.broadcast_to(pose[..., :3] + arm, position.shape), atol=1e-12)


# --- what sensors read -----------------------------------------------------------------------------------------------


def test_encoders_read_how_much_longer_struts_are(struts):
    theta, pose = draw(struts)
    layout, rotation = struts.layout, matrix_from_rotation_vector(pose[..., 3:])
    upper = pose[..., None, :3] + np.einsum("...ij,...nj->...ni", rotation, layout.take_vector(theta, "b"))
    lengths = np.linalg.norm(upper - layout.take_vector(theta, "a"), axis=-1)
    np.testing.assert_allclose(struts.read(theta, pose)[..., :6], lengths - layout.take(theta, "l"), atol=1e-9)


def test_inclinometers_read_zero_at_home_but_for_their_zeros(model):
    nominal = model.layout.nominal
    at_home = model.read(nominal, model.home)
    np.testing.assert_allclose(at_home[6:18], 0.0, atol=1e-12)
    theta = nominal.copy()
    theta[model.layout.index["tilt_a0"]] = 0.1
    theta[model.layout.index["tilt_b0"]] = -0.2
    np.testing.assert_allclose(model.read(theta, model.home)[6:18], np.repeat([-0.1, 0.2], 6), atol=1e-12)


def test_inclinometers_see_the_whole_angle(struts):
    nominal, layout = struts.layout.nominal, struts.layout
    pose = struts.home + np.array([0.05, -0.02, 0.01, 1e-5, -2e-5, 1e-5])
    a, b = layout.take_vector(nominal, "a"), layout.take_vector(nominal, "b")

    def legs(v):
        return v[:3] + b @ matrix_from_rotation_vector(v[3:]).T - a

    one, other = (g / np.linalg.norm(g, axis=1, keepdims=True) for g in (legs(struts.home), legs(pose)))
    angle = np.linalg.norm(np.cross(one, other), axis=1)
    read = struts.read(nominal, pose)
    np.testing.assert_allclose(np.hypot(read[6:12], read[12:18]), angle, rtol=1e-7)


def test_an_instrument_sees_the_pose(model):
    theta, pose = draw(model)
    read = model.read(theta, pose)
    np.testing.assert_array_equal(read[..., 18:], np.broadcast_to(pose, read[..., 18:].shape))
    assert [channel.external for channel in model.channels] == [False] * 18 + [True] * 6


def test_each_sensor_sees_what_it_is_said_to(model):
    theta, pose = draw(model, 1, 5)
    by_parameters = np.abs(model.linearise(theta, pose).by_parameters).max(axis=(0, 1))
    for name, row in zip(model.names, by_parameters, strict=True):
        depends = {n for n, value in zip(model.layout.names, row, strict=True) if value > 1e-12}
        seen = set(model.seen_parameters([name]))
        assert depends <= seen, name
        if name.startswith("rho") and "kappa" not in model.layout.symbols:
            assert depends == seen


def test_out_of_reach_is_nan_and_named(model):
    far = model.home + np.array([0.0, 0.0, 5000.0, 0.0, 0.0, 0.0])
    with pytest.raises(InputError, match=r"machine .*: pose 2: actuator \d cannot reach it, found .* expected at most"):
        model.check_poses(np.stack([model.home, far]))
    model.check_poses(model.home[None])


def test_too_short_legs_have_no_reading():
    model = build("base")
    far = model.home + np.array([5000.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert np.isnan(model.read(model.layout.nominal, far)[:6]).any()
    with pytest.raises(InputError, match="found no position from its initial position"):
        model.check_poses(far[None])


# --- frames ----------------------------------------------------------------------------------------------------------


def move_base(model: SpatialMachine, theta, pose, shift, turn):
    """Return machine and pose after a rigid motion of the base frame: the readings of encoders stay."""
    rotation, layout = matrix_from_rotation_vector(turn), model.layout
    moved = theta.copy()
    points = layout.take_vector(theta, "a") @ rotation.T + shift
    for k, axis in enumerate("xyz"):
        moved[..., layout.index[f"a_{axis}"]] = points[..., k]
    turned = rotation_vector_from_matrix(rotation @ matrix_from_rotation_vector(pose[..., 3:]))
    return moved, np.concatenate([pose[..., :3] @ rotation.T + shift, turned], axis=-1)


def test_encoders_do_not_see_where_the_base_stands(struts):
    theta, pose = draw(struts)
    moved = move_base(struts, theta, pose, np.array([3.0, -2.0, 1.0]), np.array([0.1, 0.2, -0.3]))
    np.testing.assert_allclose(struts.read(*moved)[..., :6], struts.read(theta, pose)[..., :6], atol=1e-9)


@pytest.mark.parametrize("symbol", ["a", "b"])
def test_given_frames_leave_no_motion(model, symbol):
    names = [name for name in model.frame_parameters() if name.startswith(f"{symbol}_")]
    assert len(set(names)) == 6
    points = model.layout.take_vector(model.layout.nominal, symbol)
    rows = []
    for name in names:
        axis, leg = "xyz".index(name[2]), int(name[4]) - 1
        turn = np.cross(np.eye(3), points[leg] / 1000.0)[:, axis]
        rows.append(np.concatenate([np.eye(3)[axis], turn]))
    assert np.linalg.svd(np.array(rows), compute_uv=False)[-1] > 0.005
