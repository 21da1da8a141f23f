"""The curvature by the model errors is that of differences, wherever a climb may be."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.density.errors import ModelError
from bayescal.inference.mode import find_mode

SCALE = 0.01


@pytest.fixture(params=[False, True], ids=["per leg", "shared"])
def posterior(request, twin):
    """Return a posterior whose model errors are free."""
    return machines.build_posterior("linear", twin, ModelError(SCALE, request.param))


@pytest.fixture
def away(posterior, rng):
    """Return a point three posterior sds from the mode, where errors are not as large as expected."""
    mode = find_mode(posterior, np.zeros(posterior.n_parameters))
    return mode.y + 3.0 * np.linalg.cholesky(mode.covariance) @ rng.standard_normal(len(mode.y)) / len(mode.y) ** 0.5


def test_the_hessian_is_that_of_differences_but_for_the_errors_own_curvature(posterior, away):
    m = posterior.n_geometry
    _, found = posterior.newton(away)
    expected = machines.central_difference(lambda x: posterior.gradient(x)[0], away, np.full(len(away), 1e-5))
    scale = np.sqrt(np.abs(np.diag(expected)))
    white = (found - expected) / np.outer(scale, scale)
    np.testing.assert_allclose(white[:, m:], 0.0, atol=1e-6)
    np.testing.assert_allclose(white[m:], 0.0, atol=5e-4)  # dr/dy leaves out second order in the pose errors
    fisher = (posterior.gradient(away)[1] - expected) / np.outer(scale, scale)
    assert np.abs(fisher[m:]).max() > 0.05  # what is expected of the errors is not what they are


def test_the_gradient_is_the_same(posterior, away):
    np.testing.assert_array_equal(posterior.newton(away)[0], posterior.gradient(away)[0])
    m = posterior.n_geometry
    np.testing.assert_array_equal(posterior.newton(away)[1][:m, :m], posterior.gradient(away)[1][:m, :m])
