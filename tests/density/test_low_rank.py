"""Coefficients common to all rows, integrated out: exact without outliers, by Laplace's method with them."""

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from bayescal.density.low_rank import factor_by_columns, find_coefficients, gather_columns
from bayescal.density.outliers import NORMAL, StudentT
from bayescal.numerics.scratch import Scratch

M = 4  # rows of each pose


def draw(rng, n_poses, outliers, size=1.0, spoilt=0):
    """Return rows (1, P, m) and columns (1, P, m, 2) with outliers as their density says, and some grosser ones."""
    columns = size * rng.standard_normal((n_poses, M, 2))
    noise = rng.standard_normal((n_poses, M))
    noise *= np.sqrt(outliers.draw_wide((1, n_poses, 1), rng)[0])
    error = columns @ rng.standard_normal(2) + noise
    error[:spoilt] += 30.0
    return error[None], columns[None]


def evaluate(error, columns, outliers):
    """Return the log-density of rows."""
    spare = np.full(error.shape[1], M)
    found = find_coefficients(error, columns, outliers, spare)
    return outliers.weigh(found.square, spare).sum(axis=1) + found.penalty


def integrate(error, columns, outliers):
    """Return the same by quadrature over both coefficients."""
    spare = np.full(error.shape[1], M)
    found = find_coefficients(error, columns, outliers, spare)
    factor, steps = np.linalg.cholesky(found.inverse[0]), np.linspace(-7.0, 7.0, 71)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    u = found.mean[0] + grid @ factor.T
    square = ((error[0] - np.einsum("pkn,gn->gpk", columns[0], u)) ** 2).sum(axis=-1)
    inside = outliers.weigh(square, spare).sum(axis=1) - 0.5 * (u**2).sum(axis=1) - np.log(2.0 * np.pi)
    return logsumexp(inside) + np.linalg.slogdet(factor)[1] + 2.0 * np.log(steps[1] - steps[0])


def test_without_outliers_it_is_a_dense_normal(rng):
    error, columns = draw(rng, 6, NORMAL)
    flat = columns.reshape(-1, 2)
    dense = multivariate_normal(np.zeros(len(flat)), np.eye(len(flat)) + flat @ flat.T)
    assert evaluate(error, columns, NORMAL)[0] == pytest.approx(dense.logpdf(error.ravel()), rel=1e-12)


@pytest.mark.parametrize("n_poses", [10, 40, 160])
@pytest.mark.parametrize(("nu", "share"), [(2.0, 1.2), (4.0, 0.6), (30.0, 0.15)])
@pytest.mark.parametrize("spoilt", [0, 3])
def test_laplace_is_close_to_quadrature_and_the_closer_the_more_rows(n_poses, nu, share, spoilt, rng):
    """The error in nats falls with the number of poses that tell something, as the docstring says."""
    outliers = StudentT(nu)
    off = []
    for _ in range(4):
        case = draw(rng, n_poses, outliers, spoilt=spoilt)
        off.append(evaluate(*case, outliers)[0] - integrate(*case, outliers))
    assert np.abs(off).max() < share / (n_poses - spoilt)


def test_the_curvature_of_weights_alone_would_be_far_off(rng):
    """What of the curvature comes from the weights' change is a tenth of a nat for each coefficient."""
    outliers, spare = StudentT(4.0), np.full(40, M)
    error, columns = draw(rng, 40, outliers)
    found = find_coefficients(error, columns, outliers, spare)
    flat = (np.sqrt(found.trust)[..., None, None] * columns).reshape(-1, 2)
    rough = -0.5 * np.linalg.slogdet(np.eye(2) + flat.T @ flat)[1]
    assert abs(found.log_volume[0] - rough) > 0.1
    assert abs(evaluate(error, columns, outliers)[0] - integrate(error, columns, outliers)) < 0.02


@pytest.mark.parametrize(("outliers", "limit"), [(NORMAL, 1e-9), (StudentT(4.0), 0.03)], ids=["normal", "robust"])
def test_a_pose_given_the_others_is_the_ratio_of_densities(outliers, limit, rng):
    error, columns = draw(rng, 30, outliers, size=0.3, spoilt=1)
    spare = np.full(30, M)
    found = find_coefficients(error, columns, outliers, spare)
    each, whole = found.condition_each(outliers, spare)[0], integrate(error, columns, outliers)
    for p in range(4):
        others = np.arange(30) != p
        rest = error[:, others], columns[:, others]
        expected = whole - integrate(*rest, outliers)
        assert each[p] == pytest.approx(expected, abs=max(limit, 1e-6))
        told = find_coefficients(*rest, outliers, spare[1:])
        predicted = told.condition_others(error[:, [p]], columns[:, [p]], outliers, spare[:1])
        assert predicted[0, 0] == pytest.approx(expected, abs=max(limit, 1e-6))


