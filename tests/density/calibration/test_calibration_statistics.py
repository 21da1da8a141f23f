"""Simulation-based calibration: the truth's rank among draws of its posterior is uniform (Talts et al. 2018)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_problems import (
    climb,
    correlation_of,
    density,
    judge_ranks,
    linear_model,
    lines_posterior,
    measurements,
    rows_of,
    simulate,
)

from bayescal.density.calibration.terms import ErrorModel, ModelErrorTerm, NoiseFactor
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior, UniformPrior
from bayescal.inference.importance import resample
from bayescal.inference.proposal import MixtureProposal

KEPT = 99


def draw(posterior, rng, n=KEPT, tried=1500):
    """Return independent draws of a posterior, proposed about its mode and, for its tails, by the priors."""
    y, factor = climb(posterior)
    factors = np.array([1.2 * factor, 1.2 * np.eye(len(y))])
    proposal = MixtureProposal(np.array([0.8, 0.2]), np.array([y, 0.0 * y]), factors, 5.0)
    found = resample(posterior.log_density, proposal, rng, tried, n)
    assert found.efficiency > 0.02
    return found.draws


def p_values(ranks):
    """Return how likely so uneven ranks (R, n) of 0 to KEPT are, for each of n."""
    return np.array([judge_ranks(column, KEPT) for column in ranks.T])


def linear_problem(rng, nu=np.inf, correlation=None):
    """Return a posterior of linear readings with an unknown factor, a model error and a uniform prior; its truth."""
    model = linear_model(np.random.default_rng(5), 5, 2, 2)
    first = np.arange(5) < 3
    terms = (NoiseFactor("a", first, 0.5), ModelErrorTerm("b", ~first, 0.5, "mm"))
    priors = {"d[1]": NormalPrior(0.0, 1.0), "d[2]": UniformPrior(-2.0, 2.0)}
    pose = 3.0 * rng.standard_normal((8, 2))
    sd = np.array([0.5, 0.4, 0.3, 0.5, 0.5])
    empty = density(model, measurements(np.zeros((8, 5)), sd, correlation))
    blank = Posterior(empty, priors, ErrorModel(terms, rows_of(nu)))
    y = rng.standard_normal(4)
    data = replace(blank.likelihood.data, values=simulate(blank, y, pose, rng))
    return replace(blank, likelihood=density(model, data)), y


def rank_linear(rng, n, spoil=1.0, **case):
    """Return the ranks of n truths (n, 4); a noise stated ``spoil`` times too large has to show."""
    ranks = []
    for _ in range(n):
        posterior, y = linear_problem(rng, **case)
        if spoil != 1.0:
            likelihood = posterior.likelihood
            wrong = replace(likelihood.data, sd=spoil * likelihood.data.sd)
            posterior = replace(posterior, likelihood=replace(likelihood, data=wrong))
        ranks.append((draw(posterior, rng) < y).sum(axis=0))
    return np.array(ranks)


CASES = {"plain": {}, "robust": {"nu": 4.0}, "correlated": {"correlation": correlation_of(np.random.default_rng(1), 5)}}


@pytest.mark.parametrize("name", ["plain", "robust"])  # correlated noise takes four times as long: with the slow ones
def test_ranks_of_linear_problems_are_uniform(name, rng):
    assert (p_values(rank_linear(rng, 40, **CASES[name])) > 0.01).all()


def test_a_wrong_noise_shows(rng):
    assert p_values(rank_linear(rng, 40, spoil=2.5))[2] < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_ranks_of_many_linear_problems_are_uniform(case, rng):
    assert (p_values(rank_linear(rng, 400, **case)) > 0.01).all()


@pytest.mark.slow
@pytest.mark.parametrize("case", [{}, {"missing": 0.5, "nu": 4.0}], ids=["plain", "robust with readings missing"])
def test_ranks_of_a_point_on_lines_are_uniform(case, rng):
    """Parameters and the noise's factor of a machine with poses to be found."""
    terms = (NoiseFactor("lines", np.ones(4, dtype=bool), 0.5),)
    ranks = []
    for _ in range(150):
        posterior, y, _ = lines_posterior(rng, n_poses=15, terms=terms, **case)
        ranks.append((draw(posterior.with_pose_guesses(), rng) < y).sum(axis=0))
    found = p_values(np.array(ranks))
    assert found[-1] > 0.01
    assert (found > 0.01 / len(found)).all()
    assert np.median(found) > 0.05
