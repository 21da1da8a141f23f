"""Places that data see on either side of a line: all of them are found, whatever the draws of the prior are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import studies
from scipy.optimize import least_squares
from test_loose import Arc

from bayescal.inference.mode import find_modes

X, NOISE = np.linspace(-75.0, 75.0, 24), 0.02
TRUE, EXPECTED, TOLERANCE = np.array([9.3, -7.7]), np.array([3.0, -2.0]), 8.0


@dataclass(frozen=True, eq=False)
class Posts(Arc):
    """Distances from a line to two posts beside it."""

    @property
    def n_parameters(self) -> int:
        return 2

    def residual(self, y):
        beside = EXPECTED + TOLERANCE * y[..., None, :]
        away = np.sqrt(X[:, None] ** 2 + beside**2) - np.sqrt(X[:, None] ** 2 + TRUE**2)
        return np.concatenate([(away / NOISE).reshape(*y.shape[:-1], -1), y], axis=-1)

    def gradient(self, y):
        steps = 1e-6 * np.eye(2)
        rows = ((self.residual(y + steps) - self.residual(y - steps)) / 2e-6).T
        return -rows.T @ self.residual(y), -rows.T @ rows

    def refine_geometry(self, y):
        return least_squares(self.residual, y, xtol=1e-12).x


@pytest.mark.parametrize("seed", range(6))
def test_both_sides_of_both_posts_are_found(seed):
    found = find_modes(Posts(None), np.random.default_rng(seed))
    beside = np.array([EXPECTED + TOLERANCE * mode.y for mode in found])
    assert sorted(map(tuple, np.sign(beside))) == [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)]
    np.testing.assert_allclose(np.abs(beside), np.tile(np.abs(TRUE), (4, 1)), atol=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_a_side_whose_distance_is_judged_too_large_is_found(seed, pytestconfig):
    """At 2.4 prior sds; it was judged to be at 6.5, and found only where a draw of the prior led there."""
    path = pytestconfig.rootpath / "tests/cases/external_as_integer/study.toml"
    posterior = studies.load_study(path).variants["all"].posterior().with_pose_guesses()
    found = find_modes(posterior, np.random.default_rng(seed))
    assert sorted(np.sign(posterior.natural(mode.y)[1]) for mode in found) == [-1.0, 1.0]
