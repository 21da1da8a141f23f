"""Unknown factors on the noise of groups of channels: their posterior by value, and what their intervals hold.

A machine's readings are linear here, so that all of them together are normal given the factors, poses and parameters
integrated: a dense covariance of everything says what the posterior of the factors has to be.
"""

from __future__ import annotations

import numpy as np
import pytest
from calibration_problems import density, linear_model, measurements
from scipy.stats import binom, multivariate_normal

from bayescal.density.calibration.terms import ErrorModel, NoiseFactor
from bayescal.density.outliers import NORMAL, Contaminated, Outliers, StudentT
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior, SharePrior
from bayescal.inference.exploration import explore
from bayescal.inference.importance import resample
from bayescal.inference.mode import find_modes
from bayescal.inference.proposal import MixtureProposal

SD = np.array([0.5, 0.4, 0.3, 0.5, 0.5, 0.6])
FIRST = np.arange(6) < 3
SCALE = 0.5  # sd of the logarithms of both factors
WIDE = 300.0  # sd of a pose's coordinates, instead of a pose that may be anywhere
KEPT = 400
SHARE = 0.05


def problem(rng, factors, n_poses=40, outliers=NORMAL, spoilt=0.0):
    """Return a posterior of six linear readings at each of some poses, two groups of noise; some rows may be spoilt."""
    model = linear_model(np.random.default_rng(5), 6, 2, 3)
    terms = (NoiseFactor("a", FIRST, SCALE), NoiseFactor("b", ~FIRST, SCALE))
    priors = {f"d[{k}]": NormalPrior(0.0, 1.0) for k in (1, 2, 3)}
    noise = np.where(FIRST, *factors) * SD * rng.standard_normal((n_poses, 6))
    wrong = rng.random(n_poses) < spoilt
    channel, size = rng.integers(0, 6, n_poses), rng.choice([-1.0, 1.0], n_poses) * rng.uniform(5.0, 20.0, n_poses)
    noise[wrong, channel[wrong]] += (size * SD[channel])[wrong]
    values = model.read(rng.standard_normal(3), 3.0 * rng.standard_normal((n_poses, 2))) + noise
    return Posterior(density(model, measurements(values, SD)), priors, ErrorModel(terms, outliers))


def test_the_posterior_of_factors_is_that_of_all_readings_at_once(rng):
    """Differences of the log-density, parameters integrated, are those of the dense normal of all 48 readings.

    Poses are integrated, not fitted: fitted ones would cost a degree of freedom for each coordinate.
    """
    posterior, n_poses = problem(rng, (1.3, 0.7), 8).with_pose_guesses(), 8
    model, values = posterior.likelihood.model, posterior.likelihood.data.values
    found, alone, expected = [], [], []
    for zeta in np.array([[0.0, 0.0], [1.0, -0.5], [-1.5, 1.0], [0.3, 2.0]]):
        y = np.zeros(5)
        y[3:] = zeta
        for _ in range(2):  # the log-density is quadratic in the parameters
            gradient, hessian = posterior.gradient(y)
            y[:3] -= np.linalg.solve(hessian[:3, :3], gradient[:3])
        found.append(posterior.log_density(y[None])[0] - 0.5 * np.linalg.slogdet(-hessian[:3, :3])[1])
        alone.append(posterior.linear_geometry(np.zeros(5)).log_mass(zeta[None])[0])
        sd = np.where(FIRST, *np.exp(SCALE * zeta)) * SD
        own = np.diag(sd**2) + WIDE**2 * model.by_pose @ model.by_pose.T
        every = np.tile(model.by_parameters, (n_poses, 1))
        covariance = np.kron(np.eye(n_poses), own) + every @ every.T
        expected.append(multivariate_normal.logpdf(values.ravel(), cov=covariance) - 0.5 * zeta @ zeta)
    np.testing.assert_allclose(np.diff(found), np.diff(expected), atol=1e-3)
    np.testing.assert_allclose(np.diff(alone), np.diff(expected), atol=1e-3)
    assert np.ptp(found) > 10.0  # so that a wrong volume of the poses would show


def test_proposals_reach_where_a_factor_is_large(rng):
    """Few rows hardly tell one group's noise from the other's: geometry follows, and walkers far out do no harm."""
    posterior = problem(rng, (1.3, 0.7), 8).with_pose_guesses()
    found = explore(posterior, np.random.SeedSequence(1))
    assert found.straight.conditional is not None
    assert found.efficiency > 0.5
    far = np.zeros((2, 5))
    far[:, 3:] = [[2e3, 0.0], [0.0, -2e3]]
    assert np.isneginf(found.straight.log_density(far)).all()


def find_intervals(posterior, rng):
    """Return the 90 % intervals of both factors, (2,) each, from weighed draws about the mode."""
    mode = find_modes(posterior)[0]
    factor = np.linalg.cholesky(mode.covariance)
    proposal = MixtureProposal(np.ones(1), mode.y[None], 1.2 * factor[None], 5.0)
    drawn = resample(posterior.log_density, proposal, rng, 4 * KEPT, KEPT)
    assert drawn.efficiency > 0.1
    return np.quantile(posterior.natural(drawn.draws)[:, 3:5], [0.05, 0.95], axis=0)


ROWS: dict[str, tuple[Outliers, float]] = {
    "plain": (NORMAL, 0.0),
    "t, clean rows": (StudentT.centred(4.0), 0.0),
    "t, spoilt rows": (StudentT.centred(4.0), SHARE),
    "outliers, clean rows": (Contaminated(SharePrior(SHARE)), 0.0),
    "outliers, spoilt rows": (Contaminated(SharePrior(SHARE)), SHARE),
}
N_TWINS = 40


def count_held(rng, truth, outliers, spoilt, spoil=1.0):
    """Return how many of the intervals of both factors hold the truth, which ``spoil`` makes another."""
    inside = 0
    for _ in range(N_TWINS):
        found = problem(rng, truth, outliers=outliers, spoilt=spoilt)
        low, high = find_intervals(found, rng)
        inside += int(np.sum((low <= spoil * np.array(truth)) & (spoil * np.array(truth) <= high)))
    return inside


@pytest.mark.slow
@pytest.mark.parametrize(("outliers", "spoilt"), ROWS.values(), ids=ROWS)
def test_intervals_hold_factors_as_often_as_they_say(outliers, spoilt, rng):
    """True factors as a user finds them, clean noise half as large as stated, as stated, twice as large."""
    held = sum(count_held(rng, truth, outliers, spoilt) for truth in ((1.0, 1.0), (0.5, 1.0), (1.0, 2.0)))
    assert held >= binom.ppf(0.005, 3 * 2 * N_TWINS, 0.9)


@pytest.mark.slow
def test_a_factor_that_is_off_shows(rng):
    """By 15 %: so much less came out of a t whose scale was the stated noise."""
    assert count_held(rng, (1.0, 1.0), NORMAL, 0.0, spoil=1.15) < binom.ppf(0.005, 2 * N_TWINS, 0.9)
