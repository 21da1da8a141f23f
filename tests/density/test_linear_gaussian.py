"""Conditioning of linear normal rows against scipy's normal densities and fits that are made again."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayescal.density.linear_gaussian import (
    condition,
    condition_white,
    factorise,
    invert,
    solve_factor,
    weigh,
    weigh_left_out,
    whiten,
)

M, K = 24, 4  # rows, and rows of a group
CLOSE = {"rel": 1e-10, "abs": 1e-10}
SIZES = [3, 25]  # unknowns: on either side of where stacks are factorised matrix by matrix


def spread(rng, *shape):
    """Return covariances (..., n, n)."""
    root = rng.standard_normal(shape)
    return root @ np.swapaxes(root, -1, -2) + np.eye(shape[-1])


def draw_case(rng, n, batch=(), rank=None):
    """Return columns (..., M, n), a prior's precision (..., n, n), noise (..., M, M) and rows (..., M)."""
    columns = rng.standard_normal((*batch, M, n))
    if rank is not None:
        columns = columns[..., :rank] @ rng.standard_normal((*batch, rank, n))
    return columns, spread(rng, *batch, n, n), spread(rng, *batch, M, M), rng.standard_normal((*batch, M))


def given(columns, prior, noise, rows, mean=None):
    """Return unknowns given rows, and the log-density of these."""
    n = columns.shape[-1]
    white, volume = whiten(noise.copy(), np.concatenate([columns, rows[..., None]], axis=-1))
    gram = np.swapaxes(white, -1, -2) @ white
    pull, square = gram[..., :n, n:], gram[..., n:, n:]
    if mean is not None:
        pull = pull + prior @ mean[..., None]
        square = square + np.einsum("...i,...ij,...j->...", mean, prior, mean)[..., None, None]
    found = condition(prior + gram[..., :n, :n], pull, square)
    constant = 0.5 * np.linalg.slogdet(prior)[1] - volume - 0.5 * M * np.log(2.0 * np.pi)
    return found, found.log_marginal + constant


def join(columns, prior, noise):
    """Return the covariance of rows."""
    return noise + columns @ np.linalg.inv(prior) @ columns.T


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("rank", [None, 2], ids=["full", "deficient"])
def test_rows_have_the_marginal_density_and_unknowns_the_conditional_one(n, rank, rng):
    columns, prior, noise, rows = draw_case(rng, n, rank=rank)
    mean = rng.standard_normal(n)
    found, density = given(columns, prior, noise, rows, mean)
    total = join(columns, prior, noise)
    assert density == pytest.approx(multivariate_normal.logpdf(rows, columns @ mean, total), **CLOSE)
    gain = np.linalg.inv(prior) @ columns.T @ np.linalg.inv(total)
    assert found.mean[:, 0] == pytest.approx(mean + gain @ (rows - columns @ mean), **CLOSE)
    expected = np.linalg.inv(prior) - gain @ columns @ np.linalg.inv(prior)
    assert found.covariance == pytest.approx(expected, **CLOSE)
    other = rng.standard_normal((5, 2, n))  # five groups of two rows
    predicted, unknown = found.predict(other)
    assert predicted == pytest.approx(other @ found.mean, **CLOSE)
    assert unknown == pytest.approx(other @ expected @ np.swapaxes(other, -1, -2), **CLOSE)


@pytest.mark.parametrize("n", SIZES)
def test_draws_have_mean_and_covariance(n, rng):
    columns, prior, noise, rows = draw_case(rng, n)
    found, _ = given(columns, prior, noise, rows)
    draws = found.draw(rng.standard_normal((n, 40_000)))
    sd = np.sqrt(np.diag(found.covariance))
    off = (draws.mean(axis=1) - found.mean[:, 0]) / sd
    assert np.abs(off).max() < 4.5 / np.sqrt(draws.shape[1])
    correlation = np.cov(draws) / np.outer(sd, sd)
    expected = found.covariance / np.outer(sd, sd)
    assert np.abs(correlation - expected).max() < 6.0 / np.sqrt(draws.shape[1])
    moved = draws.mean(axis=1) + 0.1 * sd  # what is off by a tenth of a standard deviation is found
    assert np.abs((moved - found.mean[:, 0]) / sd).max() > 4.5 / np.sqrt(draws.shape[1])


@pytest.mark.parametrize("n", SIZES)
def test_batches_are_their_members(n, rng):
    case = draw_case(rng, n, (2, 3))
    found, density = given(*case)
    assert found.mean.shape == (2, 3, n, 1)
    normal = rng.standard_normal((n, 4))  # the same numbers for all of the batch
    draws = found.draw(normal)
    for k in np.ndindex(2, 3):
        alone, expected = given(*(one[k] for one in case))
        assert density[k] == pytest.approx(expected, **CLOSE)
        assert found.mean[k] == pytest.approx(alone.mean, **CLOSE)
        assert found.covariance[k] == pytest.approx(alone.covariance, **CLOSE)
        assert draws[k] == pytest.approx(alone.draw(normal), **CLOSE)


