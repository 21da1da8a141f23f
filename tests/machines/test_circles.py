"""Directions as gain and azimuth about the leg: slopes and area, and straight ridges; see `density.test_posterior`."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.machines.rings import find_circles
from bayescal.numerics.geometry import matrix_from_rotation_vector

LEGS = np.array([[0.2, 0.05, 1.0], [-0.1, 0.3, 1.0], [0.4, -0.4, 1.0]])
UP = np.array([[0.0, 0.0, 1.0], [0.02, -0.03, np.sqrt(1 - 0.0013)], [0.0, 0.1, np.sqrt(0.99)]])


@pytest.fixture
def circles():
    """Return the circles of three legs."""
    clear, found = find_circles(UP, LEGS, np.full(3, 0.03))
    assert clear.all()
    return found


def directions_near(rng, n):
    """Return unit vectors (n, 3, 3) near the three nominal ones."""
    turned = matrix_from_rotation_vector(0.1 * rng.standard_normal((n, 3, 3))) @ UP[..., None]
    return turned[..., 0]


def test_slopes_and_area(circles, rng):
    u = directions_near(rng, 1)[0]
    w, psi = circles.polar(u)
    by_w, by_psi = circles.slopes(u)
    step = 1e-6
    for found, (dw, dpsi) in ((by_w, (step, 0.0)), (by_psi, (0.0, step))):
        high, low = (np.stack(circles.directions(w + s * dw, psi + s * dpsi), axis=-1) for s in (1, -1))
        np.testing.assert_allclose(found, (high - low) / (2 * step), rtol=1e-6, atol=1e-8)
    area = by_w[:, 0] * by_psi[:, 1] - by_w[:, 1] * by_psi[:, 0]
    np.testing.assert_allclose(np.abs(area), u[:, 2], rtol=1e-12)


def test_leg_close_to_its_direction_has_no_circle():
    clear, found = find_circles(UP, LEGS, np.array([0.03, 0.2, 0.03]))
    np.testing.assert_array_equal(clear, [True, False, True])
    assert len(found.gain) == 2


def test_posterior_along_a_circle_is_that_of_the_prior(rng):
    """Moving a direction around its leg with its joint in place changes the likelihood by next to nothing."""
    machine = machines.build_machine("none")
    poses = machines.simulate_poses(machine, machine.layout.nominal, machines.table_3_actuators(), np.zeros(6), rng)
    symbols = ("a_x", "a_y", "a_z", "b_x", "b_y", "l", "u_x", "u_y")
    posterior = machines.build_posterior("none", poses, symbols=symbols)
    azimuth = posterior.names.index("u_y[2]")
    gain = posterior.names.index("u_x[2]")

    def change(k, distance):
        y = np.zeros((2, posterior.n_parameters))
        y[1, k] = distance
        low, high = posterior.likelihood.density(*posterior.at(y))
        return abs(high - low)

    assert change(azimuth, 1.0) < 1.0
    assert change(gain, 1.0) > 500.0
