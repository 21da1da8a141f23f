"""Rows whose covariance is a sum of matrices times variances, whole and of few columns, against plain normal densities.

Functions that rows see are made of few columns, and what these leave out is independent from row to row.
"""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayescal.density.components import LinearGeometry, LinearRows
from bayescal.density.low_rank_covariance import Interpolated, LowRankCovariance
from bayescal.density.pose_kernels import OWN_COLUMNS, POSE_KERNELS, KernelInput, PoseFunctions
from bayescal.errors import InputError

P, N, LEGS, A = 7, 3, 2, 4
EQUAL, UNEQUAL = np.array([0.4, 0.4, 2.0, 0.3]), np.array([0.4, 1.1, 2.0, 0.3])
TWO_PI = 0.5 * N * np.log(2 * np.pi)


@pytest.fixture(scope="module")
def few():
    """Return rows of few columns."""
    rng = np.random.default_rng(1)
    shown, basis = rng.standard_normal((P, N, LEGS)), rng.standard_normal((LEGS, P, A))
    known = rng.standard_normal((P, N, N))
    known = np.eye(N) + known @ np.swapaxes(known, -1, -2)
    blocks = np.einsum("pki,pli->ipkl", shown, shown)
    return LowRankCovariance(known, blocks, shown, basis, np.array([0, 1, 1, 1]), np.array([0.0, 0.3]))


def plain(few, variances):
    """Return the covariance of all rows."""
    total = np.zeros((P, N, P, N))
    for p in range(P):
        total[p, :, p] += few.known[p] + np.tensordot(variances[:LEGS], few.blocks[:, p], 1)
    for t, variance in enumerate(variances[LEGS:]):
        some = few.basis[..., few.sorts == t]
        kernel = some @ np.swapaxes(some, -1, -2) + few.left[t] * np.eye(P)
        total += variance * np.einsum("pki,ipq,qli->pkql", few.shown, kernel, few.shown)
    return total.reshape(P * N, -1)


@pytest.mark.parametrize("variances", [EQUAL, UNEQUAL])
def test_rows_have_the_normal_density_of_the_sum(few, variances):
    rng = np.random.default_rng(2)
    rows, slopes = rng.standard_normal((3, P * N)), rng.standard_normal((P * N, 5))
    several = np.stack([variances, 0.0 * variances, 30.0 * variances])
    every = np.stack([plain(few, one) for one in several])
    expected = [multivariate_normal.logpdf(row, cov=one) + P * TWO_PI for row, one in zip(rows, every, strict=True)]
    close = {"rel": 1e-9, "abs": 1e-10}
    assert few.weigh(several, rows) == pytest.approx(expected, **close)
    thin, square = few.factorise(variances), slopes.T @ np.linalg.solve(every[0], slopes)
    assert thin.weigh(rows[0]) == pytest.approx(expected[0], **close)
    for found, half_log_det in (few.square(slopes)(variances), thin.square(slopes)):
        assert found == pytest.approx(square, **close)
        assert half_log_det == pytest.approx(0.5 * np.linalg.slogdet(every[0])[1], **close)


def test_each_pose_given_all_others(few):
    whole, row = plain(few, UNEQUAL), np.random.default_rng(3).standard_normal(P * N)
    density = few.factorise(UNEQUAL).weigh_left_out(row)
    for pose in range(P):
        mine, rest = np.split(np.roll(np.arange(P * N), -pose * N), [N])
        given = whole[np.ix_(mine, rest)] @ np.linalg.inv(whole[np.ix_(rest, rest)])
        left, off = whole[np.ix_(mine, mine)] - given @ whole[np.ix_(rest, mine)], row[mine] - given @ row[rest]
        expected = multivariate_normal.logpdf(off, cov=left) + TWO_PI
        assert density[pose] == pytest.approx(expected, rel=1e-9)


