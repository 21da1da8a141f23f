"""Densities of rows that may be wrong: what they promise of each other, against differences and quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, stats

from bayescal.density.outliers import NORMAL, Contaminated, StudentT
from bayescal.density.priors import SharePrior

FAMILY = {
    "normal": NORMAL,
    "t": StudentT(4.0),
    "contaminated": Contaminated(SharePrior(0.1)),
}
ZETA = np.array([[-0.4], [0.7]])
SPARE = np.array([1, 3, 6])
SQUARE = np.array([[0.3, 4.0, 20.0], [2.0, 9.0, 40.0]])
STEP = 1e-5


@pytest.fixture(params=FAMILY.values(), ids=FAMILY)
def outliers(request):
    """Return one of the family."""
    return request.param


@pytest.fixture
def rows(outliers):
    """Return its density at two values of what is unknown of it."""
    return outliers.at(ZETA[:, : len(outliers.names)])


def differ(function):
    return (function(STEP) - function(-STEP)) / (2.0 * STEP)


def test_names_have_units_and_priors(outliers):
    assert len(outliers.names) == len(outliers.units) == len(outliers.priors)


def test_the_density_integrates_to_one(rows):
    one = np.array([1])

    def density(r):
        return float(np.exp(rows.pick(slice(0, 1)).weigh(np.array([[r * r]]), one)[0, 0]))

    whole = integrate.quad(density, -np.inf, np.inf, limit=500)[0]
    assert whole == pytest.approx(1.0, abs=1e-6)


def test_trust_and_curvature_are_those_of_the_density(rows):
    by_square = differ(lambda h: rows.weigh(SQUARE + h, SPARE))
    np.testing.assert_allclose(rows.trust(SQUARE, SPARE), -2.0 * by_square, rtol=1e-6)
    np.testing.assert_allclose(
        rows.soften(SQUARE, SPARE), -2.0 * differ(lambda h: rows.trust(SQUARE + h, SPARE)), rtol=1e-5, atol=1e-9
    )
    rest = rows.penalise(SQUARE, SPARE) + 2.0 * rows.weigh(SQUARE, SPARE)
    np.testing.assert_allclose(rest, 2.0 * rows.weigh(np.zeros_like(SQUARE), SPARE), rtol=1e-9)
    np.testing.assert_allclose(rows.exceed(SQUARE, SPARE), rows.weigh(SQUARE, SPARE) - NORMAL.weigh(SQUARE, SPARE))


def test_slopes_by_what_is_unknown_are_those_of_differences(outliers, rows):
    expected = [
        differ(lambda h, k=k: outliers.at(ZETA + h * np.eye(1)[k]).weigh(SQUARE, SPARE))
        for k in range(len(outliers.names))
    ]
    found = rows.slopes(SQUARE, SPARE)
    assert found.shape == (*SQUARE.shape, len(outliers.names))
    np.testing.assert_allclose(np.moveaxis(found, -1, 0), np.reshape(expected, (-1, *SQUARE.shape)), rtol=1e-6)


def test_some_machines_are_those_machines(rows):
    some = np.array([1])
    np.testing.assert_array_equal(rows.pick(some).weigh(SQUARE[some], SPARE), rows.weigh(SQUARE, SPARE)[some])


def test_without_a_spread_it_is_the_density_itself(rows):
    size = np.sqrt(SQUARE)[..., None] * np.eye(6)[0]
    found = rows.weigh_spread(size, np.zeros_like(size), SPARE)
    np.testing.assert_allclose(found, rows.weigh(SQUARE, SPARE), atol=1e-6)


def test_a_spread_is_integrated(rows):
    """One reading with a further normal error of known variance: the convolution."""
    one, variance = np.array([1]), 2.5
    rows = rows.pick(slice(0, 1))
    u = np.linspace(-60.0, 60.0, 240_001)
    inside = np.exp(rows.weigh((3.0 - u[None, :, None])[0] ** 2, one)[:, 0]) * stats.norm.pdf(u, 0.0, np.sqrt(variance))
    found = rows.weigh_spread(np.array([[[3.0]]]), np.array([[[variance]]]), one)[0, 0]
    assert np.exp(found) == pytest.approx(np.trapezoid(inside, u), rel=1e-6)


def test_widths_drawn_make_rows_of_that_density(rows, rng):
    """Residuals of unit noise times the root of drawn widths have the density's distribution function."""
    n = 40_000
    rows = rows.pick(slice(0, 1))
    drawn = rng.standard_normal(n) * np.sqrt(rows.draw_wide((1, n), rng)[0])
    grid = np.linspace(-8.0, 8.0, 8001)
    density = np.exp(rows.weigh(grid[:, None] ** 2, np.array([1]))[:, 0])
    inside = np.cumsum(density) * (grid[1] - grid[0])
    share = np.interp(2.0, grid, inside) - np.interp(-2.0, grid, inside)
    assert np.mean(np.abs(drawn) < 2.0) == pytest.approx(share, abs=0.01)


def test_widths_given_a_row_have_the_mean_precision_that_counts(rows, rng):
    square, spare = np.full((1, 60_000), 12.0), np.full(60_000, 3)
    rows = rows.pick(slice(0, 1))
    width = rows.draw_widening(square, spare, rng)
    assert np.mean(1.0 / width) == pytest.approx(rows.trust(square, spare)[0, 0], rel=0.02)
