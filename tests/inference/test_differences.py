"""Gradients and Hessians by differences, their points some at a time."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.inference import importance as differences
from bayescal.inference.importance import difference_twice


@pytest.mark.parametrize("at_once", [2**14, 5])
def test_of_a_quartic(monkeypatch, at_once):
    monkeypatch.setattr(differences, "AT_ONCE", at_once)
    rng = np.random.default_rng(0)
    matrix, centre = rng.standard_normal((4, 4)), rng.standard_normal(4)
    square = matrix @ matrix.T
    factor = np.linalg.cholesky(np.linalg.inv(square + np.eye(4)))

    def log_density(x):
        return -0.5 * np.einsum("bi,ij,bj->b", x, square, x) - 1e-3 * np.sum(x**4, axis=1)

    gradient, hessian = difference_twice(log_density, centre, factor, 1e-2)
    slope = -square @ centre - 4e-3 * centre**3
    curvature = -square - np.diag(12e-3 * centre**2)
    np.testing.assert_allclose(gradient, factor.T @ slope, rtol=1e-5)
    np.testing.assert_allclose(hessian, factor.T @ curvature @ factor, rtol=1e-4, atol=1e-6)
