"""The 6-UPS: its closure written out, the real hexapods over their limits, and machines of another drive."""

from __future__ import annotations

import itertools
from dataclasses import replace

import hexapods
import numpy as np
import pytest
import telescope_machines as machines
from scipy.spatial.transform import Rotation

from bayescal.density.priors import NormalPrior, UniformPrior
from bayescal.errors import InputError
from bayescal.inference.mode import find_modes
from bayescal.machines.kinematics import (
    Machine,
    check_home_pose,
    compute_home_legs,
    compute_leg_lines,
    guess_home_pose,
    solve_forward_kinematics,
    solve_inverse_kinematics,
)
from bayescal.machines.models import MODELS
from bayescal.machines.read import load_mechanism
from bayescal.numerics.geometry import compute_pose_error

STROKE = 14.1
SYMBOLS = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "l")
CONDITION = {"camera": 7.70, "m2": 2.17}  # of the home pose, lengths by the platform's largest


@pytest.fixture(params=hexapods.LIMITS)
def name(request):
    """Return the name of a hexapod."""
    return request.param


@pytest.fixture
def machine(name):
    """Return a hexapod without deformation."""
    return machines.build_machine("none", hexapods.load_hexapod(name), "six_ups")


def strut_lengths(position, rotation_vector, base, platform):
    """Return the distances between the joints, one by one."""
    rotation = Rotation.from_rotvec(rotation_vector).as_matrix()
    return np.array([np.sqrt(sum((position + rotation @ b - a) ** 2)) for a, b in zip(base, platform, strict=True)])


# --- the closure -----------------------------------------------------------------------------------------------------


def test_closure_is_wanted_length_minus_distance(rng):
    machine = machines.build_machine("matrix", model="six_ups")
    layout, rho0 = machine.layout, machine.mechanism.initial_actuator_positions
    theta = layout.nominal + machines.spread_of(layout) * rng.standard_normal(layout.size)
    position, turn = np.array([1.0, -2.0, 503.0]), np.array([0.02, -0.05, 0.03])
    displacement = rng.uniform(-1.3, 1.3, 6)
    matrix = machines.TELESCOPE_MATRIX.copy()
    np.fill_diagonal(matrix, layout.take(theta, "kappa"))
    joints = layout.take_vector(theta, "b") + np.outer(matrix @ displacement, [0, 0, 1])
    lengths = strut_lengths(position, turn, layout.take_vector(theta, "a"), joints)
    found = machine.linearise(theta, position, Rotation.from_rotvec(turn).as_matrix(), rho0 + displacement).residual
    np.testing.assert_allclose(found, layout.take(theta, "l") + displacement - lengths, rtol=0, atol=1e-12)
    assert np.abs(found).min() > 1e-3


# --- real hexapods ---------------------------------------------------------------------------------------------------


