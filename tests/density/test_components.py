"""Rows with variance components, and geometry given the variances, against plain normal densities."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayescal.density.components import Components, LinearGeometry, LinearRows

P, N, M_GEOMETRY = 5, 3, 4
VARIANCES = np.array([0.3, 2.0, 0.7])


@pytest.fixture(scope="module")
def components():
    rng = np.random.default_rng(1)
    roots, wholes = rng.standard_normal((2, P, N, N)), rng.standard_normal((2, P * N, 4))
    known = np.eye(N) + roots[0] @ np.swapaxes(roots[0], -1, -2)
    return Components(known, (roots[1] @ np.swapaxes(roots[1], -1, -2))[None], wholes @ np.swapaxes(wholes, -1, -2))


def plain(components, variances):
    total = sum(v * one for v, one in zip(variances[1:], components.parts, strict=True)).reshape(P, N, P, N).copy()
    for p in range(P):
        total[p, :, p] += components.known[p] + variances[0] * components.blocks[0, p]
    return total.reshape(P * N, P * N)


def test_density_of_rows_is_normal(components):
    rng = np.random.default_rng(2)
    rows, variances = 3.0 * rng.standard_normal((4, P * N)), rng.uniform(0.0, 3.0, (4, 3))
    expected = [
        multivariate_normal.logpdf(row, cov=plain(components, one)) + 0.5 * P * N * np.log(2 * np.pi)
        for row, one in zip(rows, variances, strict=True)
    ]
    assert components.weigh(variances, rows) == pytest.approx(expected, rel=1e-10)


def test_each_pose_given_all_others(components):
    rows, whole = np.random.default_rng(3).standard_normal((1, P * N)), plain(components, VARIANCES)
    density, square = components.weigh_each(VARIANCES[None], rows)
    for pose in range(P):
        mine, rest = np.split(np.roll(np.arange(P * N), -pose * N), [N])
        given = whole[np.ix_(mine, rest)] @ np.linalg.inv(whole[np.ix_(rest, rest)])
        left, off = whole[np.ix_(mine, mine)] - given @ whole[np.ix_(rest, mine)], rows[0, mine] - given @ rows[0, rest]
        assert square[0, pose] == pytest.approx(off @ np.linalg.solve(left, off), rel=1e-9)
        expected = multivariate_normal.logpdf(off, cov=left) + 0.5 * N * np.log(2 * np.pi)
        assert density[0, pose] == pytest.approx(expected, rel=1e-9)


def test_what_a_variance_adds_is_the_slope_of_the_covariance(components):
    vector, inverse = np.random.default_rng(4).standard_normal(P * N), np.linalg.inv(plain(components, VARIANCES))
    slopes = [plain(components, VARIANCES + step) - plain(components, VARIANCES) for step in np.eye(3)]
    assert components.act(vector) == pytest.approx(np.stack(slopes) @ vector, rel=1e-9, abs=1e-9)
    first, second = components.traces(VARIANCES)
    both = inverse @ np.stack(slopes)
    assert first == pytest.approx([np.trace(one) for one in both], rel=1e-9)
    assert second == pytest.approx(np.array([[np.trace(one @ other) for other in both] for one in both]), rel=1e-9)


def test_geometry_given_the_errors_is_that_of_the_joint_normal(components):
    rng = np.random.default_rng(5)
    residual, slope, centre = rng.standard_normal(P * N), rng.standard_normal((P * N, M_GEOMETRY)), np.arange(4.0)
    square = components.square(np.column_stack([slope, residual]))
    rows = LinearRows(np.zeros((4, 4)), np.zeros(4), lambda zeta: square(np.exp(zeta) * VARIANCES))
    # a standard normal prior about zero
    linear = LinearGeometry(centre, rows, np.eye(4), -centre, lambda zeta: float(-0.5 * zeta @ zeta), np.exp)
    masses, expected = [], []
    for zeta in (np.zeros(3), np.array([0.5, -1.0, 0.2])):
        given, noise = linear.given(zeta), plain(components, np.exp(zeta) * VARIANCES)
        measured = slope @ centre - residual  # rows e = J (y - centre) + residual vanish where J y reads this
        gain = slope.T @ np.linalg.inv(slope @ slope.T + noise)
        assert given.mean == pytest.approx(gain @ measured, rel=1e-8, abs=1e-10)
        assert given.covariance == pytest.approx(np.eye(4) - gain @ slope, rel=1e-8, abs=1e-10)
        masses.append(given.log_mass)
        expected.append(multivariate_normal.logpdf(measured, cov=noise + slope @ slope.T) - 0.5 * zeta @ zeta)
    assert np.diff(masses) == pytest.approx(np.diff(expected), rel=1e-9)
