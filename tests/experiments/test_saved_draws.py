"""What is predicted of readings whose poses nobody knows: for machines from the prior, as often below as above."""

from __future__ import annotations

import numpy as np
import pytest
from bayescal.experiments.shared.reading_trees import save_draws
from calibration_problems import correlation_of, density, linear_model, measurements, stated_noise
from scipy import stats

from bayescal.density.calibration.posterior import HALF_LOG_TWO_PI, CalibrationPosterior
from bayescal.density.priors import NormalPrior, UniformPrior

N_POSES, N_READINGS = 3, 6


def make_posterior(rng, truth, noise=1.0, correlated=False, robust=np.inf):
    """Return the posterior of readings of a machine ``truth`` whose noise is another than the stated one."""
    model = linear_model(np.random.default_rng(1), n=N_READINGS)
    correlation = correlation_of(np.random.default_rng(2), N_READINGS) if correlated else np.eye(N_READINGS)
    pose = rng.standard_normal((N_POSES, 2))
    error = rng.standard_normal((N_POSES, N_READINGS)) @ np.linalg.cholesky(0.3**2 * correlation).T
    if np.isfinite(robust):
        error *= np.sqrt(robust / rng.chisquare(robust, N_POSES))[:, None]
    values = model.read(truth, pose) + noise * error
    values[0, 1] = np.nan  # a reading that was not taken
    data = measurements(values, 0.3, correlation if correlated else None)
    names = model.layout.names
    priors = {names[0]: NormalPrior(0.0, 1.0), names[1]: UniformPrior(-2.0, 2.0), names[2]: NormalPrior(0.0, 0.5)}
    return CalibrationPosterior(density(model, data, nu=robust), priors, stated_noise(N_READINGS), {}, {})


def draw_truth(rng):
    return np.array([rng.normal(), rng.uniform(-2.0, 2.0), rng.normal(0.0, 0.5)])


@pytest.mark.parametrize("case", [{}, {"correlated": True}, {"robust": 4.0}], ids=["plain", "correlated", "robust"])
def test_measured_numbers_follow_the_prior_predictive(case):
    """Ranks of the measured among replicates, over machines from the prior: uniform; with five times the noise not."""
    for noise, good in ((1.0, True), (5.0, False)):
        rng, ranks = np.random.default_rng(5), []
        for k in range(60):
            posterior = make_posterior(rng, draw_truth(rng), noise, **case)
            saved = save_draws(posterior, rng.standard_normal((8, 3)), 8, 2, [k])
            ranks.append((saved.prior_replicated < saved.observed).mean(axis=0)[:1])
        pvalue = stats.kstest(np.ravel(ranks), "uniform").pvalue
        assert bool(pvalue > 1e-3) == good, pvalue


def test_densities_are_those_of_the_posterior():
    rng = np.random.default_rng(6)
    posterior = make_posterior(rng, draw_truth(rng))
    kept = rng.standard_normal((40, 3))
    saved = save_draws(posterior, kept, 400, 4, [1])
    assert saved.posterior.shape == (4, 10, 3)
    np.testing.assert_allclose(saved.posterior.reshape(-1, 3), posterior.natural(kept), rtol=1e-12)
    np.testing.assert_allclose(saved.log_density.ravel(), posterior.log_density(kept), rtol=1e-9)
    normal, uniform, tight = saved.log_prior.reshape(-1, 3).T
    np.testing.assert_allclose(normal, -0.5 * kept[:, 0] ** 2 - HALF_LOG_TWO_PI, atol=1e-6)
    np.testing.assert_allclose(uniform, -np.log(4.0), atol=1e-5)
    np.testing.assert_allclose(tight, stats.norm.logpdf(0.5 * kept[:, 2], 0.0, 0.5), atol=1e-6)
