"""Curved ridges traced to their ends: against ridges that are known, and what a proposal gains."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from test_tempered_battery import CASES

from bayescal.inference.exploration import integrate_posterior
from bayescal.inference.importance import estimate_by_importance
from bayescal.inference.mode import Mode
from bayescal.inference.peaks import GaussianMode, proposal_from_peaks, refine_peak
from bayescal.inference.reparameterisation import Reparameterisation
from bayescal.inference.ridges import trace_ridges
from bayescal.inference.schema import EvidenceConfig

WIDTH = 0.05  # of the ridge, across
CURVE = Polynomial([0.3, 0.5, 0.4, -0.7])


class Bent:
    """A density along u = y[0], by its log and slopes, whose y[1] is N(CURVE(u), WIDTH²); unnormalised."""

    n_parameters = n_geometry = 2

    def __init__(self, along):
        """Take the log-density along u, a function with two derivatives."""
        self.along = along

    def log_density(self, y):
        """Return the log-density (B,)."""
        return self.along(y[:, 0]) - 0.5 * ((y[:, 1] - CURVE(y[:, 0])) / WIDTH) ** 2

    def gradient(self, y):
        """Return gradient and Hessian at y."""
        off, slope, bend = y[1] - CURVE(y[0]), CURVE.deriv()(y[0]), CURVE.deriv(2)(y[0])
        gradient = np.array([self.along.deriv()(y[0]) + off * slope / WIDTH**2, -off / WIDTH**2])
        corner = self.along.deriv(2)(y[0]) + (off * bend - slope**2) / WIDTH**2
        return gradient, np.array([[corner, slope / WIDTH**2], [slope / WIDTH**2, -1 / WIDTH**2]])

    def curved_ridges(self):
        """Return the one ridge."""
        return [(0, np.array([1]))]


def make_mode(bent, u):
    """Return the mode of the ridge at u."""
    y = np.array([u, CURVE(u)])
    return Mode(y, float(bent.log_density(y[None])[0]), np.linalg.inv(-bent.gradient(y)[1]), True)


def straighten(bent, modes):
    """Return the traced straightening."""
    plain = Reparameterisation(bent, modes[0].y, (), np.empty(0), np.empty(0))
    return trace_ridges(plain, modes)


def find_peak(straight, mode):
    """Return the Gaussian of a mode that straight coordinates leave where it is."""
    return GaussianMode(mode.y, np.linalg.cholesky(straight.carry(mode.y, mode.covariance)), mode.log_density)


def weigh(straight, peaks, rng, n_draws=4000, dof=50.0):
    """Return the evidence by draws of a proposal of peaks."""
    return estimate_by_importance(straight.log_density, proposal_from_peaks(peaks, dof), rng, n_draws)


def ends(ridges):
    """Return where the only ridge begins and ends."""
    return ridges.centres[0] - ridges.halves[0], ridges.centres[0] + ridges.halves[0]


@pytest.fixture
def single():
    """Return a ridge of standard normal density along it, and its mode."""
    bent = Bent(Polynomial([0.0, 0.0, -0.5]))
    return bent, make_mode(bent, 0.0)


def test_a_ridge_is_traced_as_far_as_it_goes(single):
    bent, mode = single
    ridges = straighten(bent, [mode]).ridges
    assert ends(ridges)[0] < -3.9
    assert ends(ridges)[1] > 3.9
    w = np.stack([np.linspace(-4.0, 4.0, 41), np.zeros(41)], axis=1)
    ridges.add_to(w, 1.0)
    np.testing.assert_allclose(w[:, 1], CURVE(w[:, 0]) - 0.3 - 0.5 * w[:, 0], atol=2e-3)
    sides = mode.y + np.array([[1e-4, 0.0], [-1e-4, 0.0]])
    ridges.add_to(sides, 1.0)
    np.testing.assert_allclose(np.diff(sides[:, 1]) / 2e-4, 0.0, atol=1e-5)


def test_straight_coordinates_are_a_bijection_beyond_the_ends_too(single):
    straight = straighten(*[single[0], [single[1]]])
    x = np.random.default_rng(1).normal(0.0, 4.0, (200, 2))
    np.testing.assert_allclose(straight.x_from_y(straight.y_from_x(x)), x, atol=1e-9)


def test_one_gaussian_is_the_posterior_along_a_traced_ridge(single):
    """It is one exactly: ∫ = 2 π WIDTH, every draw counts."""
    bent, mode = single
    straight = straighten(bent, [mode])
    found = weigh(straight, [find_peak(straight, mode)], np.random.default_rng(2))
    assert found.log_evidence == pytest.approx(np.log(2 * np.pi * WIDTH), abs=4 * found.standard_error + 1e-3)
    assert found.efficiency > 0.9


def test_modes_one_after_the_other_share_a_spline():
    """Two normal peaks along the ridge, of log-density -(u² - 4)² / 8 each side, too deep a valley between them."""
    bent = Bent(Polynomial([-32.0, 0.0, 16.0, 0.0, -2.0]))
    modes = [make_mode(bent, 2.0), make_mode(bent, -2.0)]
    straight = straighten(bent, modes)
    assert ends(straight.ridges)[0] < -2.0 < 2.0 < ends(straight.ridges)[1]
    peaks = [replace(find_peak(straight, one), centre=straight.x_from_y(one.y[None])[0]) for one in modes]
    along = np.linspace(-4.0, 4.0, 4001)
    expected = np.log(np.trapezoid(np.exp(bent.along(along)), along) * np.sqrt(2 * np.pi) * WIDTH)
    found = weigh(straight, peaks, np.random.default_rng(3), 8000, 10.0)
    assert found.log_evidence == pytest.approx(expected, abs=4 * found.standard_error + 1e-3)
    assert found.efficiency > 0.7


def test_of_modes_beside_each_other_the_best_one_leads(single):
    bent, mode = single
    beside = Mode(mode.y + np.array([0.0, 40 * WIDTH]), mode.log_density, mode.covariance, True)
    own, both = (straighten(bent, modes).ridges for modes in ([mode], [mode, beside]))
    np.testing.assert_array_equal(both.series, own.series)


class Tailed:
    """The log-density -(u + e^-u) along a ridge: its mode at 0, a long tail upwards."""

    def __call__(self, u):
        """Return the log-density."""
        return -(u + np.exp(-u))

    def deriv(self, order=1):
        """Return the first or second derivative."""
        return (lambda u: np.exp(-u) - 1.0) if order == 1 else (lambda u: -np.exp(-u))


def test_a_tail_along_a_ridge_is_one_no_more():
    """It has mass √(2 π) WIDTH exactly; a Gaussian in coordinates without the skew leads there seldom."""
    bent = Bent(Tailed())
    mode = make_mode(bent, 0.0)
    straight = straighten(bent, [mode])
    assert straight.skew is not None
    rng, mass = np.random.default_rng(4), np.log(np.sqrt(2 * np.pi) * WIDTH)
    ways = (straight, replace(straight, skew=None))
    found = [weigh(one, [refine_peak(one.log_density, find_peak(one, mode))], rng) for one in ways]
    assert found[0].log_evidence == pytest.approx(mass, abs=4 * found[0].standard_error + 2e-3)
    assert found[0].efficiency > 0.9
    assert found[1].efficiency < 0.7
    x = np.random.default_rng(5).normal(0.0, 4.0, (200, 2))
    np.testing.assert_allclose(straight.x_from_y(straight.y_from_x(x)), x, atol=1e-9)


def test_a_ridge_that_ends_at_once_is_none(single):
    bent, mode = single
    cut = SimpleNamespace(
        gradient=bent.gradient,
        curved_ridges=bent.curved_ridges,
        log_density=lambda y: np.where(y[:, 0] <= 0.0, bent.log_density(y), -np.inf),
    )
    assert straighten(cut, [mode]).ridges is None


def test_a_coordinate_that_nothing_follows_is_bent_alone():
    along = Tailed()
    lone = SimpleNamespace(
        n_parameters=1,
        n_geometry=1,
        log_density=lambda y: along(y[:, 0]),
        curved_ridges=lambda: [(0, np.array([], int))],
    )
    straight = straighten(lone, [Mode(np.zeros(1), -1.0, np.eye(1), True)])
    peak = refine_peak(straight.log_density, GaussianMode(np.zeros(1), np.eye(1), 0.0))
    found = weigh(straight, [peak], np.random.default_rng(6))
    assert found.log_evidence == pytest.approx(0.0, abs=4 * found.standard_error + 2e-3)
    assert found.efficiency > 0.9


def test_a_ridge_that_turns_fast_is_followed_by_shorter_steps():
    """Whole steps ended half a nat below the mode; of a proposal that knew no more of it 22 % of the draws counted."""
    posterior = CASES["mirror of u_y between bounds"].posterior()
    seeds = (np.random.SeedSequence(seed) for seed in (3, 5))
    _, importance = integrate_posterior(posterior, *seeds, 128, EvidenceConfig())
    assert importance.efficiency > 0.7
