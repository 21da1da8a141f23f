"""What a fit of readings is judged by: replicates, single rows, misfit, other priors; on linear machines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_problems import correlation_of, density, linear_model, measurements, rows_of
from scipy import stats
from scipy.stats import binom

from bayescal.density.calibration.prediction import replicate_readings
from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior, UniformPrior
from bayescal.experiments.shared.soundness import measure_pulls
from bayescal.experiments.study.readings import ReadingSubject, Residuals
from bayescal.inference.leave_one_out import leave_out

N_POSES, N_READINGS, SD = 3, 6, 0.3
CASES = [{}, {"correlated": True}, {"robust": 4.0}]


def make_posterior(rng, truth, noise=1.0, correlated=False, robust=np.inf, n_poses=N_POSES):
    """Return the posterior of readings of a machine ``truth`` whose noise is another than the stated one, and poses."""
    model = linear_model(np.random.default_rng(1), n=N_READINGS)
    correlation = correlation_of(np.random.default_rng(2), N_READINGS) if correlated else np.eye(N_READINGS)
    pose = rng.standard_normal((n_poses, 2))
    error = rng.standard_normal((n_poses, N_READINGS)) @ np.linalg.cholesky(SD**2 * correlation).T
    if np.isfinite(robust):
        error *= np.sqrt(robust / rng.chisquare(robust, n_poses))[:, None]
    values = model.read(truth, pose) + noise * error
    values[0, 1] = np.nan  # a reading that was not taken
    data = measurements(values, SD, correlation if correlated else None)
    names = model.layout.names
    priors = {names[0]: NormalPrior(0.0, 1.0), names[1]: UniformPrior(-2.0, 2.0), names[2]: NormalPrior(0.0, 0.5)}
    return Posterior(density(model, data), priors, ErrorModel(outliers=rows_of(robust))), pose


def draw_truth(rng):
    return np.array([rng.normal(), rng.uniform(-2.0, 2.0), rng.normal(0.0, 0.5)])


@pytest.mark.parametrize("case", CASES, ids=["plain", "correlated", "robust"])
def test_readings_at_the_true_poses_follow_the_replicates_of_the_true_machine(case):
    """Ranks of the measured among replicates: uniform; with five times the noise not."""
    for noise, good in ((1.0, True), (5.0, False)):
        rng, ranks = np.random.default_rng(5), []
        for _ in range(60):
            truth = draw_truth(rng)
            posterior, pose = make_posterior(rng, truth, noise, **case)
            y = posterior.to_coordinates(truth[None], np.empty((1, 0)))
            made = replicate_readings(posterior, np.repeat(y, 200, axis=0), rng, pose)
            assert (np.isnan(made) == np.isnan(posterior.likelihood.data.values)).all()
            ranks.append((made[:, 1, 2] < posterior.likelihood.data.values[1, 2]).mean())
        pvalue = stats.kstest(ranks, "uniform").pvalue
        assert bool(pvalue > 1e-3) == good, pvalue


@pytest.mark.parametrize("case", CASES[:2], ids=["plain", "correlated"])
def test_poses_are_drawn_given_the_readings(case):
    """Replicates scatter about what the best pose explains, by noise and by what is unknown of the pose."""
    rng = np.random.default_rng(7)
    posterior, _ = make_posterior(rng, draw_truth(rng), **case)
    y, likelihood = np.zeros((1, 3)), posterior.likelihood
    made = replicate_readings(posterior, np.repeat(y, 20_000, axis=0), rng)[:, 1]
    white, at = posterior.likelihood.explain(*posterior.at(y))
    slope = white.colour(np.moveaxis(at.slope[0], -1, 0))[:, 1].T
    noise = SD**2 * likelihood.correlation[min(1, len(likelihood.correlation) - 1)]
    covariance = noise + slope @ np.linalg.inv(at.slope[0, 1].T @ at.slope[0, 1]) @ slope.T
    expected = likelihood.data.values[1] - white.colour(at.error)[0, 1]
    np.testing.assert_allclose(made.mean(axis=0), expected, atol=5 * np.sqrt(np.diag(covariance).max() / 20_000))
    np.testing.assert_allclose(np.cov(made.T), covariance, atol=0.05 * covariance.max())


@pytest.mark.parametrize("case", CASES, ids=["plain", "correlated", "robust"])
def test_a_row_alone_is_that_row_of_all(case):
    rng = np.random.default_rng(8)
    posterior, _ = make_posterior(rng, draw_truth(rng), **case)
    y = rng.standard_normal((5, 3))
    for row in range(N_POSES):
        np.testing.assert_allclose(posterior.pointwise_of(y, row), posterior.pointwise(y)[:, row], rtol=1e-9)


@pytest.mark.parametrize("case", CASES[:2], ids=["plain", "correlated"])
def test_rows_have_the_information_that_the_hessian_has(case):
    rng = np.random.default_rng(9)
    posterior, _ = make_posterior(rng, draw_truth(rng), **case)
    y = 0.3 * rng.standard_normal(3)
    parts = sum(posterior.row_information(y, row) for row in range(N_POSES))
    np.testing.assert_allclose(parts + np.eye(3), -posterior.gradient(y)[1], rtol=1e-6)


def test_noise_stated_too_small_shows_in_the_misfit_and_tight_tolerances_in_the_pulls():
    for noise, off in ((1.0, False), (3.0, True)):
        rng = np.random.default_rng(10)
        posterior, _ = make_posterior(rng, draw_truth(rng), noise, n_poses=60)
        found = ReadingSubject(posterior).measure_misfit(posterior, posterior.least_squares_start())
        assert found.dof == pytest.approx(60 * 4 - 1 - 3, abs=0.1)
        assert found.is_off == off
    for far, off in ((0.7, False), (6.0, True)):
        rng = np.random.default_rng(11)
        posterior, _ = make_posterior(rng, np.array([far, 0.5, -0.5 * far]), n_poses=60)
        draws = posterior.natural(posterior.least_squares_start() + 0.03 * rng.standard_normal((500, 3)))
        assert measure_pulls(posterior, draws).is_off == off


def test_other_priors_take_over_machines_within_their_bounds():
    rng = np.random.default_rng(12)
    posterior, _ = make_posterior(rng, draw_truth(rng))
    middle = posterior.names[1]
    narrow = replace(posterior, priors={**posterior.priors, middle: UniformPrior(-0.5, 0.5)})
    y = np.array([[0.4, 0.1, -1.0], [0.4, 2.0, -1.0]])
    moved = narrow.to_coordinates(posterior.theta(y), np.empty((2, 0)))
    np.testing.assert_allclose(narrow.natural(moved[0]), posterior.natural(y[0]), atol=1e-12)
    assert narrow.natural(moved[1])[1] == pytest.approx(0.499)


def test_a_row_that_tells_nothing_needs_no_run():
    """Without redundancy its density is the same for all machines: equal weights, no tail."""
    draws = np.random.default_rng(13).standard_normal((4, 100, 1))
    density = np.concatenate([np.full((4, 100, 1), -3.0), -0.5 * draws**2], axis=-1)
    found = leave_out(draws, density)
    assert found.pareto_k[0] == 0.0
    assert found.elpd[0] == pytest.approx(-3.0)
    assert not found.is_doubtful[0]


def explain(rng, spoilt=0.0):
    """Return what the best machine leaves of 25 poses' readings, the fourth pose's being off by so many deviations."""
    posterior, _ = make_posterior(rng, draw_truth(rng), n_poses=25)
    likelihood = posterior.likelihood
    likelihood.data.values[3, 2] += spoilt * SD
    at = likelihood.explain(*posterior.at(posterior.least_squares_start()[None]))[1]
    nothing = np.empty((25, 0))
    return Residuals(nothing, nothing, nothing, at.square[0], np.ones(25), likelihood.n_spare)


@pytest.mark.runs
def test_no_pose_of_a_clean_study_contradicts_the_others(rng):
    """One study in a hundred at most has such a pose, of however many; a reading twelve deviations off shows."""
    clean = [explain(rng) for _ in range(200)]
    false = sum(bool(one.find_contradicting(False).any()) for one in clean)
    assert false <= binom.ppf(0.995, len(clean), 0.01)
    assert sum(bool((one.chance < 0.01).any()) for one in clean) > binom.ppf(0.995, len(clean), 0.1)  # pose by pose
    named = [np.flatnonzero(explain(rng, 12.0).find_contradicting(False)).tolist() for _ in range(20)]
    assert sum(one == [3] for one in named) >= 18
