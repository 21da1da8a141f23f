"""The beam model against RR-8096's equations (10) to (17) solved numerically, and the one solution that it has.

The end of a bent flexure against quadrature of eq. (11), and the circle of eq. (13) against both.
"""

import numpy as np
import pytest
import studies
import telescope_machines as machines
from scipy.optimize import brentq

from bayescal.machines.kinematics import check_home_pose, solve_forward_kinematics
from bayescal.machines.models.beam import (
    CIRCLE,
    PIVOT,
    SERIES_BELOW,
    compute_beam_shift,
    compute_circle_shift,
    compute_shift,
)

REACH = 3.0  # mm, more than twice the actuator range
HALVED_TWICE = 16.0  # a term of the fourth power when the angle is halved


@pytest.fixture(scope="module")
def configurations():
    """Return the actuator positions of tables 3 and 4, shape (46, 6), mm."""
    file = studies.TELESCOPE / "verification_configurations.csv"
    table_4 = np.array([row.split(",")[-6:] for row in file.read_text().splitlines()[2:]], dtype=float)
    assert table_4.shape == (6, 6)
    return np.concatenate([machines.table_3_actuators(), machines.INITIAL_POSITION + machines.ACTUATOR_RANGE * table_4])


# --- one flexure -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("beta", [0.01, 0.1, 0.25, 0.4, 0.49])
@pytest.mark.parametrize("angle", [0.0, 0.02, 0.5, 2.0, np.pi])
def test_shift_is_the_positive_root_of_equation_15(beta, angle):
    l_b, cosine = 10.0, np.cos(angle)
    coefficients = [1.0, (1 - 2 * beta) * l_b * cosine, (beta - 0.75) * l_b**2]
    roots = np.roots(coefficients)
    assert (roots > 0).tolist().count(True) == 1  # the product of the roots is negative
    expected = brentq(lambda x: np.polyval(coefficients, x), 0.0, 10 * l_b, xtol=1e-14, rtol=1e-15)
    found = compute_shift(np.array(cosine), np.array(l_b), np.array(beta))
    assert found == pytest.approx(expected, rel=1e-12)
    assert found == pytest.approx(roots.max(), rel=1e-9)


def end_of_flexure(l_b, beta, angle):
    """Return where the model's flexure ends, along the undeformed flexure from its end backwards, and across."""
    shift = compute_shift(np.cos(angle), np.array(l_b), np.array(beta))
    return 0.5 * l_b - shift * np.cos(angle), shift * np.sin(angle)


def test_model_ends_where_beam_theory_does():
    """With β = 1/4 a flexure's end is off by the fourth power of its angle, with an ideal pivot by the second."""
    l_b, angles = 10.0, np.radians([4.0, 2.0, 1.0])
    misfit = {}
    for beta in (0.25, 0.4999999):
        along, across = end_of_flexure(l_b, beta, angles)
        misfit[beta] = along - compute_beam_shift(2 * across / l_b, l_b)[0]
    quarter, pivot = misfit.values()
    np.testing.assert_allclose(quarter[:-1] / quarter[1:], HALVED_TWICE, rtol=0.05)
    np.testing.assert_allclose(pivot[:-1] / pivot[1:], 4.0, rtol=0.05)
    assert np.abs(quarter).max() < 0.01 * np.abs(pivot).max()


# --- a machine -------------------------------------------------------------------------------------------------------


def close_by_hand(theta, layout, leg, home, position, rotation, rho):
    """Return f of eq. (32) for one leg without deformation, every Δl the root of its quadratic equation."""
    value = {symbol: theta[layout.index[symbol][leg]] for symbol in layout.symbols}
    u = np.array([value["u_x"], value["u_y"], np.sqrt(1 - value["u_x"] ** 2 - value["u_y"] ** 2)])
    a, b = (np.array([value[f"{point}_{axis}"] for axis in "xyz"]) for point in "ab")
    g = position + rotation @ b - a - rho * u
    start = home.position + home.rotation @ b - a - value["rho0"] * u
    z, z0 = g / np.linalg.norm(g), start / np.linalg.norm(start)
    l_b, beta = value["l_b"], value["beta"]
    shifts = [
        np.roots([1.0, (1 - 2 * beta) * l_b * (z @ other), (beta - 0.75) * l_b**2]).max()
        for other in (z0, rotation @ home.rotation.T @ z0)
    ]
    return value["l"] - l_b + sum(shifts) - np.linalg.norm(g)


