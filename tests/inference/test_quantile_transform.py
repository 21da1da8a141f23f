"""Coordinates bent to normal ones: against quantiles in closed form, and against differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import gumbel_r, norm, t

from bayescal.inference.quantile_transform import Quantiles, QuantileTransform, find_quantiles


def two_peaks():
    """Return places, log-density and cumulative distribution of two peaks with a valley of one nat between them."""
    along = np.linspace(-5.0, 9.0, 60)
    parts = norm(0.0, 1.0), norm(3.0, 1.3)
    log_density = np.logaddexp(np.log(0.7) + parts[0].logpdf(along), np.log(0.3) + parts[1].logpdf(along))
    return along, log_density, lambda u: 0.7 * parts[0].cdf(u) + 0.3 * parts[1].cdf(u)


def of(distribution, low, high):
    """Return places, log-density up to a constant and cumulative distribution."""
    along = np.linspace(low, high, 30)
    return along, distribution.logpdf(along) + 7.0, distribution.cdf


@pytest.mark.parametrize(
    "case",
    [of(norm(2.0, 0.1), 1.6, 2.4), of(gumbel_r(0.3, 2.0), -4.0, 17.0), of(t(6), -6.0, 6.0), two_peaks()],
    ids=["normal", "Gumbel", "Student", "two peaks"],
)
def test_the_map_takes_quantiles_to_those_of_a_standard_normal(case):
    along, log_density, distribution = case
    values, slopes = find_quantiles(along, log_density)
    eta = np.linspace(-2.5, 2.5, 401)[:, None]
    u, slope = Quantiles(values[None], slopes[None]).forward(eta)
    np.testing.assert_allclose(distribution(u[:, 0]), norm.cdf(eta[:, 0]), atol=2e-3)
    np.testing.assert_allclose(slope[1:-1], np.gradient(u[:, 0], eta[:, 0])[1:-1, None], rtol=5e-3)


def test_a_log_density_that_does_not_fall_where_it_ends_is_made_to():
    along = np.linspace(0.0, 1.0, 9)
    values, slopes = find_quantiles(along, np.zeros(9))
    assert np.isfinite(values).all()
    assert (np.diff(values) > 0).all()
    assert (slopes > 0).all()


@pytest.fixture
def skew():
    """Return a skew of coordinates 3 and 1 of five, which 0 and 4 follow."""
    found = [find_quantiles(*case[:2]) for case in (of(gumbel_r(0.3, 2.0), -4.0, 17.0), of(t(6), -6.0, 6.0))]
    quantiles = Quantiles(*(np.stack(one) for one in zip(*found, strict=True)))
    lean = np.array([[0.4, 0.0, 0.0, 1.0, 2.0], [-1.0, 1.0, 0.0, 0.0, 0.1]])
    return QuantileTransform(np.array([3, 1]), np.array([0.9, -0.2]), quantiles, lean)


def test_there_and_back(skew):
    v = np.random.default_rng(1).normal(0.0, 6.0, (500, 5))
    w = v.copy()
    skew.forward(w)
    assert np.abs(w - v).max() > 1.0
    np.testing.assert_array_equal(w[:, 2], v[:, 2])
    skew.inverse(w)
    np.testing.assert_allclose(w, v, atol=1e-9)


def test_the_mode_stays_where_it_is_with_its_surroundings(skew):
    """The identity at the origin, slope included."""
    v = np.full((1, 5), 0.3)
    v[0, skew.bases] = skew.origin
    w = v.copy()
    assert skew.forward(w)[0] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(w, v, atol=1e-9)
    sides = v + 1e-5 * np.concatenate([np.eye(5), -np.eye(5)])
    skew.forward(sides)
    np.testing.assert_allclose((sides[:5] - sides[5:]) / 2e-5, np.eye(5), atol=1e-8)


def test_volumes_are_those_of_differences(skew):
    v = np.random.default_rng(2).normal(0.5, 1.5, (5, 5))
    step = 1e-6
    for one in v:
        ends = one + np.concatenate([step * np.eye(5), -step * np.eye(5), np.zeros((1, 5))])
        gain = skew.forward(ends)[-1]
        numeric = ((ends[:5] - ends[5:10]) / (2 * step)).T
        assert gain == pytest.approx(np.log(np.linalg.det(numeric)), abs=1e-6)
