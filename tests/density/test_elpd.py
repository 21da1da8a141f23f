"""The density of poses that were held back: together they tell of the machine what each by itself does not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bayescal.density.prediction import compute_elpd, compute_joint_elpd

SD, NOISE, MEASURED = 2.0, 1.0, np.array([2.5, 3.0, 2.0])


@pytest.fixture(scope="module")
def pointwise():
    """Return log-densities of three measurements of one number, of draws of that number."""
    draws = np.random.default_rng(1).normal(0.0, SD, 200_000)
    return stats.norm.logpdf(MEASURED, draws[:, None], NOISE)


def test_joint_density_is_that_of_correlated_measurements(pointwise):
    covariance = NOISE**2 * np.eye(3) + SD**2
    expected = stats.multivariate_normal.logpdf(MEASURED, np.zeros(3), covariance)
    value, error = compute_joint_elpd(pointwise)
    assert value == pytest.approx(expected, abs=4 * error)
    assert 0 < error < 0.01


def test_pose_by_pose_it_is_another_number(pointwise):
    expected = stats.norm.logpdf(MEASURED, 0.0, np.hypot(SD, NOISE)).sum()
    assert compute_elpd(pointwise) == pytest.approx(expected, abs=0.03)
    assert compute_joint_elpd(pointwise)[0] > expected + 1.0
