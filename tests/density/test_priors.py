"""Priors: what they draw follows their density, and standardised it is standard normal."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bayescal.density.priors import HalfNormalPrior, NormalPrior, UniformPrior

PRIORS = {
    "normal": (NormalPrior(3.0, 0.5), stats.norm(3.0, 0.5)),
    "uniform": (UniformPrior(-1.0, 4.0), stats.uniform(-1.0, 5.0)),
    "half normal": (HalfNormalPrior(0.01), stats.halfnorm(scale=0.01)),
}


@pytest.mark.parametrize("name", PRIORS)
def test_draws_follow_the_density(name):
    prior, known = PRIORS[name]
    draws = prior.draw(4000, np.random.default_rng(1))
    assert stats.kstest(draws, known.cdf).pvalue > 1e-3
    np.testing.assert_allclose(prior.log_density(draws), known.logpdf(draws), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", PRIORS)
def test_standardised_values_have_the_prior_s_probabilities(name):
    prior, known = PRIORS[name]
    values = known.ppf([0.01, 0.3, 0.5, 0.95])
    np.testing.assert_allclose(prior.standardise(values), stats.norm.ppf([0.01, 0.3, 0.5, 0.95]), atol=1e-9)
