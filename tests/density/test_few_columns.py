"""Rows of many poses, by few columns: against the dense covariance, and in memory; legs' are in `test_functions`."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import telescope_machines as machines
from test_functions import build_posterior

from bayescal.density.components import Components
from bayescal.density.few_columns import Interpolated, LowRankComponents
from bayescal.density.functions import FunctionLikelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.sorts import SORTS, Place, PoseFunctions

P, N, LEGS, A = 7, 3, 2, 4
EQUAL, UNEQUAL = np.array([0.4, 0.4, 2.0, 0.3]), np.array([0.4, 1.1, 2.0, 0.3])


@pytest.fixture(scope="module")
def pair():
    """Return rows of few columns, and the same with whole matrices."""
    rng = np.random.default_rng(1)
    shown, basis = rng.standard_normal((P, N, LEGS)), rng.standard_normal((LEGS, P, A))
    known, sorts, left = rng.standard_normal((P, N, N)), np.array([0, 1, 1, 1]), np.array([0.0, 0.3])
    known = np.eye(N) + known @ np.swapaxes(known, -1, -2)
    blocks = np.einsum("pki,pli->ipkl", shown, shown)
    parts = np.zeros((2, P, N, P, N))
    for t in range(2):
        some = basis[..., sorts == t]
        kernel = some @ np.swapaxes(some, -1, -2) + left[t] * np.eye(P)
        parts[t] = np.einsum("pki,ipq,qli->pkql", shown, kernel, shown)
    few = LowRankComponents(known, blocks, shown, basis, sorts, left)
    return few, Components(known, blocks, parts.reshape(2, P * N, P * N))


@pytest.mark.parametrize("variances", [EQUAL, UNEQUAL])
def test_all_is_as_with_whole_matrices(pair, variances):
    few, whole = pair
    rng = np.random.default_rng(2)
    rows, slopes = rng.standard_normal((3, P * N)), rng.standard_normal((P * N, 5))
    several = np.stack([variances, 0.0 * variances, 30.0 * variances])
    close = {"rel": 1e-9, "abs": 1e-10}
    assert few.weigh(several, rows) == pytest.approx(whole.weigh(several, rows), **close)
    for one, other in zip(few.leave_out(several, rows), whole.leave_out(several, rows), strict=True):
        assert one == pytest.approx(other, **close)
    for one, other in zip(few.weigh_each(several, rows), whole.weigh_each(several, rows), strict=True):
        assert one == pytest.approx(other, **close)
    thin, white = few.factorise(variances), whole.factorise(variances)
    assert thin.half_log_det == pytest.approx(white.half_log_det, **close)
    assert thin.solve(slopes) == pytest.approx(white.solve(slopes), **close)
    square = white.square(slopes)
    assert thin.square(slopes) == pytest.approx(square, **close)
    assert thin.rows(slopes).T @ thin.rows(slopes) == pytest.approx(square, **close)
    found, half_log_det = few.square(slopes)(variances)
    assert found == pytest.approx(square, **close)
    assert half_log_det == pytest.approx(white.half_log_det, **close)
    assert few.act(rows[0]) == pytest.approx(whole.act(rows[0]), **close)
    for one, other in zip(few.traces(variances), whole.traces(variances), strict=True):
        assert one == pytest.approx(other, **close)


def test_coefficients_given_rows_are_those_of_the_joint_normal(pair):
    few, whole = pair
    row, sd = np.random.default_rng(3).standard_normal(P * N), np.sqrt(EQUAL[2:][few.sorts])
    columns = np.einsum("pki,ipa->pkia", few.shown, few.basis * sd).reshape(P * N, -1)
    across = np.tile(sd, LEGS)[:, None] * np.linalg.solve(whole.covariances(EQUAL[None])[0], columns).T
    thin = few.factorise(EQUAL)
    assert thin.expect(row[:, None])[:, 0] == pytest.approx(across @ row, rel=1e-9, abs=1e-12)
    expected = np.diag(np.tile(sd**2, LEGS)) - across @ columns * np.tile(sd, LEGS)
    assert thin.root @ thin.root.T == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_sums_over_rows_are_interpolated_without_loss():
    rng = np.random.default_rng(4)
    values, weights = 10.0 ** rng.uniform(-4.0, 3.0, (40, 1)), rng.uniform(0.5, 2.0, (40, 3))
    sums = Interpolated(values, lambda one: one[:, 0] @ weights)
    v = np.concatenate([[0.0], 10.0 ** np.linspace(-12.0, 8.0, 301)])
    expected = (1.0 / (1.0 + v[:, None] * values[:, 0])) @ weights
    assert np.abs(sums(v) / expected - 1.0).max() < 3e-12


def spread_places(n, seed=5):
    rng = np.random.default_rng(seed)
    return Place(rng.uniform(-0.5, 0.5, (n, 6)), np.arange(n) / n)


def test_few_columns_leave_little_out():
    place, other = spread_places(400), spread_places(30, 6)
    exact = PoseFunctions(tuple(SORTS), place)
    few = replace(exact, of_few=place)
    sizes = [one.shape[-1] for one in few.list_bases(other)]
    assert sizes == [6, 1, 30, 12]
    assert few.left[:2] == pytest.approx(0.0, abs=1e-12)
    assert 0.01 < few.left[2] < 0.03
    assert few.left[3] == pytest.approx(1.0 / (np.pi**2 * 11) / 0.52, rel=0.1)  # tail of Σ 1 / ω² over the mean of k
    for name, whole, made in zip(SORTS, exact.between(other, place), few.between(other, place), strict=True):
        off = np.abs(whole - made).max()
        assert off < (1e-12 if name in ("linear", "own") else 0.15), name
    for whole, made in zip(exact.variances(other), few.variances(other), strict=True):
        assert (made < whole + 1e-9).all()
        assert np.diagonal(few.between(other, other)[0][0]) == pytest.approx(few.variances(other)[0][0])


def test_norms_take_no_matrix_of_all_poses():
    place = spread_places(40_000)
    tracemalloc.start()
    norms = PoseFunctions(tuple(SORTS), place).norms
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3e7
    some = Place(place.travel[:2000], place.time[::20])
    kernels = [SORTS[name].between(some, some) for name in SORTS]
    expected = [np.diagonal(one, axis1=1, axis2=2).mean() for one in kernels]
    assert norms == pytest.approx(expected, rel=0.03)


def test_many_poses_take_no_matrix_of_all_rows():
    machine = machines.build_machine("none")
    n, rng = 700, np.random.default_rng(1)
    actuators = machines.INITIAL_POSITION + rng.uniform(-0.6, 0.6, (n, 6))
    theta = machines.telescope_truth(machine)
    poses = machines.simulate_poses(machine, theta, actuators, np.full(6, 2e-3), rng)
    base = PoseLikelihood(machine, poses, machines.ACTUATOR_NOISE)
    order = {name: k / n for k, name in enumerate(base.pose_names)}
    tracemalloc.start()
    likelihood = FunctionLikelihood(base, tuple(SORTS), machines.ACTUATOR_RANGE, order)
    posterior = build_posterior(likelihood)
    y = posterior.adopt(theta[None], np.full((1, 5), -0.5))
    assert np.isfinite(posterior.log_density(y)).all()
    given = posterior.linear_geometry(y[0]).given(y[0, posterior.n_geometry :])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.isfinite(given.log_mass)
    assert peak < 8 * (6 * n) ** 2