@pytest.mark.parametrize("n", SIZES)
def test_several_rows_share_a_factor(n, rng):
    """What is left of a column whose coefficient is unknown is XᵀS⁻¹X."""
    columns, prior, noise, _ = draw_case(rng, n)
    several = rng.standard_normal((M, 3))
    white, _ = whiten(noise.copy(), np.concatenate([columns, several], axis=1))
    gram = white.T @ white
    found = condition(prior + gram[:n, :n], gram[:n, n:], gram[n:, n:])
    assert found.square == pytest.approx(several.T @ np.linalg.solve(join(columns, prior, noise), several), **CLOSE)
    for k, row in enumerate(several.T):
        assert found.mean[:, k] == pytest.approx(given(columns, prior, noise, row)[0].mean[:, 0], **CLOSE)


@pytest.mark.parametrize("n", SIZES)
def test_groups_left_out_are_predicted_by_a_fit_to_the_others(n, rng):
    columns, prior, noise, rows = draw_case(rng, n)
    noise = noise * np.kron(np.eye(M // K), np.ones((K, K)))  # groups are independent but for the unknowns
    total = join(columns, prior, noise)
    inverse, pull = invert(total.copy(), rows)
    blocks = np.einsum("gigj->gij", inverse.reshape(M // K, K, M // K, K))
    density = weigh_left_out(blocks, pull.reshape(-1, K))
    for group, own in enumerate(np.arange(M).reshape(-1, K)):
        rest = np.setdiff1d(np.arange(M), own)
        white, _ = whiten(noise[np.ix_(rest, rest)], np.column_stack([columns[rest], rows[rest]]))
        refit = condition(prior + white[:, :n].T @ white[:, :n], white[:, :n].T @ white[:, n:], 0.0)
        (mean,), (unknown,) = refit.predict(columns[None, own])
        covariance = unknown + noise[np.ix_(own, own)]
        expected = multivariate_normal.logpdf(rows[own], mean[:, 0], covariance) + 0.5 * K * np.log(2.0 * np.pi)
        assert density[group] == pytest.approx(expected, **CLOSE)
        assert weigh(covariance, rows[own] - mean[:, 0]) == pytest.approx(expected, **CLOSE)
        kept, _ = given(columns, prior, noise, rows)  # a fit that has seen the group is surer of it
        assert (
            np.linalg.slogdet(kept.predict(columns[None, own])[1][0] + noise[np.ix_(own, own)])[1]
            < np.linalg.slogdet(unknown + noise[np.ix_(own, own)])[1]
        )


@pytest.mark.parametrize("n", SIZES)
def test_factors_are_lower_and_solve(n, rng):
    covariance, rows = spread(rng, 3, n, n), rng.standard_normal((3, n, 2))
    factor = np.tril(factorise(covariance.copy()))
    assert factor @ np.swapaxes(factor, -1, -2) == pytest.approx(covariance, **CLOSE)
    assert factor @ solve_factor(factor, rows) == pytest.approx(rows, **CLOSE)
    assert np.swapaxes(factor, -1, -2) @ solve_factor(factor, rows, transposed=True) == pytest.approx(rows, **CLOSE)
    twice = np.stack([factor, 2.0 * factor])  # the same rows for both
    assert twice @ solve_factor(twice, rows) == pytest.approx(np.stack([rows, rows]), **CLOSE)
    inverse, solved = invert(covariance.copy(), rows[..., 0])
    assert np.triu(inverse) == pytest.approx(np.triu(np.linalg.inv(covariance)), **CLOSE)
    assert covariance @ solved[..., None] == pytest.approx(rows[..., :1], **CLOSE)


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("batch", [(), (2,)])
def test_what_is_no_covariance_is_refused(n, batch, rng):
    covariance = spread(rng, *batch, n, n)
    covariance[..., -1, -1] = -1.0
    with pytest.raises(np.linalg.LinAlgError):
        weigh(covariance, rng.standard_normal((*batch, n)))


@pytest.mark.parametrize(("batch", "n"), [((), 0), ((2,), 0), ((0,), 3), ((0,), 25)])
def test_without_unknowns_or_members_there_is_nothing_to_condition(batch, n, rng):
    columns, rows = rng.standard_normal((*batch, M, n)), rng.standard_normal((*batch, M, 1))
    found = condition_white(columns, rows, 1.5)
    assert found.mean.shape == (*batch, n, 1)
    assert found.log_marginal == pytest.approx(1.5 - 0.5 * np.sum(rows**2, axis=(-2, -1)), **CLOSE)


@pytest.mark.parametrize("n", SIZES)
def test_white_rows_of_standard_normal_unknowns(n, rng):
    columns, _, _, rows = draw_case(rng, n)
    found = condition_white(columns, rows[:, None])
    expected, _ = given(columns, np.eye(n), np.eye(M), rows)
    assert found.mean == pytest.approx(expected.mean, **CLOSE)
    density = multivariate_normal.logpdf(rows, cov=np.eye(M) + columns @ columns.T) + 0.5 * M * np.log(2.0 * np.pi)
    assert found.log_marginal == pytest.approx(density, **CLOSE)
