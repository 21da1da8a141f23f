"""Actuators in any direction: components that tell them, kinematics both ways, derivatives, coordinates, refusals."""

from __future__ import annotations

import re
from dataclasses import replace

import guided_machines as guided
import numpy as np
import pytest
import telescope_machines as machines
from refusals import line_of
from scipy import stats

from bayescal.errors import NumericalError
from bayescal.machines.coordinates import mirror_direction
from bayescal.machines.kinematics import (
    check_home_pose,
    compute_home_legs,
    solve_forward_kinematics,
    solve_inverse_kinematics,
)
from bayescal.machines.models.legs import actuator_directions
from bayescal.machines.parameters import choose_chart
from bayescal.numerics.geometry import matrix_from_rotation_vector

MODELS = tuple(name for name in machines.model_names() if name != "six_ups")
AXES = np.eye(3)


@pytest.fixture(params=guided.KINDS)
def kind(request):
    """Return a kind of guides."""
    return request.param


@pytest.fixture(params=MODELS)
def model(request):
    """Return a model of machines driven at the base."""
    return request.param


# --- components ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("directions", "symbols"),
    [
        (AXES[[2, 2, 2]], ("u_x", "u_y")),
        (AXES[[2, 2, 2]] * [[1], [-1], [1]], ("u_x", "u_y")),
        (AXES[[0, 0, 0]] * [[1], [-1], [1]], ("u_y", "u_z")),
        (AXES[[1, 1, 1]], ("u_x", "u_z")),
        (np.array([[1.0, 0, 0], [-0.5, np.sqrt(0.75), 0], [-0.5, -np.sqrt(0.75), 0]]), ("u_y", "u_z")),
        (AXES[[0, 1, 2]], ("u_h", "u_v")),
        (np.array([[np.sqrt(0.5), 0, np.sqrt(0.5)]] * 3), ("u_x", "u_y")),
        (np.array([[np.sqrt(0.99), 0, 0.1]] * 3), ("u_y", "u_z")),
    ],
)
def test_components_that_tell_a_direction(directions, symbols):
    chart = choose_chart(directions)
    assert chart.symbols == symbols
    frames = np.array(chart.frames)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (3, 1, 1)), atol=1e-15)
    local = chart.to_local(directions)
    assert local[:, 2].min() >= 0.4
    np.testing.assert_allclose(chart.to_base(local), directions, atol=1e-15)
    for symbol, one in zip(symbols, local.T, strict=False):
        if symbol[-1] in "xyz":
            np.testing.assert_array_equal(one, directions[:, "xyz".index(symbol[-1])])


def test_components_across_are_horizontal_and_upwards():
    """Seen along an actuator u_h is to the left and u_v upwards; a vertical one has those along x and ±y."""
    chart = choose_chart(np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0], [0, 0, -1.0]]))
    np.testing.assert_array_equal(
        np.array(chart.frames)[:, :2],
        [[[0, 1, 0], [0, 0, 1]], [[1, 0, 0], [0, 0, 1]], [[1, 0, 0], [0, 1, 0]], [[1, 0, 0], [0, -1, 0]]],
    )


# --- kinematics ------------------------------------------------------------------------------------------------------


def test_far_along_the_guides_the_side_of_home_is_kept():
    """Half a metre along the guides every carriage follows; legs stay on their side of their feet."""
    machine = machines.build_machine("none", guided.build_hexaglide())
    theta, home = machine.layout.nominal, check_home_pose(machine)
    far = np.array([-700.0, -390.0, -100.0, 150.0, 390.0, 700.0])
    position = home.position + far[:, None] * AXES[0]
    rotation = np.tile(home.rotation, (len(far), 1, 1))
    found = solve_inverse_kinematics(machine, theta, position, rotation)
    np.testing.assert_allclose(
        found.actuators - machine.mechanism.initial_actuator_positions, np.tile(far[:, None], 6), rtol=0, atol=1e-9
    )
    within = np.abs(far) < 400.0
    back = solve_forward_kinematics(machine, theta, found.actuators[within])
    np.testing.assert_allclose(back.position, position[within], atol=1e-9)
    one = solve_forward_kinematics(machine, theta, found.actuators[1])
    np.testing.assert_array_equal(one.position, back.position[0])  # whatever the others are


def test_hanging_machine_is_the_standing_one_upside_down(model, rng):
    """Mirrored at the plane z = 0: with z of positions and the rotations about x and y of the other sign."""
    up, down = (machines.build_machine("none", m, model) for m in (machines.build_telescope(), guided.build_hanging()))
    actuators = machines.INITIAL_POSITION + rng.uniform(-1.3, 1.3, (20, 6))
    poses = [solve_forward_kinematics(m, m.layout.nominal, actuators) for m in (up, down)]
    mirror = np.diag([1.0, 1.0, -1.0])
    np.testing.assert_allclose(poses[1].position, poses[0].position @ mirror, atol=1e-9)
    np.testing.assert_allclose(poses[1].rotation, mirror @ poses[0].rotation @ mirror, atol=1e-11)


# --- coordinates -----------------------------------------------------------------------------------------------------


