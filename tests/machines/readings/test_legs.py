"""Spatial machines as their sensors see them, against independent forms; their model errors and files."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import studies
import telescope_machines as telescope
from machine_registry import LEGS, build_legs, sizes_of

from bayescal.errors import InputError
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.machines.models import MODELS
from bayescal.machines.read import find_machine_classes, list_machine_sources, read_reading_model
from bayescal.machines.readings import POSE, Legs
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix


@pytest.fixture(scope="module", params=LEGS)
def model(request) -> Legs:
    return build_legs(request.param)


@pytest.fixture(scope="module")
def struts() -> Legs:
    return build_legs("struts")


def draw(model: Legs, n_machines: int = 2, n_poses: int = 4):
    """Return machines (C, 1, D) off nominal and poses (1, P, 6) off home."""
    rng = np.random.default_rng(3)
    theta = model.layout.nominal + sizes_of(model) * rng.standard_normal((n_machines, 1, model.layout.size))
    return theta, model.home_pose + rng.uniform(-1.0, 1.0, (1, n_poses, 6)) * ([1.0] * 3 + [0.02] * 3)


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


def find_faults(model, pose):
    """Return what is wrong with poses (P, 6) of the nominal machine."""
    nominal = model.layout.nominal
    return model.find_faults(nominal, pose, model.read(nominal, pose)[:, model.select(model.commanded)])


def test_out_of_reach_is_named(model):
    far = model.home_pose + np.array([0.0, 0.0, 3.0 * model.machine.mechanism.actuator_range, 0.0, 0.0, 0.0])
    home, fault = find_faults(model, np.stack([model.home_pose, far]))
    assert home == ""
    assert re.match(r"rho\[\d\] would be .* mm, its range is .*", fault)


def test_too_short_legs_have_no_reading():
    model = build_legs("base")
    far = model.home_pose + np.array([5000.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert np.isnan(model.read(model.layout.nominal, far)[:6]).any()
    assert find_faults(model, far[None])[0].startswith("rho[1] is unreachable")


def test_inclinometers_that_nobody_has_are_not_computed(model):
    for names, n_computed in ((["rho[2]", "tilt_b[5]", "x"], 18), (["rho", *POSE], 12), (["tilt_a", "tilt_b[1]"], 24)):
        assert len(model.pick(model.select(names)).computed) == n_computed


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


# --- gains of the actuators ------------------------------------------------------------------------------------------


@pytest.fixture(params=[*MODELS, "strut"])
def geared(request) -> Legs:
    """Return a machine with gains, of every kinematic model, its joints deflected by what all actuators travel."""
    if request.param == "strut":
        return build_legs("struts").with_optional(["gain"])
    return Legs(telescope.build_machine("matrix", model=request.param)).with_optional(["gain"])


def gear(legs: Legs) -> np.ndarray:
    """Return a machine (D,) whose actuators travel by up to a percent more or less than they read."""
    theta = legs.layout.nominal.copy()
    theta[legs.layout.index["gain"]] = 1.0 + 0.01 * np.linspace(-1.0, 1.0, legs.n_legs)
    return theta


def test_an_actuator_has_travelled_its_gain_times_what_it_reads(geared):
    theta, start = gear(geared), geared.machine.mechanism.initial_actuator_positions
    alone, reach = Legs(geared.machine), geared.machine.mechanism.actuator_range
    pose = geared.home_pose + np.random.default_rng(1).uniform(-0.2, 0.2, (5, 6)) * [
        one.reach for one in geared.coordinates
    ]
    places = geared.select(geared.commanded)
    travel = alone.read(alone.layout.nominal, pose)[:, alone.select(alone.commanded)] - start
    read = geared.read(theta, pose)[:, places] - start
    np.testing.assert_allclose(theta[geared.layout.index["gain"]] * read, travel, atol=1e-9 * reach)
    assert np.abs(read - travel).max() > 1e-3 * reach
    found, good = geared.locate(theta, start + read)
    assert good.all()
    np.testing.assert_allclose(found, pose, atol=1e-7)


def test_gains_change_nothing_at_home(geared):
    at_home = geared.read(gear(geared), geared.home_pose)
    np.testing.assert_allclose(at_home, geared.read(geared.layout.nominal, geared.home_pose), atol=1e-9)
    slope = geared.linearise(gear(geared), geared.home_pose).by_parameters[:, geared.layout.index["gain"]]
    np.testing.assert_allclose(slope, 0.0, atol=1e-9)


def test_commands_are_answered_as_by_the_machine_itself(geared):
    """To first order about the mean machine, of machines with other gains."""
    mean = gear(geared)
    draws = np.repeat(mean[None], 3, axis=0)
    draws[:, geared.layout.index["gain"]] += 1e-4 * np.random.default_rng(2).standard_normal((3, geared.n_legs))
    start, reach = geared.machine.mechanism.initial_actuator_positions, geared.machine.mechanism.actuator_range
    commands = start + 0.3 * reach * np.random.default_rng(3).uniform(-1, 1, (4, geared.n_legs))
    pose, _ = geared.locate(mean, commands)
    places = geared.select(geared.commanded)
    exact = geared.read(draws[:, None], pose)[..., places].transpose(1, 2, 0) - commands[..., None]
    assert np.abs(exact).max() > 1e-5 * reach
    np.testing.assert_allclose(geared.respond(draws, mean, pose, commands), exact, atol=1e-3 * np.abs(exact).max())


def test_gains_are_parameters_where_they_are_named(model):
    bare = replace(model, inclined=False, channels=())
    assert "gain" not in model.layout.symbols
    assert model.with_optional(["l", "gian"]) is model
    named = bare.with_optional({"gain": None})
    assert named.layout.names[-6:] == tuple(f"gain[{leg}]" for leg in range(1, 7))
    stated = replace(bare.machine.mechanism, actuator_gains=np.full(6, 1.01))
    np.testing.assert_array_equal(Legs(replace(bare.machine, mechanism=stated)).layout.nominal[-6:], 1.01)


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
        ('matrix = "deformation_matrix.csv"', "", "found no matrix"),
        ("kappa = 0.011", "kapa = 0.011", "kapa"),
    ],
)
def test_bad_files_of_legs_are_refused(file, old, new, message):
    file.write_text(FILE.replace(old, new))
    with pytest.raises(InputError, match=message):
        read_reading_model(file)
