"""Both evidence estimators against closed forms, their standard errors put to the test, and controls that must fail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import stats
from scipy.special import loggamma

from bayescal.errors import NumericalError
from bayescal.inference.bridge import estimate_by_bridge
from bayescal.inference.ensemble import run_ensemble
from bayescal.inference.importance import difference_twice, estimate_by_importance, smooth_weights
from bayescal.inference.proposal import MixtureProposal, proposal_from_draws

TOLERANCE = 0.02
NOISE = 0.3


@dataclass(frozen=True, eq=False)
class LinearGaussian:
    """Data d = X y + noise with a standard normal prior on y: density, posterior and evidence in closed form."""

    design: np.ndarray
    data: np.ndarray

    def log_density(self, y):
        """Return log-likelihood plus log-prior, (B, n) to (B,)."""
        residual = (self.data - y @ self.design.T) / NOISE
        constant = self.data.size * np.log(NOISE) + 0.5 * (self.data.size + y.shape[1]) * np.log(2 * np.pi)
        return -0.5 * np.sum(residual**2, axis=1) - 0.5 * np.sum(y**2, axis=1) - constant

    @property
    def log_evidence(self):
        """Return the log-density of the data."""
        covariance = self.design @ self.design.T + NOISE**2 * np.eye(self.data.size)
        return stats.multivariate_normal(np.zeros(self.data.size), covariance).logpdf(self.data)

    def proposal(self, dof):
        """Return the posterior as a Student t with the given degrees of freedom."""
        covariance = np.linalg.inv(self.design.T @ self.design / NOISE**2 + np.eye(self.design.shape[1]))
        mean = covariance @ self.design.T @ self.data / NOISE**2
        return MixtureProposal(np.ones(1), mean[None], np.linalg.cholesky(covariance)[None], dof)

    def without(self, datum):
        """Return the same problem with one datum dropped."""
        return LinearGaussian(np.delete(self.design, datum, axis=0), np.delete(self.data, datum))


def build(n_data=240, n=60):
    """Return a problem of the size of a calibration, unevenly conditioned."""
    rng = np.random.default_rng(60)
    design = rng.standard_normal((n_data, n)) @ np.diag(np.geomspace(0.05, 2.0, n))
    return LinearGaussian(design, design @ rng.standard_normal(n) + NOISE * rng.standard_normal(n_data))


def draw_chains(log_density, proposal, seed, n_walkers=128, n_burn_in=30, n_steps=80, n_ensembles=4):
    """Return chains (ensembles, walkers, steps, n) and their log-densities."""
    seeds = np.random.SeedSequence(seed).spawn(n_ensembles)
    runs = [run_ensemble(log_density, proposal, s, n_walkers, n_burn_in, n_steps) for s in seeds]
    return np.stack([run.draws for run in runs]), np.stack([run.log_density for run in runs])


@pytest.fixture(scope="module")
def problem():
    """Return the linear-Gaussian problem."""
    return build()


def test_importance_meets_the_closed_form(problem):
    found = estimate_by_importance(problem.log_density, problem.proposal(50.0), np.random.default_rng(1), 30_000)
    assert abs(found.log_evidence - problem.log_evidence) < TOLERANCE
    assert abs(found.log_evidence - problem.log_evidence) < 4 * found.standard_error
    assert found.standard_error < TOLERANCE / 4
    assert 0.3 < found.efficiency <= 1.0
    assert found.n_draws == 30_000
    assert found.pareto_k < 0.5


def test_bridge_meets_the_closed_form(problem):
    draws, densities = draw_chains(problem.log_density, problem.proposal(20.0), seed=2)
    found = estimate_by_bridge(problem.log_density, draws, densities, np.random.default_rng(3), 20_000)
    assert found.converged
    assert abs(found.log_evidence - problem.log_evidence) < TOLERANCE
    assert abs(found.log_evidence - problem.log_evidence) < 4 * found.standard_error
    assert found.standard_error < TOLERANCE / 2


@pytest.mark.parametrize("datum", [0, 100, 239])
def test_a_dropped_datum_shows(problem, datum):
    """Negative control: a density wrong by one of 240 data is off by far more than the tolerance."""
    less = problem.without(datum)
    found = estimate_by_importance(less.log_density, less.proposal(50.0), np.random.default_rng(1), 10_000)
    assert abs(found.log_evidence - problem.log_evidence) > 5 * TOLERANCE
    assert abs(found.log_evidence - less.log_evidence) < TOLERANCE
    draws, densities = draw_chains(less.log_density, less.proposal(20.0), seed=2, n_steps=40)
    bridge = estimate_by_bridge(less.log_density, draws, densities, np.random.default_rng(3), 10_000)
    assert abs(bridge.log_evidence - problem.log_evidence) > 5 * TOLERANCE


def test_an_unnormalised_proposal_shows(problem):
    """Negative control: component weights that sum to 1.05 shift the importance estimate by log 1.05."""
    good = problem.proposal(50.0)

    class Unnormalised(MixtureProposal):
        def log_density(self, y):
            return super().log_density(y) + np.log(1.05)

    wrong = Unnormalised(good.weights, good.means, good.factors, good.dof)
    found = estimate_by_importance(problem.log_density, wrong, np.random.default_rng(1), 30_000)
    assert abs(found.log_evidence - problem.log_evidence) > 2 * TOLERANCE
    assert found.log_evidence - problem.log_evidence == pytest.approx(-np.log(1.05), abs=TOLERANCE)


def test_a_missing_tail_shows():
    """Negative control: a proposal far too narrow misses mass, and its Pareto k says so."""
    problem = build(40, 5)
    good = problem.proposal(1e6)
    narrow = MixtureProposal(good.weights, good.means, 0.35 * good.factors, good.dof)
    found = estimate_by_importance(problem.log_density, narrow, np.random.default_rng(1), 4000)
    assert abs(found.log_evidence - problem.log_evidence) > TOLERANCE
    assert found.pareto_k > 0.7
    assert found.efficiency < 0.1


def check_standard_errors(estimate, truth):
    """Check that the errors of twenty estimates are as large as their own standard errors say, and zero on average."""
    z = np.array([(one.log_evidence - truth) / one.standard_error for one in map(estimate, range(20))])
    assert 0.6 < np.std(z, ddof=1) < 1.5
    assert abs(np.mean(z)) < 3 / np.sqrt(20)


def test_importance_standard_errors_are_honest(problem):
    proposal = problem.proposal(8.0)

    def estimate(seed):
        return estimate_by_importance(problem.log_density, proposal, np.random.default_rng(seed), 3000)

    check_standard_errors(estimate, problem.log_evidence)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("n_steps", "n_proposal"), [(40, 4000), (80, 200), (3, 40_000)], ids=["both", "few proposed", "few drawn"]
)
def test_bridge_standard_errors_are_honest(problem, n_steps, n_proposal):
    """Where either half of the bridge is the weaker one, so that neither half's error can be left out."""

    def estimate(seed):
        draws, densities = draw_chains(problem.log_density, problem.proposal(20.0), 100 + seed, n_steps=n_steps)
        return estimate_by_bridge(problem.log_density, draws, densities, np.random.default_rng(seed), n_proposal)

    check_standard_errors(estimate, problem.log_evidence)


