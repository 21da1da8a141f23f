"""Errors that rows have in common, known but for their coefficients, and noise that depends on them: a dense Gaussian.

With k ~ N(0, 1) in columns A and cov(noise, k) = G the rows have the covariance R + A Aᵀ + A Gᵀ + G Aᵀ. Poses lie
anywhere: projections of all rows that no pose moves are normal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from calibration_problems import correlation_of, density, linear_model, measurements
from scipy.linalg import block_diag, null_space
from scipy.stats import multivariate_normal

from bayescal.density.calibration.terms import CorrelatedNoise, ErrorModel, ErrorTerm, ModelErrorTerm
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior

P, K, Q, N = 5, 6, 2, 3
DRAWS = 20_000


@dataclass(frozen=True, eq=False)
class Sized(ErrorTerm):
    """Errors common to all rows whose size is not known."""

    design: np.ndarray
    names, units, priors = ("size",), ("1",), (NormalPrior(1.0, 0.3),)

    def columns(self, zeta, data):
        return self.amplitude(zeta)[:, None, None, None] * self.act(data)

    def act(self, data):
        return self.design[data.order]

    def amplitude(self, zeta):
        return self.priors[0].value(zeta[..., 0])


@pytest.fixture(scope="module")
def problem():
    """Return a posterior with such errors and one unknown τ, A and G (P, K, N)."""
    rng = np.random.default_rng(5)
    model, sd = linear_model(rng, K, Q), rng.uniform(0.5, 2.0, K)
    data = measurements(3.0 * rng.standard_normal((P, K)), sd, correlation_of(rng, K))
    root = np.linalg.cholesky(data.correlation[0] * np.outer(sd, sd))
    share = 0.6 * np.linalg.qr(rng.standard_normal((P * K, N)))[0]  # of the noise, that depends on them
    design, across = rng.standard_normal((P, K, N)), root @ share.reshape(P, K, N)
    tau = ModelErrorTerm("first", np.arange(K) < 2, 0.5, "mm")
    errors = ErrorModel((tau, CorrelatedNoise(design + across), CorrelatedNoise(across, -1.0)))
    priors = {f"d[{k + 1}]": NormalPrior(0.0, 1.0) for k in range(3)}
    return Posterior(density(model, data), priors, errors), design, across


def join(problem, y):
    """Return rows (P K,) of what a machine leaves of the readings, their covariance and that with k (P K, N)."""
    posterior, design, across = problem
    likelihood, zeta = posterior.likelihood, posterior.zeta(y[None])
    own, beside = posterior.errors.noise(zeta, likelihood.data, likelihood.sd)
    noise = own[0][:, :, None] * likelihood.correlation * own[0][:, None] + beside[0][:, :, None] ** 2 * np.eye(K)
    a, g = design.reshape(P * K, N), across.reshape(P * K, N)
    covariance = block_diag(*noise) + a @ a.T + a @ g.T + g @ a.T
    rows = likelihood.data.values - likelihood.model.by_parameters @ posterior.theta(y[None])[0]
    return rows.ravel(), covariance, a + g


def eliminate(problem):
    """Return an orthonormal basis of the rows that no pose moves, and ½ log |HᵀH| of all."""
    slope = block_diag(*[problem[0].likelihood.model.by_pose] * P)
    return null_space(slope.T), 0.5 * np.linalg.slogdet(slope.T @ slope)[1]


def test_density_is_that_of_all_rows_together(problem):
    posterior, design, across = problem
    basis, volume = eliminate(problem)
    y = 0.5 * np.random.default_rng(1).standard_normal((4, posterior.n_parameters))
    expected, without = [], []
    for one in y:
        rows, covariance, _ = join(problem, one)
        apart = covariance - design.reshape(P * K, N) @ across.reshape(P * K, N).T
        apart = apart - across.reshape(P * K, N) @ design.reshape(P * K, N).T
        for found, of in ((expected, covariance), (without, apart)):
            found.append(multivariate_normal.logpdf(basis.T @ rows, cov=basis.T @ of @ basis) - volume)
    found = posterior.likelihood.density(*posterior.at(y))
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert np.abs(found - without).min() > 0.05  # that noise depends on them counts


def test_each_row_given_all_others_and_others_given_these(problem):
    posterior, *_ = problem
    y = 0.5 * np.random.default_rng(2).standard_normal((3, posterior.n_parameters))
    theta, errors, zeta = posterior.at(y)
    likelihood = posterior.likelihood
    whole, each = likelihood.density(theta, errors, zeta), likelihood.density_by_row(theta, errors, zeta)
    for row in (0, 3):
        others = np.arange(P) != row
        rest = likelihood.pick(others)
        np.testing.assert_allclose(each[:, row], whole - rest.density(theta, errors, zeta), rtol=1e-8, atol=1e-8)
        one = rest.density_of_others(likelihood.pick(~others), theta, errors, zeta)
        np.testing.assert_allclose(one[:, 0], each[:, row], rtol=1e-8, atol=1e-8)


def test_slopes_are_those_of_differences(problem):
    posterior, *_ = problem
    y, step = 0.3 * np.random.default_rng(3).standard_normal(posterior.n_parameters), 1e-5
    steps = step * np.eye(len(y))
    expected = (posterior.log_density(y + steps) - posterior.log_density(y - steps)) / (2.0 * step)
    gradient, _ = posterior.gradient(y)
    np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=1e-5)
    theta, change = posterior.around(y)
    basis, _ = eliminate(problem)
    _, covariance, _ = join(problem, y)
    seen = basis.T @ np.tile(posterior.likelihood.model.by_parameters @ change, (P, 1))
    information = seen.T @ np.linalg.solve(basis.T @ covariance @ basis, seen)
    found = posterior.likelihood.inform(theta, change, posterior.errors, posterior.zeta(y))
    np.testing.assert_allclose(found, information, rtol=1e-8)


def test_draws_of_them_given_the_readings_have_their_mean_and_covariance(problem):
    posterior, design, across = problem
    y = np.tile(0.3 * np.random.default_rng(4).standard_normal(posterior.n_parameters), (DRAWS, 1))
    drawn = posterior.likelihood.draw_common(*posterior.at(y), np.random.default_rng(6))
    coefficients = np.concatenate([one for _, one in drawn.parts])
    rows, covariance, both = join(problem, y[0])
    basis, _ = eliminate(problem)
    told = (basis.T @ both).T @ np.linalg.inv(basis.T @ covariance @ basis)
    mean, spread = told @ (basis.T @ rows), np.eye(N) - told @ basis.T @ both
    error = np.sqrt(np.diag(spread) / DRAWS)
    assert (np.abs(coefficients[:, :N].mean(axis=0) - mean) < 4.5 * error).all()
    np.testing.assert_allclose(np.cov(coefficients[:, :N].T), spread, atol=5.0 * spread.max() / np.sqrt(DRAWS))
    assert not coefficients[:, N:].any()
    shown = drawn.at(posterior.likelihood.data)
    np.testing.assert_allclose(shown, np.einsum("pkn,tn->tpk", design + across, coefficients[:, :N]), atol=1e-12)


def test_functions_beside_them_leave_the_density_of_all_rows(problem):
    """Anchored with an error of a free size beside: by one covariance of all rows as by columns."""
    posterior = problem[0]
    more = Sized(np.random.default_rng(8).standard_normal((P, K, 2)))
    both = replace(posterior, errors=ErrorModel((*posterior.errors.terms, more)))
    anchored = both.with_pose_guesses()
    assert anchored.likelihood.frozen is not None
    y = 0.3 * np.random.default_rng(9).standard_normal((4, both.n_parameters))
    np.testing.assert_allclose(anchored.log_density(y), both.log_density(y), rtol=0, atol=1e-6)
    drawn = anchored.likelihood.draw_common(*anchored.at(np.tile(y[0], (DRAWS, 1))), np.random.default_rng(1))
    other = both.likelihood.draw_common(*both.at(np.tile(y[0], (DRAWS, 1))), np.random.default_rng(2))
    first, second = (one.at(posterior.likelihood.data).reshape(DRAWS, -1) for one in (drawn, other))
    sd = second.std(axis=0)
    assert (np.abs(first.mean(axis=0) - second.mean(axis=0)) < 6.5 * sd / np.sqrt(DRAWS)).all()
    np.testing.assert_allclose(first.std(axis=0), sd, rtol=0.05)


def test_terms_that_hold_arrays_are_told_apart():
    @dataclass
    class Shared(ErrorTerm):  # as a user writes it: its equality compares arrays
        each: np.ndarray
        names = units = priors = ()

        def columns(self, zeta, data):
            return self.each[data.order][None]

    one, other = (Shared(np.ones((4, 2, 3))) for _ in range(2))
    errors = ErrorModel((one, other))
    assert [term is other for term in errors.without([one]).terms] == [True]
    assert errors.without(errors.common).terms == ()
