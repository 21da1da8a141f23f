"""Directions by quantiles of their prior along circles about the legs: a bijection of known volume, onto all of it.

Slopes and area of the circles themselves are those of coordinates; see `test_any_direction`.
"""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines
from scipy import stats

from bayescal.machines.rings import DirectionRing, find_circles, frame_circles

LEG = np.array([0.2, 0.05, 1.0])
UP = np.array([0.0, 0.0, 1.0])
PRIORS = {
    "narrow normal": ([0.0, 0.0], [0.04, 0.04], None),
    "wide normal": ([0.0, 0.0], [0.15, 0.2], None),
    "narrow uniform": ([0.0, 0.0], [0.02, 0.02], [0.03, 0.04]),
    "arcs": ([0.0, 0.0], [0.15, 0.15], [0.25, 0.15]),
    "all of the circle": ([0.1, 0.0], [0.25, 0.25], [0.5, 0.5]),
    "one bounded": ([0.0, 0.0], [0.1, 0.15], [np.inf, 0.25]),
}


@pytest.fixture(params=PRIORS.values(), ids=PRIORS.keys())
def ring(request):
    """Return the ring of a leg under one of the priors."""
    centre, sd, half = (np.array(np.inf if part is None else part, dtype=float) for part in request.param)
    centre, sd = np.array(centre), np.array(sd)
    direction = np.array([*centre, np.sqrt(1 - centre @ centre)])
    half = np.broadcast_to(half, 2)
    return DirectionRing(frame_circles(direction[None], LEG[None]), centre, sd, centre - half, centre + half)


def draw_prior(ring, n, rng):
    """Return draws of the prior that are directions, as unit vectors (B, 3)."""
    normal = ring.centre + ring.sd * rng.standard_normal((n, 2))
    bounded = np.isfinite(ring.lower)
    low, high = (np.where(bounded, part, 0.0) for part in (ring.lower, ring.upper))
    u = np.where(bounded, low + (high - low) * rng.random((n, 2)), normal)
    square = np.sum(u * u, axis=1)
    u = u[square < 1]
    return np.column_stack([u, np.sqrt(1 - np.sum(u * u, axis=1))])


def test_bijection(ring, rng):
    u = draw_prior(ring, 500, rng)
    y = ring.coordinates(u)
    there = np.isfinite(y).all(axis=1)  # a millionth at the ends of the tables is lost
    assert there.sum() >= 499
    y, u = y[there], u[there]
    np.testing.assert_allclose(ring.components(y), u[:, :2], rtol=0, atol=1e-9)


def test_all_of_the_prior_is_there(ring, rng):
    """The prior's mass over the coordinates, by draws of standard normals; and its own draws are close to these."""
    y = rng.standard_normal((20_000, 2))
    with np.errstate(invalid="ignore"):
        ratio = np.exp(ring.log_prior_ratio(y))
    ratio = np.where(np.isfinite(ratio), ratio, 0.0)
    u = draw_prior(ring, 20_000, rng)
    assert ratio.mean() == pytest.approx(len(u) / 20_000, abs=5 * ratio.std() / np.sqrt(20_000) + 1e-3)
    own = ring.coordinates(u[:2000])
    own = own[np.isfinite(own).all(axis=1)]
    assert len(own) >= 1998
    if np.isfinite(ring.lower).sum() == 1:
        return  # quantiles of a circle between bounds leave a normal prior to the density
    assert np.abs(own.mean(axis=0)).max() < 0.3
    np.testing.assert_allclose(own.std(axis=0), 1.0, atol=0.3)


def test_one_gain_for_all_azimuths(ring, rng):
    y = np.column_stack([np.full(50, 0.3), rng.standard_normal(50)])
    u = ring.components(y)
    gain = np.column_stack([u, np.sqrt(1 - np.sum(u * u, axis=1))]) @ LEG
    np.testing.assert_allclose(gain, gain[0], rtol=0, atol=1e-12)
    assert np.ptp(u, axis=0).max() > 0.02


def test_slopes_are_those_of_the_density(ring):
    """The volume is the determinant of the slopes, and the prior in the coordinates follows from it."""
    y = np.array([0.4, -0.3])
    slopes = ring.slopes(y)
    step = 1e-3
    moved = [ring.components(y + sign * step * np.eye(2)) for sign in (1, -1)]
    np.testing.assert_allclose(slopes, (moved[0] - moved[1]).T / (2 * step), rtol=1e-3, atol=1e-6)
    expected = ring.log_prior(ring.components(y[None]))[0] + np.linalg.slogdet(slopes)[1] - stats.norm.logpdf(y).sum()
    assert ring.log_prior_ratio(y[None])[0] == pytest.approx(expected, abs=1e-6)
    ahead, behind = (ring.log_prior_ratio(y[None] + s * np.array([1e-4, 0.0]))[0] for s in (1, -1))
    assert ring.log_prior_ratio_slope(y)[0] == pytest.approx((ahead - behind) / 2e-4, abs=1e-4)


def test_directions_outside_of_the_bounds_have_no_coordinates():
    half = np.full(2, 0.1)
    ring = DirectionRing(frame_circles(UP[None], LEG[None]), np.zeros(2), half / np.sqrt(3), -half, half)
    out = np.array([[0.12, 0.0, np.sqrt(1 - 0.0144)], [0.0, 0.0, 1.0]])
    assert np.isfinite(ring.coordinates(out)).all(axis=1).tolist() == [False, True]


# --- circles ---------------------------------------------------------------------------------------------------------


def test_leg_close_to_its_direction_has_no_circle():
    legs = np.array([[0.2, 0.05, 1.0], [-0.1, 0.3, 1.0], [0.4, -0.4, 1.0]])
    directions = np.array([[0.0, 0.0, 1.0], [0.02, -0.03, np.sqrt(1 - 0.0013)], [0.0, 0.1, np.sqrt(0.99)]])
    clear, found = find_circles(directions, legs, np.array([0.03, 0.2, 0.03]))
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