def build_posterior(mechanism, symbols, deformation="none"):
    machine = machines.build_machine(deformation, mechanism)
    position = np.array(mechanism.home_position) + 5.0 * machines.TABLE_3[:12, :3]
    rotation = matrix_from_rotation_vector(0.02 * machines.TABLE_3[:12, 3:])
    actuators = solve_inverse_kinematics(machine, machine.layout.nominal, position, rotation).actuators
    poses = machines.place_poses(machine, machine.layout.nominal, actuators, np.zeros((12, 6)))
    return machines.build_posterior(deformation, poses, symbols=symbols, machine=machine)


@pytest.mark.parametrize("with_kappa", [False, True], ids=["circles", "kappa"])
def test_coordinates_are_a_bijection_of_known_volume(kind, with_kappa, rng):
    components = guided.SYMBOLS[kind]
    symbols = ("a_x", "a_y", "a_z", "l", "rho0", *components, *(("kappa",) if with_kappa else ()))
    posterior = build_posterior(guided.build_guided(kind, seed=2), symbols, "linear" if with_kappa else "none")
    coordinates = posterior.sampling.coordinates
    y = 0.5 * rng.standard_normal((4, len(coordinates.free)))
    theta = coordinates.theta_from_y(y)
    np.testing.assert_allclose(coordinates.y_from_theta(theta), y, atol=1e-9)
    slope = coordinates.jacobian(theta[0])
    step = np.full(y.shape[1], 0.02)
    step[coordinates.ringed] = 1e-3  # quantiles come from a table of cubics
    difference = machines.stencil_derivative(coordinates.theta_from_y, y[0], step).reshape(slope.shape)
    np.testing.assert_allclose(slope, difference, atol=1e-7)
    volume = np.linalg.slogdet(slope[coordinates.free])[1]
    expected = coordinates.log_scale + np.broadcast_to(coordinates.log_volume(theta), 4)[0]
    for leg, places, ring in coordinates.rings:
        u = np.array([coordinates.layout.take(theta[0], symbol)[leg] for symbol in components])
        expected += ring.log_prior_ratio(y[:1, places])[0] - ring.log_prior(u)
        expected += stats.norm.logpdf(y[0, places]).sum()
    assert volume == pytest.approx(expected, abs=1e-8 if coordinates.rings else 1e-9)


@pytest.mark.parametrize("component", [0, 1])
def test_mirrored_direction_has_the_same_gain_and_joint(kind, component):
    machine = machines.build_machine("none", guided.build_guided(kind, seed=3))
    layout, legs = machine.layout, compute_home_legs(machine)
    free = np.concatenate([layout.index[f"a_{axis}"] for axis in "xyz"])
    before = actuator_directions(layout, layout.nominal)
    n_mirrored = 0
    for leg, line in enumerate(legs):
        theta = mirror_direction(layout, layout.nominal, leg, component, line, free)
        if theta is None:
            continue
        n_mirrored += 1
        after = actuator_directions(layout, theta)
        assert after[leg] @ line == pytest.approx(before[leg] @ line, rel=1e-12)
        assert np.abs(after[leg] - before[leg]).max() > 1e-3
        home = [
            layout.take_vector(t, "a") + layout.take(t, "rho0")[:, None] * u
            for t, u in ((theta, after), (layout.nominal, before))
        ]
        np.testing.assert_allclose(*home, atol=1e-10)
    assert n_mirrored


# --- refusals --------------------------------------------------------------------------------------------------------


def refuse(mechanism, model="six_pus"):
    """Return the one line with which a mechanism is refused."""
    message = line_of(lambda: check_home_pose(machines.build_machine("none", mechanism, model)))
    assert "expected" in message
    return message


def test_leg_across_its_actuator_is_refused():
    glide = guided.build_hexaglide()
    lower = glide.home_joints.copy()
    lower[2] = np.array([glide.platform_points[2, 0], 0.0, 0.0])
    lengths = np.linalg.norm(np.array(glide.home_position) + glide.platform_points - lower, axis=1)
    base = lower - glide.initial_actuator_positions[:, None] * glide.directions
    assert "leg 3 " in refuse(replace(glide, base_points=base, leg_lengths=lengths))


def test_legs_that_do_not_reach_are_named():
    glide = guided.build_hexaglide(home_position=None)
    short = glide.leg_lengths * np.array([1, 1, 1, 1, 0.6, 1])
    assert "leg 5 of" in refuse(replace(glide, leg_lengths=short))
    stated = replace(glide, leg_lengths=0.5 * glide.leg_lengths, home_position=(0.0, 0.0, 420.0))
    assert re.search(r"\(leg \d .* 0, 0, 420 mm\)", refuse(stated))


def test_a_leg_at_right_angles_to_its_guide_leaves_the_other_poses_alone():
    """No step of the carriage shortens it: that pose is out of reach, as one is whose legs are too short."""
    machine = machines.build_machine("none", guided.build_hexaglide())
    theta, home = machine.layout.nominal, np.array(machine.mechanism.home_position)
    position = np.stack([home, home])
    position[1, 0] = -380.0 - 40.0  # the first carriage's place less that of its joint on the platform
    position[1, 2] += 600.0
    rotation = np.tile(np.eye(3), (2, 1, 1))
    found = solve_inverse_kinematics(machine, theta, position, rotation, check=False)
    assert found.converged.tolist() == [True, False]
    with pytest.raises(NumericalError, match=r"leg \d .*pose 2 of 2"):
        solve_inverse_kinematics(machine, theta, position, rotation)
