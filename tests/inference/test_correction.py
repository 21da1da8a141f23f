"""Moved draws of one density for draws of another: normals whose evidences are known, two modes, and what must fail."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from bayescal.errors import NumericalError
from bayescal.inference.correction import CostlyDensity, correct

N = 6


def log_normal(mean, covariance, log_mass=0.0):
    """Return the log-density of a normal of a given mass."""
    return lambda x: multivariate_normal(mean, covariance).logpdf(np.atleast_2d(x)).reshape(-1) + log_mass


def draw_covariance(rng):
    """Return a covariance of N numbers of unlike sizes."""
    root = rng.standard_normal((N, N)) * np.geomspace(0.1, 3.0, N)[:, None]
    return root @ root.T + 0.01 * np.eye(N)


def build_normals(rng, log_mass):
    """Return two normals, the second with half a standard deviation more in some directions, and moved by one."""
    covariance = draw_covariance(rng)
    factor = np.linalg.cholesky(covariance)
    stretch = np.diag([1.5, 0.7, 1.0, 1.3, 0.8, 1.0])
    mean = factor @ rng.normal(0, 1.0, N)
    other = factor @ stretch @ stretch @ factor.T
    first, second = log_normal(np.zeros(N), covariance), log_normal(mean, other, log_mass)
    more = np.linalg.inv(other) - np.linalg.inv(covariance)
    return covariance, mean, other, CostlyDensity(first, lambda x: second(x) - first(x), more)


def test_a_normal_becomes_the_other_one():
    """The map between normals is exact: all weights are the ratio of the masses."""
    rng = np.random.default_rng(1)
    covariance, mean, other, density = build_normals(rng, 3.5)
    draws = rng.multivariate_normal(np.zeros(N), covariance, 1000)
    draws -= draws.mean(axis=0)
    found = correct(density, draws, np.zeros(1000, dtype=int), covariance, 200)
    assert found.log_ratio == pytest.approx(3.5, abs=1e-6)
    assert found.efficiency == pytest.approx(1.0, abs=1e-6)
    assert found.is_trusted
    moved = found.move(draws)
    standard = np.linalg.solve(np.linalg.cholesky(other), (moved - mean).T)
    assert np.abs(standard.mean(axis=1)).max() < 5 / np.sqrt(1000)
    np.testing.assert_allclose(np.cov(standard), np.eye(N), atol=0.25)


def test_without_the_move_the_weights_are_poor():
    """Negative control: what the move is for."""
    rng = np.random.default_rng(1)
    covariance, _, _, density = build_normals(rng, 3.5)
    draws = rng.multivariate_normal(np.zeros(N), covariance, 1000)
    weights = np.exp(density.excess(draws) - density.excess(draws).max())
    assert weights.sum() ** 2 / (weights**2).sum() < 0.1 * len(draws)


def repeat_light_tails(strength, n_times, n_draws, *effort):
    """Return corrections of a density that no affine map makes, and their errors in standard errors."""
    rng, found = np.random.default_rng(2), []
    line = np.linspace(-10, 10, 2001)
    truth = 2 * np.log(np.trapezoid(norm.pdf(line) * np.exp(-strength * line**4), line))
    density = CostlyDensity(
        log_normal(np.zeros(2), np.eye(2)), lambda x: -strength * (x**4).sum(axis=-1), np.zeros((2, 2))
    )
    for _ in range(n_times):
        draws = rng.standard_normal((n_draws, 2))
        found.append(correct(density, draws, np.zeros(n_draws, int), np.eye(2), *effort))
    return found, [(one.log_ratio - truth) / one.standard_error for one in found]


def test_errors_are_those_claimed():
    """Over many repetitions z scores are of unit size."""
    _, z = repeat_light_tails(0.05, 60, 800, 250)
    assert abs(np.mean(z)) < 4 / np.sqrt(60)
    assert 0.7 < np.std(z) < 1.3


def test_errors_are_those_claimed_where_the_error_ends_it():
    """Fewer draws, whose scatter says when they are enough: errors are still those claimed, about as large as asked."""
    found, z = repeat_light_tails(0.005, 200, 400, 128, 2, 0.01)
    assert all(one.standard_error <= 0.01 or one.n_draws == 128 for one in found)
    assert len({one.n_draws for one in found}) > 1
    assert abs(np.mean(z)) < 4 / np.sqrt(200) + 0.3
    assert 0.7 < np.std(z) < 1.5


def test_two_modes_move_together():
    """Modes far apart, moved alike: their distance has no part in slope or covariance."""
    rng = np.random.default_rng(3)
    covariance = draw_covariance(rng)
    factor = np.linalg.cholesky(covariance)
    gap, shift = 40 * factor[:, 0], factor @ rng.normal(0, 0.7, N)
    first = [log_normal(centre, covariance, np.log(0.5)) for centre in (np.zeros(N), gap)]
    second = [log_normal(centre + shift, covariance, np.log(0.5) - 2.0) for centre in (np.zeros(N), gap)]

    def explored(x):
        return np.logaddexp(*(part(x) for part in first))

    def excess(x):
        return np.logaddexp(*(part(x) for part in second)) - explored(x)

    modes = rng.integers(0, 2, 900)
    draws = rng.multivariate_normal(np.zeros(N), covariance, 900)
    draws += modes[:, None] * gap
    found = correct(CostlyDensity(explored, excess, np.zeros((N, N))), draws, modes, covariance, 200)
    assert found.log_ratio == pytest.approx(-2.0, abs=2e-3)
    assert found.efficiency == pytest.approx(1.0, abs=1e-3)


def test_a_density_elsewhere_is_not_trusted():
    """The other density lives on a thin shell around the first one."""
    rng = np.random.default_rng(4)
    explored = log_normal(np.zeros(N), np.eye(N))

    def excess(x):
        return -0.5 * ((np.linalg.norm(x, axis=-1) - 6.0) / 0.02) ** 2 - explored(x)

    draws = rng.standard_normal((900, N))
    found = correct(CostlyDensity(explored, excess, np.zeros((N, N))), draws, np.zeros(900, int), np.eye(N), 200)
    assert not found.is_trusted


def test_no_density_at_all_is_an_error():
    explored = log_normal(np.zeros(N), np.eye(N))
    density = CostlyDensity(explored, lambda x: np.full(len(x), -np.inf), np.zeros((N, N)))
    draws = np.random.default_rng(5).standard_normal((600, N))
    with pytest.raises(NumericalError, match="finite weight"):
        correct(density, draws, np.zeros(600, int), np.eye(N), 200)
