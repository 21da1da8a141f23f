"""Rows of sessions free of the pose: their normal density is the exact one, whatever the noise, and so are slopes.

Sessions in closed form: against brute force over all rows, and derivatives against differences.
"""

from dataclasses import replace
from types import SimpleNamespace

import calibration_problems as problems
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayescal.density.sessions import (
    DAYS_IN_MONTH,
    DriftModel,
    LinearSessions,
    Part,
    ReadingRows,
    SessionModel,
    ThermalExpansion,
    walk_loadings,
)

CASES = {
    "known noise": {},
    "unknown noise": {"terms": problems.unknown_noise(4, errors=True, scale=0.02)},
    "missing readings": {"missing": 0.5, "terms": problems.unknown_noise(4)},
    "a reading on a circle": {"bearing": True},
    "commanded lines": {"commanded": (0, 1)},
}


@pytest.fixture(params=CASES)
def rows(request, rng):
    posterior, y, _ = problems.lines_posterior(rng, 15, **CASES[request.param])
    return ReadingRows(posterior.with_pose_guesses()), posterior.theta(y[None])[0]


def test_the_density_of_the_rows_is_that_of_the_readings(rows, rng):
    rows, theta = rows
    found = rows.linearise(theta)
    assert found.errors.shape == (rows.n_poses, rows.width)
    for zeta in rng.standard_normal((4, rows.n_errors)):
        covariance = found.covariance(zeta)
        square = np.einsum("pi,pij,pj->", found.errors, np.linalg.inv(covariance), found.errors)
        value = found.constant.sum() - 0.5 * (square + np.linalg.slogdet(covariance)[1].sum())
        exact = rows.evaluate(theta[None], zeta[None])[0]
        assert value == pytest.approx(exact, abs=2e-3 * rows.n_poses)


def test_correlated_noise_counts(rng):
    posterior, y, _ = problems.lines_posterior(rng, 12, correlation=problems.correlation_of(rng, 4))
    rows = ReadingRows(posterior.with_pose_guesses())
    theta = posterior.theta(y[None])[0]
    found = rows.linearise(theta)
    np.testing.assert_allclose(found.covariance(np.empty(0)), np.broadcast_to(np.eye(2), (12, 2, 2)), atol=1e-9)
    value = found.constant.sum() - 0.5 * np.sum(found.errors**2)
    assert value == pytest.approx(rows.evaluate(theta[None], np.empty((1, 0)))[0], abs=2e-2)


def test_slopes_are_those_of_the_squares(rows):
    """The sum of squares of what no pose explains changes as the slopes say: the basis itself may turn."""
    rows, theta = rows
    here, step = rows.linearise(theta), 1e-5
    for k in (0, 3, len(theta) - 1):
        plus, minus = theta.copy(), theta.copy()
        plus[k] += step
        minus[k] -= step
        change = sum(sign * np.sum(rows.linearise(one).errors ** 2) for sign, one in ((1, plus), (-1, minus)))
        expected = 2.0 * np.sum(here.errors * here.slope[..., k])
        assert change / (2.0 * step) == pytest.approx(expected, rel=1e-3, abs=1e-3 * np.abs(expected) + 1e-2)


def test_some_rows_are_those_rows(rng):
    posterior, y, _ = problems.lines_posterior(rng, 10)
    anchored = posterior.with_pose_guesses()
    theta, some = posterior.theta(y[None])[0], np.array([1, 4, 7])
    whole = ReadingRows(anchored).linearise(theta)
    part = ReadingRows(replace(anchored, likelihood=anchored.likelihood.pick(some))).linearise(theta)
    np.testing.assert_allclose(part.constant, whole.constant[some])
    np.testing.assert_allclose(np.sum(part.errors**2, axis=1), np.sum(whole.errors[some] ** 2, axis=1))


N_LEGS, FREE, POSES = 3, 4, (2, 3, 2)