def test_draws_go_on_until_the_standard_error_is_reached(problem):
    proposal = problem.proposal(8.0)
    short = estimate_by_importance(problem.log_density, proposal, np.random.default_rng(5), 1000)
    target = 0.4 * short.standard_error
    found = estimate_by_importance(problem.log_density, proposal, np.random.default_rng(5), 1000, target, 100_000)
    assert found.standard_error <= target
    assert found.n_draws % 1000 == 0
    assert 3000 <= found.n_draws < 20_000
    capped = estimate_by_importance(problem.log_density, proposal, np.random.default_rng(5), 1000, target, 2500)
    assert capped.n_draws == 2000
    assert capped.standard_error > target


def test_no_density_anywhere_is_an_error():
    proposal = MixtureProposal(np.ones(1), np.zeros((1, 2)), np.eye(2)[None], 8.0)
    with pytest.raises(NumericalError, match="finite density"):
        estimate_by_importance(lambda y: np.full(len(y), -np.inf), proposal, np.random.default_rng(1), 100)


# --- targets that are no Gaussian ------------------------------------------------------------------------------------

LOG_CONSTANT = 7.25


def funnel(y):
    """Return a funnel: v normal, two more with standard deviation exp(v / 2), times a known constant."""
    v, rest = y[:, 0], y[:, 1:]
    inner = -0.5 * np.sum(rest**2 * np.exp(-v)[:, None], axis=1) - 0.5 * rest.shape[1] * (v + np.log(2 * np.pi))
    return LOG_CONSTANT + stats.norm.logpdf(v) + inner


def skew(y):
    """Return independent logarithms of gamma variates of shapes 1, 2 and 4, times a known constant."""
    shapes = np.array([1.0, 2.0, 4.0])
    return LOG_CONSTANT + np.sum(shapes * y - np.exp(y) - loggamma(shapes).real, axis=1)


def exact_draws(target, n, rng):
    """Return independent draws of a target."""
    if target is skew:
        return np.log(rng.gamma([1.0, 2.0, 4.0], size=(n, 3)))
    v = rng.standard_normal((n, 1))
    return np.concatenate([v, np.exp(0.5 * v) * rng.standard_normal((n, 2))], axis=1)