def test_coefficients_given_rows_are_those_of_the_joint_normal(few):
    row, sd = np.random.default_rng(3).standard_normal(P * N), np.sqrt(EQUAL[2:][few.sorts])
    columns = np.einsum("pki,ipa->pkia", few.shown, few.basis * sd).reshape(P * N, -1)
    across = np.tile(sd, LEGS)[:, None] * np.linalg.solve(plain(few, EQUAL), columns).T
    thin = few.factorise(EQUAL)
    scale, found = thin.scale[:, None], thin.given(row[:, None])
    assert (scale * found.mean)[:, 0] == pytest.approx(across @ row, rel=1e-9, abs=1e-12)
    expected = np.diag(np.tile(sd**2, LEGS)) - across @ columns * np.tile(sd, LEGS)
    assert scale * found.covariance * scale.T == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_geometry_given_the_errors_is_that_of_the_joint_normal(few):
    rng = np.random.default_rng(5)
    residual, slope, centre = rng.standard_normal(P * N), rng.standard_normal((P * N, 4)), np.arange(4.0)
    square = few.square(np.column_stack([slope, residual]))

    def square_each(zeta):
        found = [square(np.exp(one) * UNEQUAL) for one in zeta]
        return np.stack([one for one, _ in found]), np.array([half for _, half in found])

    rows = LinearRows(np.zeros((4, 4)), np.zeros(4), square_each)
    # a standard normal prior about zero
    linear = LinearGeometry(centre, rows, np.eye(4), -centre, lambda zeta: -0.5 * np.sum(zeta**2, axis=1), np.exp)
    several, expected = np.array([np.zeros(4), [0.5, -1.0, 0.2, 0.3]]), []
    for zeta, mean, covariance in zip(several, *linear.given(several), strict=True):
        noise = plain(few, np.exp(zeta) * UNEQUAL)
        measured = slope @ centre - residual  # rows e = J (y - centre) + residual vanish where J y reads this
        gain = slope.T @ np.linalg.inv(slope @ slope.T + noise)
        assert mean == pytest.approx(gain @ measured, rel=1e-8, abs=1e-10)
        assert covariance == pytest.approx(np.eye(4) - gain @ slope, rel=1e-8, abs=1e-10)
        expected.append(multivariate_normal.logpdf(measured, cov=noise + slope @ slope.T) - 0.5 * zeta @ zeta)
    assert np.diff(linear.log_mass(several)) == pytest.approx(np.diff(expected), rel=1e-9)


# --- few columns -----------------------------------------------------------------------------------------------------


def test_sums_over_rows_are_interpolated_without_loss():
    rng = np.random.default_rng(4)
    values, weights = 10.0 ** rng.uniform(-4.0, 3.0, (40, 1)), rng.uniform(0.5, 2.0, (40, 3))
    sums = Interpolated(values, lambda one: one[:, 0] @ weights)
    v = np.concatenate([[0.0], 10.0 ** np.linspace(-12.0, 8.0, 301)])
    expected = (1.0 / (1.0 + v[:, None] * values[:, 0])) @ weights
    assert np.abs(sums(v) / expected - 1.0).max() < 3e-12


def spread_places(n, seed=5):
    rng = np.random.default_rng(seed)
    return KernelInput(rng.uniform(-0.5, 0.5, (n, 6)), np.arange(n) / n)


def test_few_columns_leave_little_out():
    place, other = spread_places(400), spread_places(30, 6)
    exact = PoseFunctions(tuple(POSE_KERNELS), place)
    few = replace(exact, of_few=place)
    sizes = [one.shape[-1] for one in few.list_bases(other)]
    assert sizes == [6, OWN_COLUMNS, 30, 12]
    assert few.left[:2] == pytest.approx(0.0, abs=1e-8)
    assert 0.01 < few.left[2] < 0.03
    assert few.left[3] == pytest.approx(1.0 / (np.pi**2 * 11) / 0.52, rel=0.1)  # tail of Σ 1 / ω² over the mean of k
    for name, whole, made in zip(POSE_KERNELS, exact.between(other, place), few.between(other, place), strict=True):
        off = np.abs(whole - made).max()
        assert off < ({"linear": 1e-12, "positioning": 1e-7}.get(name, 0.15)), name


@pytest.mark.parametrize("size", [1.0, 1e2, 1e4])
def test_positioning_errors_of_few_columns_have_the_density_of_whole_ones(size):
    """Errors ten thousand times the noise, as where geometry that errs is fixed: columns may leave 1e-8 out."""
    place, rng = spread_places(60, 8), np.random.default_rng(9)
    exact = PoseFunctions(("positioning",), place)
    kernel, few = exact.between(place, place)[0][0], replace(exact, of_few=place)
    factor = np.linalg.cholesky(np.eye(60) + size**2 * kernel)
    rows = factor @ rng.standard_normal((60, 1))
    expected = -0.5 * float((np.linalg.solve(factor, rows) ** 2).sum()) - float(np.log(np.diagonal(factor)).sum())
    one = np.ones((60, 1, 1))
    basis = few.list_bases(place)[0][:1]
    made = LowRankCovariance(one, one[None], one, basis, np.zeros(basis.shape[-1], dtype=int), few.left)
    found = made.weigh(np.array([[0.0, size**2]]), rows.T)[0]
    assert found == pytest.approx(expected, abs=0.05)


def test_norms_take_no_matrix_of_all_poses():
    place = spread_places(40_000)
    tracemalloc.start()
    norms = PoseFunctions(tuple(POSE_KERNELS), place).norms
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3e7
    some = KernelInput(place.travel[:2000], place.time[::20])
    kernels = [POSE_KERNELS[name].between(some, some) for name in POSE_KERNELS]
    expected = [np.diagonal(one, axis1=1, axis2=2).mean() for one in kernels]
    assert norms == pytest.approx(expected, rel=0.03)


def test_poses_at_home_have_no_functions():
    place = spread_places(5)
    functions = PoseFunctions(("linear",), place._replace(travel=0.0 * place.travel))
    with pytest.raises(InputError, match="at home"):
        functions.between(place, place)
