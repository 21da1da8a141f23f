"""Rows of sessions free of the pose: their normal density is the exact one, whatever the noise, and so are slopes."""

from __future__ import annotations

from dataclasses import replace

import calibration_problems as problems
import numpy as np
import pytest

from bayescal.density.sessions import ReadingRows

CASES = {
    "known noise": {},
    "unknown noise": {"terms": problems.unknown_noise(4, errors=True, scale=0.02)},
    "missing readings": {"missing": 0.5, "terms": problems.unknown_noise(4)},
    "a reading on a circle": {"bearing": True},
    "commanded lines": {"commanded": (0, 1)},
}


@pytest.fixture(params=CASES)
def rows(request, rng):
    posterior, y, _ = problems.lines_posterior(rng, 15, **CASES[request.param])
    return ReadingRows(posterior.anchored()), posterior.theta(y[None])[0]


def test_the_density_of_the_rows_is_that_of_the_readings(rows, rng):
    rows, theta = rows
    found = rows.linearise(theta)
    assert found.errors.shape == (rows.n_poses, rows.width)
    for zeta in rng.standard_normal((4, rows.n_errors)):
        covariance = found.covariance(zeta)
        square = np.einsum("pi,pij,pj->", found.errors, np.linalg.inv(covariance), found.errors)
        value = found.constant.sum() - 0.5 * (square + np.linalg.slogdet(covariance)[1].sum())
        exact = rows.evaluate(theta[None], zeta[None])[0]
        assert value == pytest.approx(exact, abs=2e-3 * rows.n_poses)


def test_correlated_noise_counts(rng):
    correlation = problems.correlation_of(rng, 4)
    posterior, y, _ = problems.lines_posterior(rng, 12, correlation=correlation)
    rows = ReadingRows(posterior.anchored())
    theta = posterior.theta(y[None])[0]
    found = rows.linearise(theta)
    np.testing.assert_allclose(found.covariance(np.empty(0)), np.broadcast_to(np.eye(2), (12, 2, 2)), atol=1e-9)
    value = found.constant.sum() - 0.5 * np.sum(found.errors**2)
    assert value == pytest.approx(rows.evaluate(theta[None], np.empty((1, 0)))[0], abs=2e-2)


def test_slopes_are_those_of_the_squares(rows):
    """The sum of squares of what no pose explains changes as the slopes say: the basis itself may turn."""
    rows, theta = rows
    here, step = rows.linearise(theta), 1e-5
    for k in (0, 3, len(theta) - 1):
        plus, minus = theta.copy(), theta.copy()
        plus[k] += step
        minus[k] -= step
        change = sum(sign * np.sum(rows.linearise(one).errors ** 2) for sign, one in ((1, plus), (-1, minus)))
        expected = 2.0 * np.sum(here.errors * here.slope[..., k])
        assert change / (2.0 * step) == pytest.approx(expected, rel=1e-3, abs=1e-3 * np.abs(expected) + 1e-2)


def test_some_rows_are_those_rows(rng):
    posterior, y, _ = problems.lines_posterior(rng, 10)
    anchored = posterior.anchored()
    theta, some = posterior.theta(y[None])[0], np.array([1, 4, 7])
    whole = ReadingRows(anchored).linearise(theta)
    part = ReadingRows(replace(anchored, likelihood=anchored.likelihood.pick(some))).linearise(theta)
    np.testing.assert_allclose(part.constant, whole.constant[some])
    np.testing.assert_allclose(np.sum(part.errors**2, axis=1), np.sum(whole.errors[some] ** 2, axis=1))
