"""Corrected evidence and draws of small calibrations against sums of the exact density over a grid."""

from __future__ import annotations

from dataclasses import replace

import exact_problems as problems
import numpy as np
import pytest

from bayescal.density.errors import ModelError
from bayescal.density.legs import build_leg_posterior
from bayescal.experiments.study.fit import build_costly
from bayescal.inference.correction import correct_draws, correct_evidence, move_sample, sample_exactly
from bayescal.inference.exploration import explore
from bayescal.inference.importance import estimate_by_importance
from bayescal.inference.sampling import sample_posterior

CASES = [("six_pus", "matrix"), ("jacobian", "linear"), ("beam", "none"), ("stiffness", "linear")]
REACH, N_NODES = 5.0, 11  # standard deviations to either side; steps of one lose 1e-8 of a normal


def draw_small(model, deformation, seed):
    """Return a calibration with two free lengths and one model error for all legs, all else as it truly is."""
    rng = np.random.default_rng([seed, len(model)])
    problem = problems.draw_problem(model, deformation, problems.list_free(deformation), rng, n_poses=12)
    whole, layout = problem.posterior, problem.posterior.likelihood.layout
    free = {name: whole.priors[name] for name in ("l[1]", "l[4]")}
    fixed = {name: problem.theta[k] for k, name in enumerate(layout.names) if name not in free}
    posterior = build_leg_posterior(whole.likelihood, free, ModelError(problems.SCALE, shared=True), fixed)
    return replace(problem, posterior=posterior)


def integrate(density, found):
    """Return log-evidence and means in straight coordinates by a sum over a grid around the proposal's centre."""
    centre, factor = found.proposal.means[0], found.proposal.factors[0]
    line = np.linspace(-REACH, REACH, N_NODES)
    nodes = np.stack(np.meshgrid(*[line] * len(centre), indexing="ij"), axis=-1).reshape(-1, len(centre))
    x = centre + nodes @ factor.T
    values = density.log_density(x)
    top = values.max()
    mass = np.exp(values - top)
    step = np.linalg.slogdet(factor)[1] + len(centre) * np.log(line[1] - line[0])
    return np.log(mass.sum()) + top + step, mass @ x / mass.sum()


@pytest.mark.parametrize(("model", "deformation"), CASES)
def test_corrected_evidence_is_that_of_the_exact_density(model, deformation):
    problem = draw_small(model, deformation, 5)
    found = explore(problem.posterior, np.random.SeedSequence(1))
    explored = estimate_by_importance(found.straight.log_density, found.proposal, np.random.default_rng(2), 5000)
    correction = correct_evidence(build_costly(problem.exact, found), found, np.random.SeedSequence(3))
    expected, _ = integrate(build_costly(problem.exact, found), found)
    error = np.hypot(explored.standard_error, correction.standard_error)
    assert error < 0.05
    assert explored.log_evidence + correction.log_ratio == pytest.approx(expected, abs=4 * error)
    # the frozen density's evidence is another one
    assert abs(explored.log_evidence - expected) > 8 * error


def test_moved_draws_have_the_exact_means():
    problem = draw_small("six_pus", "matrix", 6)
    found = explore(problem.posterior, np.random.SeedSequence(1))
    sample = sample_posterior(found, np.random.SeedSequence(2), 4, 32, 20, 80)
    correction = correct_draws(build_costly(problem.exact, found), found, sample, np.random.SeedSequence(3))
    moved = move_sample(sample, found, correction)
    _, mean = integrate(build_costly(problem.exact, found), found)
    spread = moved.straight.std(axis=(0, 1, 2))
    away = (moved.straight.mean(axis=(0, 1, 2)) - mean) / spread
    assert np.abs(away).max() < 0.1
    np.testing.assert_allclose(moved.natural, problem.posterior.natural(moved.y))
    exact = build_costly(problem.exact, found).log_density(moved.straight[:, :8, -1].reshape(-1, 3))
    claimed = moved.log_density[:, :8, -1].ravel()
    assert np.std(exact - claimed) < 0.3


def test_ensembles_on_the_exact_density_agree():
    """The slow way gives the same means."""
    problem = draw_small("six_pus", "linear", 7)
    found = explore(problem.posterior, np.random.SeedSequence(1))
    sample = sample_posterior(found, np.random.SeedSequence(2), 2, 16, 10, 30)
    correction = correct_draws(build_costly(problem.exact, found), found, sample, np.random.SeedSequence(3))
    seeds = np.random.SeedSequence(4).spawn(2)
    walked = sample_exactly(build_costly(problem.exact, found), found, sample, correction.move, seeds)
    _, mean = integrate(build_costly(problem.exact, found), found)
    assert walked.straight.shape == sample.straight.shape
    away = (walked.straight.mean(axis=(0, 1, 2)) - mean) / walked.straight.std(axis=(0, 1, 2))
    assert np.abs(away).max() < 0.25
    at = walked.straight[0, 0]
    np.testing.assert_allclose(walked.log_density[0, 0], build_costly(problem.exact, found).log_density(at), rtol=1e-9)