def test_closure_is_equation_32(rng):
    """With every parameter off nominal; the home pose by forward kinematics of the 6-PUS."""
    mechanism = machines.build_random_mechanism(6, seed=5)
    machine, perfect = (machines.build_machine("none", mechanism, model) for model in ("beam", "six_pus"))
    layout = machine.layout
    theta = layout.nominal + machines.spread_of(layout) * rng.standard_normal(layout.size)
    assert layout.inside(theta)
    nominal = mechanism.initial_actuator_positions
    home = solve_forward_kinematics(perfect, theta[: perfect.layout.size], nominal)
    offset = layout.take(theta, "rho0") - nominal  # actuators are read from the nominal initial position
    position = home.position + rng.uniform(-3, 3, (4, 3))
    rotation = machines.matrix_from_rotation_vector(rng.uniform(-0.1, 0.1, (4, 3)))
    actuators = nominal + rng.uniform(-2, 2, (4, 6))
    found = machine.linearise(theta, position, rotation, actuators).residual
    expected = [
        [close_by_hand(theta, layout, leg, home, p, r, rho[leg] + offset[leg]) for leg in range(6)]
        for p, r, rho in zip(position, rotation, actuators, strict=True)
    ]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


def test_machine_is_the_6_pus_at_home_and_not_elsewhere(configurations):
    beam, perfect = (machines.build_machine("none", model=model) for model in ("beam", "six_pus"))
    home = check_home_pose(beam)
    np.testing.assert_allclose(home.position, check_home_pose(perfect).position, atol=1e-10)
    poses = [solve_forward_kinematics(m, m.layout.nominal, configurations) for m in (beam, perfect)]
    difference = np.linalg.norm(poses[0].position - poses[1].position, axis=1)
    assert 0.1e-3 < difference.max() < 5e-3


def test_every_leg_has_one_actuator_position(configurations):
    """f falls or rises all the way over ±3 mm about each of the 46 configurations, so that it vanishes once."""
    machine = machines.build_machine("none", model="beam")
    theta, grid = machine.layout.nominal, np.linspace(-REACH, REACH, 301)
    pose = solve_forward_kinematics(machine, theta, configurations)
    rho = machines.INITIAL_POSITION + np.broadcast_to(grid[:, None, None], (len(grid), 46, 6))
    here = machine.linearise(theta, pose.position, pose.rotation, rho)  # without K a leg's f knows its own ρ only
    slope = np.diagonal(here.actuators, axis1=-2, axis2=-1)
    assert slope.min() > 0.9  # u · z is 0.99
    np.testing.assert_array_equal(here.actuators * (1 - np.eye(6)), 0.0)
    assert np.all(np.diff(here.residual, axis=0) > 0)
    crossings = (np.diff(np.sign(here.residual), axis=0) != 0).sum(axis=0)
    # a root on the grid counts in both neighbouring steps
    np.testing.assert_array_equal(crossings - (here.residual == 0).sum(axis=0), 1)


LENGTH = 10.0
ANGLES = np.array([1e-9, 1e-4, np.radians(0.5), np.radians(1.0), 0.999 * SERIES_BELOW, 1.001 * SERIES_BELOW, 0.3])


def integrate_shift(angle: float) -> float:
    """Return Δx of eq. (11) by Gauss-Legendre quadrature of sqrt(1 + t²) - 1, written without cancellation."""
    node, weight = np.polynomial.legendre.leggauss(40)
    square = (angle * 0.5 * (node + 1.0)) ** 2
    return LENGTH * float(np.sum(0.5 * weight * square / (1.0 + np.sqrt(1.0 + square))))


def test_beam_shift_is_the_integral():
    along, across = compute_beam_shift(ANGLES, LENGTH)
    np.testing.assert_allclose(along, [integrate_shift(a) for a in ANGLES], rtol=1e-12)
    np.testing.assert_allclose(across, LENGTH * ANGLES / 2, rtol=1e-15)


def test_straight_flexure_and_both_signs():
    along, across = compute_beam_shift(np.array([0.0, 0.01, -0.01, 0.2, -0.2]), LENGTH)
    assert along[0] == across[0] == 0.0
    assert along[1] == along[2] > 0
    np.testing.assert_allclose(along[3], along[4], rtol=1e-15)


def test_circle_point_lies_on_the_circle():
    across = np.array([0.0, 1e-6, 0.1, 2.0])
    along = compute_circle_shift(across, 7.5)
    np.testing.assert_allclose((along - 7.5) ** 2 + across**2, 7.5**2, rtol=1e-15)


@pytest.mark.parametrize(("share", "order"), [(CIRCLE, 4), (PIVOT, 2)])
def test_circle_is_right_to_fourth_order_and_the_pivot_to_second(share, order):
    """Halving the angle divides the error by 2^order."""
    along, across = compute_beam_shift(np.array([0.2, 0.1]), LENGTH)
    error = compute_circle_shift(across, share * LENGTH) - along
    assert np.log2(error[0] / error[1]) == pytest.approx(order, abs=0.1)