@pytest.mark.parametrize("target", [funnel, skew])
def test_known_constant_of_a_target_that_is_no_gaussian(target):
    proposal = proposal_from_draws(exact_draws(target, 4000, np.random.default_rng(4)), 4.0)
    importance = estimate_by_importance(target, proposal, np.random.default_rng(6), 40_000)
    assert abs(importance.log_evidence - LOG_CONSTANT) < min(4 * importance.standard_error, 2 * TOLERANCE)
    draws, densities = draw_chains(target, proposal, seed=8, n_walkers=128, n_burn_in=30, n_steps=62)
    bridge = estimate_by_bridge(target, draws, densities, np.random.default_rng(9), 20_000)
    assert abs(bridge.log_evidence - LOG_CONSTANT) < min(4 * bridge.standard_error, 2 * TOLERANCE)
    assert importance.standard_error < TOLERANCE
    assert bridge.standard_error < TOLERANCE


# --- the proposal itself ---------------------------------------------------------------------------------------------


def test_mixture_density_matches_scipy(rng):
    factors = np.tril(rng.uniform(0.2, 1.0, (2, 3, 3)))
    mixture = MixtureProposal(np.array([0.3, 0.7]), rng.standard_normal((2, 3)), factors, 6.0)
    y = rng.standard_normal((10, 3))
    parts = [
        weight * stats.multivariate_t(mean, factor @ factor.T, df=6.0).pdf(y)
        for weight, mean, factor in zip(mixture.weights, mixture.means, factors, strict=True)
    ]
    np.testing.assert_allclose(mixture.log_density(y), np.log(sum(parts)), rtol=1e-10)


def test_mixture_draws_follow_its_density(rng):
    """E[q2 / q1] over draws of q1 is one for any other density q2; and the share of each component is its weight."""
    factors = np.stack([np.diag([0.5, 1.0]), np.array([[0.8, 0.0], [0.6, 0.4]])])
    mixture = MixtureProposal(np.array([0.25, 0.75]), np.array([[-6.0, 0.0], [4.0, 2.0]]), factors, 5.0)
    draws = mixture.draw(20_000, rng)
    assert abs(np.mean(draws[:, 0] < -2) - 0.25) < 0.02
    for mean in mixture.means:
        other = stats.multivariate_normal(mean, 0.2 * np.eye(2)).logpdf(draws)
        ratio = np.exp(other - mixture.log_density(draws))
        assert abs(ratio.mean() - 1) < 4.5 * ratio.std() / np.sqrt(len(ratio))
        assert ratio.std() / np.sqrt(len(ratio)) < 0.05


WEIGHTS = {
    **{f"heavy {x}": (x * np.random.default_rng(1).exponential(size=500), True) for x in (50.0, 120.0, 500.0)},
    **{f"{n}": (np.random.default_rng(2).normal(size=n), n < 25) for n in (1, 24, 100)},  # a tail needs some
    "equal": (np.repeat([0.0, 1.0], [300, 200]), True),  # no distribution can be fitted to such a tail
}


@pytest.mark.parametrize("weights", WEIGHTS)
def test_a_tail_too_heavy_or_too_short_is_said_without_a_warning(weights):
    log_weights, is_said = WEIGHTS[weights]
    smoothed, pareto_k = smooth_weights(log_weights)
    assert (pareto_k > 0.7) == is_said
    assert np.exp(smoothed).sum() == pytest.approx(1.0)


def test_a_component_without_weight_adds_nothing():
    two = MixtureProposal(np.array([1.0, 0.0]), np.array([[0.0], [5.0]]), np.ones((2, 1, 1)), 50.0)
    one = MixtureProposal(np.ones(1), np.zeros((1, 1)), np.ones((1, 1, 1)), 50.0)
    y = np.linspace(-3.0, 8.0, 12)[:, None]
    np.testing.assert_array_equal(two.log_density(y), one.log_density(y))


@pytest.mark.parametrize("at_once", [2**14, 5])
def test_differences_of_a_quartic(monkeypatch, at_once):
    monkeypatch.setattr("bayescal.inference.importance.AT_ONCE", at_once)
    rng = np.random.default_rng(0)
    matrix, centre = rng.standard_normal((4, 4)), rng.standard_normal(4)
    square = matrix @ matrix.T
    factor = np.linalg.cholesky(np.linalg.inv(square + np.eye(4)))

    def log_density(x):
        return -0.5 * np.einsum("bi,ij,bj->b", x, square, x) - 1e-3 * np.sum(x**4, axis=1)

    gradient, hessian = difference_twice(log_density, centre, factor, 1e-2)
    slope = -square @ centre - 4e-3 * centre**3
    curvature = -square - np.diag(12e-3 * centre**2)
    np.testing.assert_allclose(gradient, factor.T @ slope, rtol=1e-5)
    np.testing.assert_allclose(hessian, factor.T @ curvature @ factor, rtol=1e-4, atol=1e-6)
