"""The end of a bent flexure against quadrature of eq. (11), and the circle of eq. (13) against both."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.machines.models.beam import CIRCLE, PIVOT, SERIES_BELOW, compute_beam_shift, compute_circle_shift

LENGTH = 10.0
ANGLES = np.array([1e-9, 1e-4, np.radians(0.5), np.radians(1.0), 0.999 * SERIES_BELOW, 1.001 * SERIES_BELOW, 0.3])


def integrate_shift(angle: float) -> float:
    """Return Δx of eq. (11) by Gauss-Legendre quadrature of sqrt(1 + t²) - 1, written without cancellation."""
    node, weight = np.polynomial.legendre.leggauss(40)
    square = (angle * 0.5 * (node + 1.0)) ** 2
    return LENGTH * float(np.sum(0.5 * weight * square / (1.0 + np.sqrt(1.0 + square))))


def test_beam_shift_is_the_integral():
    along, across = compute_beam_shift(ANGLES, LENGTH)
    np.testing.assert_allclose(along, [integrate_shift(a) for a in ANGLES], rtol=1e-12)
    np.testing.assert_allclose(across, LENGTH * ANGLES / 2, rtol=1e-15)


def test_straight_flexure_and_both_signs():
    along, across = compute_beam_shift(np.array([0.0, 0.01, -0.01, 0.2, -0.2]), LENGTH)
    assert along[0] == across[0] == 0.0
    assert along[1] == along[2] > 0
    np.testing.assert_allclose(along[3], along[4], rtol=1e-15)


def test_circle_point_lies_on_the_circle():
    across = np.array([0.0, 1e-6, 0.1, 2.0])
    along = compute_circle_shift(across, 7.5)
    np.testing.assert_allclose((along - 7.5) ** 2 + across**2, 7.5**2, rtol=1e-15)


@pytest.mark.parametrize(("share", "order"), [(CIRCLE, 4), (PIVOT, 2)])
def test_circle_is_right_to_fourth_order_and_the_pivot_to_second(share, order):
    """Halving the angle divides the error by 2^order."""
    along, across = compute_beam_shift(np.array([0.2, 0.1]), LENGTH)
    error = compute_circle_shift(across, share * LENGTH) - along
    assert np.log2(error[0] / error[1]) == pytest.approx(order, abs=0.1)