def build_model(loadings: np.ndarray, parts: tuple = ()) -> SessionModel:
    """Return three sessions of a made-up machine of five parameters, four of them free, two of which move."""
    drift = DriftModel(loadings, np.array([0, 2]), np.array([0, 1]), ("p", "q"), np.full(2, 0.5))
    expansion = ThermalExpansion("struts", np.array([1, 3]), 0.2, 0.1)
    start, free = np.array([1.0, 2.0, 3.0, 4.0, 5.0]), np.array([0, 1, 3, 4])
    mean, sd = np.array([1.1, 2.2, 3.9, 5.2]), np.array([0.5, 0.2, 0.3, 1.0])
    moves = np.eye(len(start))[free]
    start = start * (moves.sum(axis=0) == 0.0) + mean @ moves
    return SessionModel(parts, start, moves, ("a", "b", "c", "d"), ("mm",) * 4, mean, sd, drift, (expansion,))


LOADINGS = {"walk": walk_loadings(DAYS_IN_MONTH * np.array([0.0, 1.0, 5.0])), "machines": np.eye(3)}


def make_linear(model: SessionModel, rng: np.random.Generator) -> LinearSessions:
    shape = (sum(POSES), N_LEGS)
    known = rng.normal(size=(*shape, N_LEGS))
    known = known @ np.swapaxes(known, 1, 2) + 0.1 * np.eye(N_LEGS)
    first = np.concatenate([[0], np.cumsum(POSES)[:-1]])
    constant = np.full(shape[0], -0.5 * N_LEGS * np.log(2.0 * np.pi))
    rows = rng.normal(size=(*shape, FREE + 2))
    weight = rng.uniform(0.5, 2.0, shape)

    def covariance(tau: np.ndarray) -> np.ndarray:
        return known + np.eye(N_LEGS) * (weight * tau**2)[:, None, :]

    return LinearSessions(model, rows, covariance, constant, first)


