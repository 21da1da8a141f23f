"""Scales by importance: evidence, moments and mode of densities that are known."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.errors import NumericalError
from bayescal.inference.scales import find_scales_mode, measure_volume, sample_scales

CENTRE, PRECISION = np.array([0.7, -0.4, 0.1]), np.diag([4.0, 2.0, 0.5])


def gaussian(zeta: np.ndarray) -> np.ndarray:
    """Return a normal likelihood times the standard normal prior, (B, 3) to (B,)."""
    square = np.einsum("bi,ij,bj->b", zeta - CENTRE, PRECISION, zeta - CENTRE)
    return -0.5 * square - 0.5 * np.sum(zeta**2, axis=1) - 1.5 * np.log(2.0 * np.pi)


def test_a_normal_density_has_its_evidence_and_moments(rng):
    total = PRECISION + np.eye(3)
    mean = np.linalg.solve(total, PRECISION @ CENTRE)
    evidence = -0.5 * np.log(np.linalg.det(total)) + 0.5 * mean @ total @ mean - 0.5 * CENTRE @ PRECISION @ CENTRE
    mode = find_scales_mode(gaussian, np.zeros(3))
    np.testing.assert_allclose(mode, mean, atol=1e-4)
    laplace = gaussian(mode[None])[0] + 1.5 * np.log(2.0 * np.pi) + measure_volume(gaussian, mode)
    assert laplace == pytest.approx(evidence, abs=1e-4)
    found = sample_scales(gaussian, mode, 4000, 2000, rng)
    assert abs(found.log_evidence - evidence) < 5.0 * found.standard_error < 0.1
    assert found.pareto_k < 0.7
    assert found.efficiency > 0.5
    sd = np.sqrt(np.diag(np.linalg.inv(total)))
    np.testing.assert_allclose(found.draws.mean(axis=0), mean, atol=0.15 * sd.max())
    np.testing.assert_allclose(found.draws.std(axis=0), sd, rtol=0.1)


def test_no_scales_at_all_are_a_number(rng):
    found = sample_scales(lambda zeta: np.full(len(zeta), -3.5), np.empty(0), 100, 20, rng)
    assert (found.log_evidence, found.draws.shape) == (-3.5, (20, 0))


def test_a_density_that_is_nowhere_is_told(rng):
    with pytest.raises(NumericalError, match="no density"):
        find_scales_mode(lambda zeta: np.full(len(zeta), -np.inf), np.zeros(2))
