"""Spatial machines as their sensors see them: derivatives, independent forms, what each sensor depends on, frames."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import studies

from bayescal.errors import InputError
from bayescal.machines.deformations import DEFORMATIONS, NominalDeformation
from bayescal.machines.kinematics import build_machine, solve_forward_kinematics
from bayescal.machines.models import MODELS
from bayescal.machines.read import find_machine_classes, list_machine_sources, load_mechanism, read_reading_model
from bayescal.machines.readings import POSE, Legs
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix

MACHINES = {
    "struts": ("audit/m2_hexapod_mechanism.toml", "six_ups", "none"),
    "base": ("telescope/mechanism.toml", "six_pus", "none"),
    "deformed": ("telescope/mechanism.toml", "six_pus", "linear"),
    "coupled": ("telescope/mechanism.toml", "six_pus", "matrix"),
}
MATRIX = np.array([[0.0, 3.0, -8.0, 12.0, -2.0, -20.0]] * 6) * 1e-3
POSE_STEP = np.array([1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5])


def build(name: str) -> Legs:
    path, model, deformation = MACHINES[name]
    mechanism = load_mechanism(studies.EXPERIMENTS / path)
    nominal = NominalDeformation(0.011, lambda: MATRIX)
    deformed = DEFORMATIONS[deformation].from_nominal(nominal)
    return Legs(build_machine(MODELS[model], mechanism, deformed), np.array([10.0, -20.0, 30.0]), inclined=True)


@pytest.fixture(scope="module", params=MACHINES)
def model(request) -> Legs:
    return build(request.param)


@pytest.fixture(scope="module")
def struts() -> Legs:
    return build("struts")


def draw(model: Legs, n_machines: int = 2, n_poses: int = 4, turn: float = 0.02):
    """Return machines (C, 1, D) off nominal and poses (1, P, 6) off home."""
    rng = np.random.default_rng(3)
    layout = model.layout
    scale = np.array([{"mm": 0.2, "rad": 1e-2}.get(unit, 1e-3) for unit in layout.units])
    theta = layout.nominal + scale * rng.standard_normal((n_machines, 1, layout.size))
    pose = model.home_pose + rng.uniform(-1.0, 1.0, (1, n_poses, 6)) * np.array([1.0, 1.0, 1.0, turn, turn, turn])
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
    at_home = model.read(nominal, model.home_pose)
    np.testing.assert_allclose(at_home[6:18], 0.0, atol=1e-12)
    theta = nominal.copy()
    theta[model.layout.index["tilt_a0"]] = 0.1
    theta[model.layout.index["tilt_b0"]] = -0.2
    np.testing.assert_allclose(model.read(theta, model.home_pose)[6:18], np.repeat([-0.1, 0.2], 6), atol=1e-12)


def test_inclinometers_see_the_whole_angle(struts):
    nominal, layout = struts.layout.nominal, struts.layout
    pose = struts.home_pose + np.array([0.05, -0.02, 0.01, 1e-5, -2e-5, 1e-5])
    a, b = layout.take_vector(nominal, "a"), layout.take_vector(nominal, "b")

    def legs(v):
        return v[:3] + b @ matrix_from_rotation_vector(v[3:]).T - a

    one, other = (g / np.linalg.norm(g, axis=1, keepdims=True) for g in (legs(struts.home_pose), legs(pose)))
    angle = np.linalg.norm(np.cross(one, other), axis=1)
    read = struts.read(nominal, pose)
    np.testing.assert_allclose(np.hypot(read[6:12], read[12:18]), angle, rtol=1e-7)


def test_an_instrument_sees_the_pose(model):
    theta, pose = draw(model)
    read = model.read(theta, pose)
    np.testing.assert_array_equal(read[..., 18:], np.broadcast_to(pose, read[..., 18:].shape))
    assert [channel.external for channel in model.channels] == [False] * 18 + [True] * 6


def test_some_sensors_read_what_they_read_among_all(model):
    """Inclinometers of a kind that nobody has are not even computed."""
    theta, pose = draw(model)
    whole = model.linearise(theta, pose)
    for names, n_computed in ((["rho[2]", "tilt_b[5]", "x"], 18), (["rho", *POSE], 12), (["tilt_a", "tilt_b[1]"], 24)):
        places = model.select(names)
        some = model.pick(places)
        assert len(some.computed) == n_computed
        found = some.linearise(theta, pose)
        np.testing.assert_array_equal(some.read(theta, pose), whole.values[..., places])
        np.testing.assert_array_equal(found.values, whole.values[..., places])
        np.testing.assert_array_equal(found.by_pose, whole.by_pose[..., places, :])
        np.testing.assert_array_equal(found.by_parameters, whole.by_parameters[..., places, :])
        assert some.seen_parameters(names) == model.seen_parameters(names)


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
    far = model.home_pose + np.array([0.0, 0.0, 3.0 * model.machine.mechanism.actuator_range, 0.0, 0.0, 0.0])
    with pytest.raises(InputError, match=r"pose 2: rho\[\d\] would be .* mm, its range is .*, expected a pose that"):
        model.check_poses(np.stack([model.home_pose, far]))
    model.check_poses(model.home_pose[None])


def test_too_short_legs_have_no_reading():
    model = build("base")
    far = model.home_pose + np.array([5000.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert np.isnan(model.read(model.layout.nominal, far)[:6]).any()
    with pytest.raises(InputError, match=r"pose 1: rho\[1\] has no value there"):
        model.check_poses(far[None])


# --- frames ----------------------------------------------------------------------------------------------------------


def move_base(model: Legs, theta, pose, shift, turn):
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


# --- model errors ----------------------------------------------------------------------------------------------------


def test_a_leg_that_errs_deflects_no_other(model):
    """Its foot displaced along its actuator is an error of its closure alone."""
    theta, pose = draw(model)
    if "kappa" in model.layout.symbols:
        theta[..., model.layout.index["kappa"]] = 0.0  # nor its own joint
        for symbol in ("u_x", "u_y"):
            theta[..., model.layout.index[symbol]] = 0.0
    gain = model.error_gain(theta, pose)
    if model.machine.deformation.name != "matrix":
        assert gain is None
        return
    place = [model.layout.index[f"a_{axis}"] for axis in "xyz"]
    moved = model.linearise(theta, pose).by_parameters[..., :6, :]
    along = model.machine.mechanism.directions
    expected = -sum(along[:, k] * moved[..., place[k]] for k in range(3))
    shown = gain[..., :6, :6]
    np.testing.assert_allclose(shown, expected, atol=1e-6)
    assert np.abs(shown - np.eye(6)).max() > 1e-3
    some = model.pick(np.array([1, 2, 5, 18]))
    np.testing.assert_array_equal(some.error_gain(theta, pose), gain[..., [1, 2, 5, 18], :][..., [1, 2, 5, 18]])


# --- from a file -----------------------------------------------------------------------------------------------------

FILE = """
kind = "legs"
name = "space-telescope"
mechanism = "mechanism.toml"
model = "six_pus"
deformation = "matrix"
kappa = 0.011
matrix = "deformation_matrix.csv"
tool_mm = [0.0, 0.0, 12.0]
"""


@pytest.fixture
def file(tmp_path):
    for name in ("mechanism.toml", "deformation_matrix.csv"):
        (tmp_path / name).write_text((studies.EXPERIMENTS / "telescope" / name).read_text())
    path = tmp_path / "legs.toml"
    path.write_text(FILE)
    return path


def test_legs_are_a_machine_with_readings(file):
    found = read_reading_model(file)
    assert found.name == "space-telescope"
    assert found.commanded == tuple(f"rho[{k}]" for k in range(1, 7))
    assert found.pick(np.array([0, 18])).commanded == ("rho[1]",)
    deformation = found.machine.deformation
    assert deformation.matrix[0, 3] == pytest.approx(0.012)
    np.testing.assert_array_equal(found.layout.nominal[found.layout.index["kappa"]], np.diag(deformation.matrix))
    np.testing.assert_array_equal(found.tool_point, [0.0, 0.0, 12.0])
    assert list_machine_sources(file) == ["mechanism.toml", "deformation_matrix.csv"]
    assert find_machine_classes(file) == [type(found.machine.model), type(deformation)]


def test_the_workspace_is_what_the_actuators_reach(model):
    """To first order, of all legs at the end of their range the worst combination."""
    mechanism, reach = model.machine.mechanism, np.array([one.reach for one in model.coordinates])
    ends = np.array(list(product((-1.0, 1.0), repeat=6)))
    little = 1e-3 * mechanism.actuator_range
    found = solve_forward_kinematics(
        model.machine,
        model.layout.nominal[: model.machine.layout.size],
        mechanism.initial_actuator_positions + little * ends,
    )
    moved = np.concatenate([found.position, rotation_vector_from_matrix(found.rotation)], axis=1) - model.home_pose
    np.testing.assert_allclose(np.abs(moved).max(axis=0), 1e-3 * reach, rtol=0.02)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("six_pus", "seven_pus", "seven_pus"),
        ("six_pus", "six_ups", "expected"),
        ('"mechanism.toml"', '"machine.toml"', "machine.toml: no such file"),
        ('matrix = "deformation_matrix.csv"', "", "found no matrix for deformation 'matrix'"),
        ("kappa = 0.011", "kapa = 0.011", "kapa"),
    ],
)
def test_bad_files_of_legs_are_refused(file, old, new, message):
    file.write_text(FILE.replace(old, new))
    with pytest.raises(InputError, match=message):
        read_reading_model(file)
