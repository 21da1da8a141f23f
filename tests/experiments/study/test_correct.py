"""Corrected evidence and draws of small calibrations against sums of the whole density over a grid."""

from __future__ import annotations

from dataclasses import replace

import exact_problems as problems
import numpy as np
import pytest
import studies

from bayescal.experiments.study.readings import MAX_FROZEN_ERROR_NAT, ReadingSubject, weigh_beside
from bayescal.inference.correction import correct_draws, correct_evidence, move_sample, sample_exactly
from bayescal.inference.exploration import CORRECTABLE, explore
from bayescal.inference.importance import estimate_by_importance
from bayescal.inference.sampling import sample_posterior

REACH, N_NODES = 5.0, 11  # standard deviations to either side; steps of one lose 1e-8 of a normal


def draw_small(model, seed):
    """Return a calibration with two free lengths and one model error for all legs, all else as it truly is.

    Of the errors of K, which all poses share, the fast form takes each pose to know for itself.
    """
    rng = np.random.default_rng([seed, len(model)])
    free = problems.list_free("matrix")
    problem = problems.draw_problem(model, "matrix", free, rng, n_poses=12, shared=True, matrix_sd=1.5e-3)
    whole, layout = problem.posterior, problem.posterior.likelihood.layout
    free = {name: whole.priors[name] for name in ("l[1]", "l[4]")}
    fixed = {name: problem.theta[k] for k, name in enumerate(layout.names) if name not in free}
    return replace(whole, likelihood=whole.likelihood.whole, priors=free, fixed=fixed).with_pose_guesses()


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


@pytest.mark.parametrize("model", ["six_pus", "stiffness"])
def test_corrected_evidence_is_that_of_the_whole_density(model):
    posterior = draw_small(model, 5)
    found = explore(posterior, np.random.SeedSequence(1))
    explored = estimate_by_importance(found.straight.log_density, found.proposal, np.random.default_rng(2), 5000)
    costly = weigh_beside(posterior, found)
    correction = correct_evidence(costly, found, np.random.SeedSequence(3))
    expected, _ = integrate(costly, found)
    error = np.hypot(explored.standard_error, correction.standard_error)
    assert error < 0.05
    assert explored.log_evidence + correction.log_ratio == pytest.approx(expected, abs=4 * error)
    # the fast form's evidence is another one
    assert abs(explored.log_evidence - expected) > 3 * error


def test_moved_draws_have_the_means_of_the_whole_density_and_so_have_ensembles():
    posterior = draw_small("six_pus", 6)
    found = explore(posterior, np.random.SeedSequence(1))
    sample = sample_posterior(found, np.random.SeedSequence(2), 4, 32, 20, 80)
    costly = weigh_beside(posterior, found)
    correction = correct_draws(costly, found, sample, np.random.SeedSequence(3))
    moved = move_sample(sample, found, correction)
    _, mean = integrate(costly, found)
    away = (moved.straight.mean(axis=(0, 1, 2)) - mean) / moved.straight.std(axis=(0, 1, 2))
    assert np.abs(away).max() < 0.1
    np.testing.assert_allclose(moved.natural, posterior.natural(moved.y))
    exact = costly.log_density(moved.straight[:, :8, -1].reshape(-1, 3))
    assert np.std(exact - moved.log_density[:, :8, -1].ravel()) < 0.3
    few = sample_posterior(found, np.random.SeedSequence(2), 2, 16, 10, 30)
    walked = sample_exactly(costly, found, few, correction.move, np.random.SeedSequence(4).spawn(2))
    away = (walked.straight.mean(axis=(0, 1, 2)) - mean) / walked.straight.std(axis=(0, 1, 2))
    assert walked.straight.shape == few.straight.shape
    assert np.abs(away).max() < 0.25  # the slow way
    np.testing.assert_allclose(walked.log_density[0, 0], costly.log_density(walked.straight[0, 0]), rtol=1e-9)


def test_what_a_frozen_density_leaves_out_is_corrected(tmp_path):
    """Where joints are free, too, errors' columns follow the machine, which frozen ones do not."""
    path, free = studies.write_tiny_study(tmp_path), ("a_x", "a_y", "b_x", "b_y", "l")
    studies.edit(path, 'free = ["l"]', f"free = [{', '.join(map(repr, free))}]")
    studies.edit(
        path, "l = {", "\n".join(f'{name} = {{ prior = "normal", sd = 2.0 }}' for name in free[:4]) + "\nl = {"
    )
    studies.edit(path, 'terms = ["random"]', 'terms = ["random", "linear"]')
    posterior = studies.load_study(path).variants["six_pus/none"].posterior().with_pose_guesses()
    found = explore(posterior, np.random.SeedSequence(1), fine_enough=CORRECTABLE)
    assert found.straight.posterior.likelihood.frozen is not None
    assert found.left_out > MAX_FROZEN_ERROR_NAT
    costly = ReadingSubject(posterior).find_costly(found)
    correction = correct_evidence(costly, found, np.random.SeedSequence(3))
    frozen, whole = (
        estimate_by_importance(density, found.proposal, np.random.default_rng(2), 3000)
        for density in (found.straight.log_density, costly.log_density)
    )
    error = np.hypot(whole.standard_error, correction.standard_error)
    assert error < 0.1
    assert frozen.log_evidence + correction.log_ratio == pytest.approx(whole.log_evidence, abs=4 * error)
    assert abs(frozen.log_evidence - whole.log_evidence) > MAX_FROZEN_ERROR_NAT
