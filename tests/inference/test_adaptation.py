"""Mixtures fitted to weighted draws: the known evidence of rows that tell little and of bounds, and a second peak."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayescal.inference.adaptation import adapt_proposal
from bayescal.inference.importance import estimate_by_importance
from bayescal.inference.proposal import MixtureProposal

N, ENOUGH = 8, 0.2


def standing_in(log_density):
    """Return a density of N coordinates with a standard normal prior, in coordinates of its own."""
    posterior = SimpleNamespace(n_parameters=N, draw_prior=lambda n, rng: rng.standard_normal((n, N)))
    return SimpleNamespace(posterior=posterior, x_from_y=lambda y: y, log_density=log_density)


def log_prior(x):
    return multivariate_normal(np.zeros(N), np.eye(N)).logpdf(x)


def tell_little(x):
    """Return two linear rows of noise 0.3 beside the prior; their evidence is that of their normal prediction."""
    return log_prior(x) + multivariate_normal(READ, 0.09 * np.eye(2)).logpdf(x @ ROWS.T)


def cut_off(x):
    """Return the prior with two coordinates flat between bounds, whose evidence is one."""
    inside, rest = (np.abs(x[:, :2]) < 1.0).all(axis=1), multivariate_normal(np.zeros(N - 2), np.eye(N - 2))
    return np.where(inside, rest.logpdf(x[:, 2:]) - 2.0 * np.log(2.0), -np.inf)


def stand_twice(x):
    """Return two peaks at opposite places, of half the mass each."""
    own = [multivariate_normal(side * 1.5 * np.ones(N), 0.09 * np.eye(N)).logpdf(x) for side in (-1.0, 1.0)]
    return np.logaddexp(*own) - np.log(2.0)


ROWS, READ = np.eye(2, N) + np.eye(2, N, 1), np.array([1.0, -0.5])
LITTLE = float(multivariate_normal(np.zeros(2), ROWS @ ROWS.T + 0.09 * np.eye(2)).logpdf(READ))


@pytest.mark.parametrize(("density", "known"), [(tell_little, LITTLE), (cut_off, 0.0)])
def test_a_poor_proposal_becomes_a_good_one_whose_evidence_is_the_known_one(density, known):
    first = MixtureProposal(np.ones(1), np.full((1, N), 0.3), 0.3 * np.eye(N)[None], 50.0)
    before = estimate_by_importance(density, first, np.random.default_rng(1), 4000)
    found = adapt_proposal(standing_in(density), first, np.random.default_rng(2), ENOUGH)
    after = estimate_by_importance(density, found.proposal, np.random.default_rng(3), 8000)
    assert before.efficiency < 0.02 < ENOUGH < after.efficiency
    assert abs(after.log_evidence - known) < 4.0 * after.standard_error < 0.2


def test_a_peak_beside_the_first_proposal_is_found_where_the_prior_reaches_it():
    first = MixtureProposal(np.ones(1), np.full((1, N), 1.5), 0.3 * np.eye(N)[None], 50.0)
    assert estimate_by_importance(stand_twice, first, np.random.default_rng(1), 4000).log_evidence < -0.5
    found = adapt_proposal(standing_in(stand_twice), first, np.random.default_rng(2), 1.0)
    assert np.ptp(found.proposal.means[:, 0]) > 1.4


def test_no_draw_with_a_density_adapts_nothing():
    nowhere = standing_in(lambda x: np.full(len(x), -np.inf))
    first = MixtureProposal(np.ones(1), np.zeros((1, N)), np.eye(N)[None], 50.0)
    assert adapt_proposal(nowhere, first, np.random.default_rng(2), ENOUGH) is None