def spread_rows(
    linear: LinearSessions, tau: np.ndarray, scales: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return c, the derivative by the state, and the covariance of all rows, by finite differences of `split`."""
    model, n = linear.model, linear.model.size
    session = np.repeat(np.arange(3), POSES)

    def see(z: np.ndarray) -> np.ndarray:
        x, alpha = model.split(z, scales)
        u = np.concatenate([x[session], np.tile(alpha - model.expansions[0].mean, (len(session), 1))], axis=1)
        return (np.einsum("pij,pj->pi", linear.rows[..., :-1], u) + linear.rows[..., -1]).ravel()

    c = see(np.zeros(n))
    jacobian = np.stack([see(row) - c for row in np.eye(n)], axis=1)
    blocks = linear.covariance(tau)
    covariance = np.zeros((len(c), len(c)))
    for k, block in enumerate(blocks):
        covariance[k * N_LEGS : (k + 1) * N_LEGS, k * N_LEGS : (k + 1) * N_LEGS] = block
    return c, jacobian, covariance


def check_against_all_rows(linear, tau, scales, c, jacobian, covariance, rng) -> None:
    """Check marginal and state of sessions, and the density of one state, by what all rows have."""
    found, size = linear.condition(tau, scales), linear.model.size
    total = covariance + jacobian @ jacobian.T
    assert found.log_marginal == pytest.approx(multivariate_normal(cov=total).logpdf(c), rel=1e-10)
    gain = jacobian.T @ np.linalg.inv(total)
    np.testing.assert_allclose(found.mean[:, 0], -gain @ c, atol=1e-10)
    spread = found.draw(np.eye(size)) - found.mean
    np.testing.assert_allclose(spread @ spread.T, np.eye(size) - gain @ jacobian, atol=1e-10)
    z = rng.normal(size=size)
    seen = multivariate_normal(cov=covariance).logpdf(c + jacobian @ z)
    assert linear.log_likelihood(z, tau, scales) == pytest.approx(seen, rel=1e-10)


@pytest.mark.parametrize("hierarchy", LOADINGS)
def test_states_are_integrated_as_brute_force_does(hierarchy, rng):
    model = build_model(LOADINGS[hierarchy])
    linear, tau, scales = make_linear(model, rng), np.array([0.3, 0.0, 0.7]), np.array([0.4, 0.9])
    check_against_all_rows(linear, tau, scales, *spread_rows(linear, tau, scales), rng)


def test_coefficients_of_errors_last_or_are_new_in_every_session(rng):
    """Two of a term that lasts and one of another, whose amplitudes are known; the others as brute force has them."""
    size = np.array([0.7, 0.7, 1.8])
    own = SimpleNamespace(
        widths=np.array([2, 1]), size_coefficients=lambda errors: np.broadcast_to(size, (*errors.shape[:-1], 3))
    )
    model = replace(build_model(LOADINGS["walk"], (SimpleNamespace(rows=own),)), lasting=(True, False))
    alone, tau, scales = build_model(LOADINGS["walk"]), np.array([0.3, 0.0, 0.7]), np.array([0.4, 0.9])
    assert model.size == alone.size + 2 + 3
    linear = make_linear(model, rng)
    columns = rng.normal(size=(*linear.rows.shape[:2], 3))
    rows = np.concatenate([linear.rows[..., :-1], columns, linear.rows[..., -1:]], axis=-1)
    c, jacobian, covariance = spread_rows(replace(linear, model=alone), tau, scales)
    session = np.repeat(np.arange(3), POSES)
    lasting = (columns[..., :2] * size[:2]).reshape(len(c), 2)
    new = np.where(session[:, None] == np.arange(3), 1.0, 0.0)[:, None] * columns[..., 2:] * size[2]
    jacobian = np.concatenate([jacobian, lasting, new.reshape(len(c), 3)], axis=1)
    check_against_all_rows(replace(linear, rows=rows), tau, scales, c, jacobian, covariance, rng)


def test_without_drift_all_sessions_share_their_parameters(rng):
    model = build_model(LOADINGS["walk"]).keep([])
    assert (model.size, model.drift.units) == (FREE + 1, ())
    x, _ = model.split(rng.normal(size=(4, model.size)), np.empty((4, 0)))
    np.testing.assert_array_equal(x[:, 0], x[:, 2])
    linear, at = make_linear(model, rng), (np.zeros(3), np.empty(0))
    check_against_all_rows(linear, *at, *spread_rows(linear, *at), rng)


def test_a_walk_spreads_with_the_root_of_time():
    loadings = LOADINGS["walk"]
    np.testing.assert_allclose(np.sum(loadings**2, axis=1), [0.0, 1.0, 5.0])
    np.testing.assert_allclose((loadings @ loadings.T)[1, 2], 1.0)  # what came before is shared


def test_units_are_kept_by_their_names():
    kept = build_model(LOADINGS["walk"]).keep(["q"]).drift
    assert (kept.units, list(kept.index), list(kept.unit)) == (("q",), [2], [0])


def test_slopes_are_those_of_the_machine_at_its_temperature(rng):
    model, step = build_model(LOADINGS["walk"]), 1e-6
    part = Part(SimpleNamespace(), 1, 7.0)
    x, alpha = rng.normal(size=(3, FREE)), np.array([0.03])
    by_x, by_alpha = model.slopes(part, x, alpha)
    here = model.theta(part, x, alpha)
    assert here[1] == pytest.approx((model.mean[1] + x[1, 1]) * (1.0 + 0.03 * 7.0))
    assert here[0] == pytest.approx(model.mean[0] + x[1, 0])
    for k in range(FREE):
        moved = x.copy()
        moved[1, k] += step
        np.testing.assert_allclose(by_x[:, k], (model.theta(part, moved, alpha) - here) / step, atol=1e-7)
    np.testing.assert_allclose(by_alpha[:, 0], (model.theta(part, x, alpha + step) - here) / step, atol=1e-6)