def test_home_pose_is_the_pivot_and_regular(name, machine):
    home, mechanism = check_home_pose(machine), machine.mechanism
    np.testing.assert_allclose(home.position, mechanism.home_position, atol=1e-9)
    np.testing.assert_allclose(home.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(
        compute_home_legs(machine), home.position + mechanism.platform_points - mechanism.base_points
    )
    np.testing.assert_allclose(mechanism.leg_lengths, 493.0, atol=0.1)
    pose = machine.linearise(machine.layout.nominal, home.position, home.rotation, np.zeros(6)).pose
    pose[:, 3:] /= np.linalg.norm(mechanism.platform_points, axis=1).max()
    assert np.linalg.cond(pose) == pytest.approx(CONDITION[name], abs=0.01)


def test_lateral_struts_need_the_stated_home():
    """M2's are horizontal; with a longer one on the other side of its joint there is no guess above the base."""
    m2 = hexapods.load_hexapod("m2")
    home = np.array(m2.home_position)
    struts = home + m2.platform_points - m2.base_points
    np.testing.assert_allclose(struts[3:, 2], 0.0, atol=1e-9)
    assert np.linalg.norm(guess_home_pose(replace(m2, home_position=None))[0] - home) > 100.0
    struts[4] *= -1.2
    lengths = np.linalg.norm(struts, axis=1)
    other = replace(m2, base_points=home + m2.platform_points - struts, leg_lengths=lengths)
    found = check_home_pose(machines.build_machine("none", other, "six_ups"))
    np.testing.assert_allclose(found.position, home, atol=1e-9)
    assert found.n_iterations == 1
    with pytest.raises(InputError, match="leg 4 of 493"):
        check_home_pose(machines.build_machine("none", replace(other, home_position=None), "six_ups"))


def test_lines_of_level_legs_are_finite(machine):
    """Lines of rising legs have z = 1; those of level ones, as of M2's lateral struts, are unit vectors."""
    legs, lines = compute_home_legs(machine), compute_leg_lines(machine)
    level = np.abs(legs[:, 2]) < 1e-9
    np.testing.assert_array_equal(lines[:, 2], np.where(level, 0.0, 1.0))
    np.testing.assert_allclose(np.linalg.norm(lines[level], axis=1), 1.0, rtol=1e-15)
    np.testing.assert_allclose(np.cross(lines, legs), 0.0, atol=1e-9)
    telescope = machines.build_machine("none")
    legs = compute_home_legs(telescope)
    np.testing.assert_array_equal(compute_leg_lines(telescope), legs / legs[:, 2:])
    assert np.abs(legs[:, :2]).max() > 10.0


def test_every_axis_reaches_its_limit_within_the_stroke(name, machine):
    """As the observatory's limits are meant: one axis at a time."""
    position, rotation = hexapods.poses_about_pivot(name, np.concatenate([np.eye(6), -np.eye(6)]))
    found = solve_inverse_kinematics(machine, machine.layout.nominal, position, rotation).actuators
    assert 8.0 < np.abs(found).max() < STROKE


def test_forward_finds_what_inverse_was_given_over_all_limits(name, machine, rng):
    """Ten thousand poses and all combinations of the limits, many beyond the stroke; lengths are as between joints."""
    ends = np.array(list(itertools.product([-1.0, 0.0, 1.0], repeat=6)))
    position, rotation = hexapods.poses_about_pivot(name, np.concatenate([ends, rng.uniform(-1, 1, (10_000, 6))]))
    theta, mechanism = machine.layout.nominal, machine.mechanism
    actuators = solve_inverse_kinematics(machine, theta, position, rotation).actuators
    turns = Rotation.from_matrix(rotation[:50]).as_rotvec()
    for k in range(50):
        lengths = strut_lengths(position[k], turns[k], mechanism.base_points, mechanism.platform_points)
        np.testing.assert_allclose(actuators[k], lengths - mechanism.leg_lengths, atol=1e-11)
    found = solve_forward_kinematics(machine, theta, actuators)
    error = compute_pose_error(found.position, found.rotation, position, rotation)
    assert np.abs(error[:, :3]).max() < 1e-11
    assert np.abs(error[:, 3:]).max() < 1e-14
    assert found.n_iterations <= 5


def test_large_workspace_of_yu_2023(rng):
    """Home at sqrt(800² - 643.21²) mm, without a stated home; ±100 mm and ±10 deg about it."""
    mechanism = load_mechanism(hexapods.AUDIT / "yu2023_mechanism.toml")
    machine = machines.build_machine("none", mechanism, "six_ups")
    theta, home = machine.layout.nominal, check_home_pose(machine)
    np.testing.assert_allclose(home.position, [0.0, 0.0, 475.70], atol=0.005)
    share = np.concatenate([list(itertools.product([-1.0, 1.0], repeat=6)), rng.uniform(-1, 1, (1000, 6))])
    position = home.position + 100.0 * share[:, :3]
    rotation = Rotation.from_euler("xyz", 10.0 * share[:, 3:], degrees=True).as_matrix()
    actuators = solve_inverse_kinematics(machine, theta, position, rotation).actuators
    assert 0.95 * mechanism.actuator_range < np.abs(actuators).max() < mechanism.actuator_range
    found = solve_forward_kinematics(machine, theta, actuators)
    error = compute_pose_error(found.position, found.rotation, position, rotation)
    assert np.abs(error).max() < 1e-11


# --- identification --------------------------------------------------------------------------------------------------


def simulate(machine, offset, rng, n_poses=40):
    """Return poses of the nominal machine with offsets of size one, as measured."""
    theta = machine.layout.nominal + offset * rng.standard_normal(machine.layout.size)
    actuators = STROKE * rng.uniform(-1, 1, (n_poses, 6))
    return theta, machines.simulate_poses(machine, theta, actuators, np.zeros(6), rng)


def test_gradient_with_everything_free(machine, rng):
    """Horizontal struts too: nothing refers to their slopes."""
    _, poses = simulate(machine, 0.0, rng)
    layout = machine.layout
    priors = {name: NormalPrior(value, 1.0) for name, value in zip(layout.names, layout.nominal, strict=True)}
    priors["l[2]"] = UniformPrior(*(priors["l[2]"].mean + np.array([-2.0, 2.0])))
    posterior = machines.measure(machine, poses, priors, machines.let_err())
    y = 1e-3 * rng.standard_normal(posterior.n_parameters)
    theta = posterior.theta(y[None])
    np.testing.assert_allclose(posterior.sampling.y_from_theta(theta)[0], y[:42], atol=1e-9)
    found, _ = posterior.gradient(y)
    expected = machines.stencil_derivative(posterior.log_density, y, np.full(len(y), 1e-4))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4 * np.abs(expected).max())


def test_mode_is_where_the_machine_is(machine, rng):
    """In units of the posterior's own spread; there is one mode, since a strut has no mirror image."""
    theta, poses = simulate(machine, 1.0, rng)
    layout = machine.layout
    priors = {name: NormalPrior(value, 1.0) for name, value in zip(layout.names, layout.nominal, strict=True)}
    posterior = machines.measure(machine, poses, priors)
    (mode,) = find_modes(posterior)
    assert mode.converged
    off = mode.y - posterior.sampling.y_from_theta(theta)
    assert 18 < off @ np.linalg.solve(mode.covariance, off) < 78  # χ² of 42: 0.05 % on either side
    nominal = mode.y  # from the nominal machine, where y is zero
    assert nominal @ np.linalg.solve(mode.covariance, nominal) > 1e4


# --- drives ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", machines.model_names())
def test_a_model_refuses_the_other_drive(model):
    """One line: the model, what was found and what would do."""
    struts = MODELS[model].drive == "strut"
    mechanism = machines.build_telescope() if struts else machines.build_hexapod()
    expected = "beam, jacobian, six_pus, stiffness, stiffness_fixed" if struts else "six_ups"
    found = "actuators at the base" if struts else "struts"
    with pytest.raises(InputError, match=rf"^model '{model}': found {found} .*'telescope', .*\b{expected}$"):
        Machine(mechanism, machines.build_model(model, mechanism), machines.build_deformation("none"))
