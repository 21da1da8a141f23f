"""Priors and their coordinates against SciPy, and against differences.

The density of poses that were held back, of which each counts by itself.
"""

import numpy as np
import pytest
from scipy import stats

from bayescal.density.prediction import compute_elpd
from bayescal.density.priors import (
    OFF,
    HalfCauchyPrior,
    HalfNormalPrior,
    KernelScalePrior,
    LogNormalPrior,
    NormalPrior,
    SharePrior,
    UniformPrior,
)

CASES = {
    "normal": (NormalPrior(3.0, 0.2), stats.norm(3.0, 0.2)),
    "uniform": (UniformPrior(-1.0, 4.0), stats.uniform(-1.0, 5.0)),
    "half normal": (HalfNormalPrior(0.01), stats.halfnorm(scale=0.01)),
    "log-normal": (LogNormalPrior(1.5, 0.6), stats.lognorm(0.6, scale=1.5)),
    "share, few": (SharePrior(0.005), stats.beta(1.0, 199.0)),
    "share, many": (SharePrior(0.4), stats.beta(1.0, 1.5)),
}
ZETA, STEP = np.linspace(-6.0, 6.0, 121), 1e-5


@pytest.fixture(params=CASES.values(), ids=CASES)
def case(request):
    """Return a prior and what SciPy knows of it."""
    return request.param


def test_density_and_moments(case):
    prior, known = case
    values = np.concatenate([known.ppf(np.linspace(1e-6, 1.0 - 1e-6, 50)), [-2.0, 5.0] * np.isfinite(known.support())])
    values = values[values > 0.0] if isinstance(prior, LogNormalPrior) else values
    np.testing.assert_allclose(prior.log_density(values), known.logpdf(values), rtol=1e-11, atol=1e-12)
    assert prior.mean == pytest.approx(known.mean())
    assert prior.sd == pytest.approx(known.std())


def test_coordinates_are_standard_normal(case):
    prior, known = case
    expected = np.where(ZETA > 0.0, known.isf(stats.norm.sf(ZETA)), known.ppf(stats.norm.cdf(ZETA)))
    # the lower half of a half normal is exact only absolutely: 1/2 + p/2 is rounded
    np.testing.assert_allclose(prior.value(ZETA), expected, rtol=1e-9, atol=1e-15)
    assert np.all(np.diff(prior.value(ZETA)) > 0.0)
    inside = np.abs(ZETA) < 5.0
    np.testing.assert_allclose(prior.standardise(prior.value(ZETA[inside])), ZETA[inside], rtol=1e-6, atol=1e-8)
    drawn = prior.draw(4000, np.random.default_rng(1))
    assert stats.kstest(drawn, known.cdf).pvalue > 0.01


def test_slope_and_curvature(case):
    prior, zeta = case[0], np.linspace(-5.0, 5.0, 41)
    up, down = prior.value(zeta + STEP), prior.value(zeta - STEP)
    np.testing.assert_allclose(prior.slope(zeta), (up - down) / (2.0 * STEP), rtol=1e-5, atol=1e-9 * prior.sd)
    up, down = prior.slope(zeta + STEP), prior.slope(zeta - STEP)
    np.testing.assert_allclose(prior.curvature(zeta), (up - down) / (2.0 * STEP), rtol=1e-3, atol=1e-6 * prior.sd)


def test_a_model_error_has_no_end_far_up_and_is_none_far_down():
    low, high = HalfNormalPrior(2.0).value(np.array([-30.0, 12.0]))
    assert 0.0 <= low < 1e-100
    assert high == pytest.approx(stats.halfnorm.isf(stats.norm.sf(12.0), scale=2.0), rel=1e-9)


def test_a_scale_that_may_be_off():
    """Half of its mass at zero, the rest log-normal; its coordinate has a place for either."""
    prior, rng = KernelScalePrior(0.02, 0.3), np.random.default_rng(5)
    values = prior.value(np.concatenate([rng.standard_normal(100_000) + place for place in (0.0, OFF)]))
    for found in (values, prior.draw(200_000, rng)):
        assert (found == 0.0).mean() == pytest.approx(0.5, abs=5e-3)
        assert found.mean() == pytest.approx(prior.mean, rel=0.01)
        assert found.std() == pytest.approx(prior.sd, rel=0.01)
    grid = np.geomspace(1e-3, 0.2, 20_000)
    assert np.trapezoid(np.exp(prior.log_density(grid)), grid) == pytest.approx(0.5, abs=1e-3)
    assert prior.log_density(np.zeros(1)) == pytest.approx(-np.log(2.0))
    zeta = np.array([-1.0, 0.4, OFF])
    slope = (prior.value(zeta + STEP) - prior.value(zeta - STEP)) / (2.0 * STEP)
    np.testing.assert_allclose(prior.slope(zeta), slope, rtol=1e-6)


def test_a_scale_of_which_little_is_known():
    prior, zeta = HalfCauchyPrior(0.02), np.linspace(-3.0, 3.0, 7)
    assert prior.value(np.zeros(1))[0] == pytest.approx(0.02, rel=2e-3)
    assert prior.standardise(prior.value(zeta)) == pytest.approx(zeta, abs=1e-9)
    value = prior.value(np.random.default_rng(1).standard_normal(400_000))
    grid = np.linspace(0.0, 20.0, 2_000_001)
    assert np.exp(prior.log_density(grid)).sum() * (grid[1] - grid[0]) == pytest.approx(1.0, rel=1e-3)
    assert value.mean() == pytest.approx(prior.mean, rel=0.03)
    assert prior.sd == pytest.approx(value.std(), rel=0.1)


def test_poses_that_were_held_back_count_each_by_itself():
    """Three measurements of one number, by draws of that number."""
    sd, noise, measured = 2.0, 1.0, np.array([2.5, 3.0, 2.0])
    draws = np.random.default_rng(1).normal(0.0, sd, 200_000)
    expected = stats.norm.logpdf(measured, 0.0, np.hypot(sd, noise)).sum()
    assert compute_elpd(stats.norm.logpdf(measured, draws[:, None], noise)) == pytest.approx(expected, abs=0.03)