def test_machines_are_worked_on_by_themselves_and_those_that_cannot_stand_left_out(rng):
    outliers, spare = StudentT(3.0), np.full(8, M)
    pairs = [draw(rng, 8, outliers) for _ in range(3)]
    error, columns = (np.concatenate(one) for one in zip(*pairs, strict=True))
    error[1] = np.nan
    found = find_coefficients(error, columns, outliers, spare)
    assert np.isnan(found.residual[1]).all()
    for k in (0, 2):
        alone = find_coefficients(*pairs[k], outliers, spare)
        np.testing.assert_allclose(found.mean[k], alone.mean[0], rtol=0, atol=1e-12)
        assert found.penalty[k] == pytest.approx(alone.penalty[0], abs=1e-12)


def test_columns_that_are_taken_away_make_a_dense_normal_of_correlated_noise(rng):
    """k ~ N(0, 1) in columns A, and noise with the covariance G with k: (A + G)(A + G)ᵀ - G Gᵀ beside that of noise."""
    n, k = 6, 3
    design, across = rng.standard_normal((n * M, k)), 0.15 * rng.standard_normal((n * M, k))
    covariance = np.eye(n * M) + design @ design.T + design @ across.T + across @ design.T
    error = np.linalg.cholesky(covariance) @ rng.standard_normal(n * M)
    columns = np.concatenate([design + across, across], axis=1).reshape(1, n, M, -1)
    signs, spare = np.repeat([1.0, -1.0], k), np.full(n, M)
    found = find_coefficients(error.reshape(1, n, M), columns, NORMAL, spare, signs)
    expected = multivariate_normal(np.zeros(n * M), covariance)
    log_density = NORMAL.weigh(found.square, spare).sum() + found.penalty[0]
    assert log_density == pytest.approx(expected.logpdf(error), rel=1e-10)
    assert (
        abs(
            log_density
            - multivariate_normal(np.zeros(n * M), covariance - design @ across.T - across @ design.T).logpdf(error)
        )
        > 0.1
    )
    # k and the rows are normal together, with covariance A + G
    told = (design + across).T @ np.linalg.inv(covariance)
    draws = np.concatenate([found.draw(rng) for _ in range(4000)])[:, :k]
    spread = np.eye(k) - told @ (design + across)
    assert np.abs(draws.mean(axis=0) - told @ error).max() < 4.5 * np.sqrt(np.diag(spread).max() / 4000)
    np.testing.assert_allclose(np.cov(draws.T), spread, atol=0.1 * np.diag(spread).max())


def test_factors_by_columns_are_those_of_each_matrix(rng):
    """Of all poses and machines together, with model errors that add to the diagonal."""
    known, tau, errors = rng.standard_normal((5, M, M)), rng.uniform(0.0, 2.0, (M, 3)), rng.standard_normal((M, 5, 3))
    known = np.eye(M) + known @ np.swapaxes(known, -1, -2)
    density, square = factor_by_columns(known, lambda j: tau[j] ** 2, errors, Scratch())
    for p in range(5):
        for b in range(3):
            expected = multivariate_normal(np.zeros(M), known[p] + np.diag(tau[:, b] ** 2)).logpdf(errors[:, p, b])
            assert density[p, b] == pytest.approx(expected + 0.5 * M * np.log(2 * np.pi), rel=1e-10)
            own = np.linalg.solve(known[p] + np.diag(tau[:, b] ** 2), errors[:, p, b])
            assert square[p, b] == pytest.approx(errors[:, p, b] @ own, rel=1e-10)


def test_more_columns_than_rows_are_gathered():
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((2, 3, 2, 9))
    flat, found = columns.reshape(2, 6, 9), gather_columns(columns)
    assert found.shape == (2, 3, 2, 6)
    own = found.reshape(2, 6, 6)
    np.testing.assert_allclose(own @ own.swapaxes(1, 2), flat @ flat.swapaxes(1, 2), rtol=1e-8, atol=1e-8)


def test_columns_without_a_covariance_raise_nothing():
    columns = np.ones((1, 2, 1, 5))
    columns[0, 0] = np.nan  # a machine that does not reach a row
    assert np.isnan(gather_columns(columns)).any()
