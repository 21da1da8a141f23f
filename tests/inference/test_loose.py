"""What data hold follows what they leave loose on an arc: a shear of unit volume makes it straight."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from bayescal.inference.exploration import explore
from bayescal.inference.loose import MOST_LOOSE, fit_loose_shear
from bayescal.inference.mode import find_modes
from bayescal.inference.reparameterisation import straighten

HELD = 1e-4  # prior standard deviations that data leave of what they hold


@dataclass(frozen=True, eq=False)
class Arc:
    """Places, each of which data hold at a quadratic of turns that they do not see at all."""

    bent: np.ndarray  # (k, u, u): how far each of k places goes, in its own posterior standard deviations

    @property
    def n_parameters(self) -> int:
        return sum(self.bent.shape[:2])

    @property
    def n_geometry(self) -> int:
        return self.n_parameters

    def residual(self, y):
        k = len(self.bent)
        place, turn = y[..., :k], y[..., k:]
        seen = place / HELD - np.einsum("kij,...i,...j->...k", self.bent, turn, turn)
        return np.concatenate([seen, y], axis=-1)

    def log_density(self, y):
        return -0.5 * (self.residual(y) ** 2).sum(axis=-1)

    def gradient(self, y):
        k = len(self.bent)
        rows = np.concatenate([np.zeros((k, self.n_parameters)), np.eye(self.n_parameters)])
        rows[:k, :k], rows[:k, k:] = np.eye(k) / HELD, -2.0 * self.bent @ y[k:]
        return -rows.T @ self.residual(y), -rows.T @ rows

    def newton(self, y):
        return self.gradient(y)

    def draw_prior(self, n, rng):
        return rng.standard_normal((n, self.n_parameters))

    def least_squares_start(self):
        return np.zeros(self.n_parameters)

    def natural(self, y):
        return y

    def refine_geometry(self, y):
        return y

    def mode_candidates(self, y):
        return []

    def groups(self):
        return []

    def curved_ridges(self):
        return []

    def exact(self):
        return None

    def linear_geometry(self, y):
        return None

    def scale_dependence(self, y):
        return None


def bend(n_places, n_turns, seed=1, size=2.0):
    bent = size * np.random.default_rng(seed).standard_normal((n_places, n_turns, n_turns))
    return Arc(0.5 * (bent + np.swapaxes(bent, 1, 2)))


@pytest.fixture(scope="module")
def arc():
    return bend(4, 3)


def test_a_proposal_follows_the_arc_without_a_pilot(arc):
    found = explore(arc, np.random.SeedSequence(1), 64, max_pilots=0)
    assert found.efficiency > 0.8
    assert found.straight.loose is not None


def test_many_loose_directions_are_followed_all_at_once():
    found = explore(bend(5, 20, size=0.5), np.random.SeedSequence(1), 64, max_pilots=0)
    assert found.efficiency > 0.8
    assert found.straight.loose.bent.shape == (20 * 21 // 2, 5)


def test_shear_is_a_bijection_of_unit_volume(arc):
    mode = find_modes(arc)[0]
    straight = replace(straighten(arc, mode), loose=fit_loose_shear(arc, mode.y))
    y = np.random.default_rng(2).standard_normal((5, arc.n_parameters))
    x = straight.x_from_y(y)
    np.testing.assert_allclose(straight.y_from_x(x), y, atol=1e-12)
    assert np.abs(x - y).max() > HELD
    steps = 1e-6 * np.eye(arc.n_parameters)
    jacobian = (straight.y_from_x(x[0] + steps) - straight.y_from_x(x[0] - steps)) / 2e-6
    assert np.linalg.slogdet(jacobian)[1] == pytest.approx(0.0, abs=1e-4)


def test_all_is_straight_along_what_is_loose(arc):
    """In the straight coordinates a place far along the turns is no less probable than the prior has it."""
    mode = find_modes(arc)[0]
    straight = replace(straighten(arc, mode), loose=fit_loose_shear(arc, mode.y))
    x = np.zeros((1, arc.n_parameters))
    x[0, -3:] = [2.0, -2.0, 1.0]
    assert straight.log_density(x)[0] == pytest.approx(-4.5, abs=1e-3)
    assert arc.log_density(x)[0] < -20.0


def test_those_that_bend_most_are_followed_where_many_are_loose():
    arc = bend(2, MOST_LOOSE + 3, size=0.01)
    arc.bent[:, :2, :2] += 5.0
    shear = fit_loose_shear(arc, np.zeros(arc.n_parameters))
    assert shear.bent.shape == (MOST_LOOSE * (MOST_LOOSE + 1) // 2, arc.n_parameters - MOST_LOOSE)
    assert np.abs(shear.bent).max() > 4.0


def test_nothing_where_nothing_is_bent_loose_or_held():
    assert fit_loose_shear(bend(3, 2, size=1e-3), np.zeros(5)) is None
    assert fit_loose_shear(bend(0, 2), np.zeros(2)) is None
    assert fit_loose_shear(bend(3, 0), np.zeros(3)) is None


@dataclass(frozen=True, eq=False)
class Torn(Arc):
    """An arc that has no slope beyond a turn."""

    def gradient(self, y):
        slope, hessian = super().gradient(y)
        return (slope, hessian) if np.abs(y[len(self.bent) :]).max() < 0.5 else (np.nan * slope, np.nan * hessian)


def test_a_density_without_a_slope_on_the_way_is_not_followed_and_prints_nothing(capfd):
    arc = Torn(bend(4, 3).bent)
    assert fit_loose_shear(arc, np.zeros(arc.n_parameters)) is None
    assert capfd.readouterr() == ("", "")
