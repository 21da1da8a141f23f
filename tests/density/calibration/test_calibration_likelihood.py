"""The density of any readings with their poses eliminated, against closed forms and integrals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_problems import (
    correlation_of,
    density,
    line_functions,
    linear_model,
    lines_posterior,
    measurements,
    pointwise,
    star_problem,
    unknown_noise,
)
from reading_machines import LinearModel
from scipy.integrate import quad
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation
from scipy.stats import gamma, multivariate_normal

from bayescal.density.calibration.measurements import Comparison, Measurements
from bayescal.density.calibration.poses import search_poses
from bayescal.density.outliers import StudentT
from bayescal.machines.readings import Channel

VOLUME = 50.0


def closed_form(model, values, covariance, theta):
    """Return the log-density of readings (K,) of covariance (K, K), the pose flat in the volume."""
    factor = np.linalg.inv(np.linalg.cholesky(covariance))
    slope = factor @ model.by_pose
    rest = null_space(slope.T).T @ factor @ (values - model.by_parameters @ theta)
    constant = -0.5 * np.linalg.slogdet(slope.T @ slope)[1] - 0.5 * np.linalg.slogdet(covariance)[1] - np.log(VOLUME)
    return constant + multivariate_normal.logpdf(rest, np.zeros(len(rest)))


@pytest.mark.parametrize("correlated", [False, True])
@pytest.mark.parametrize("tau", [0.0, 0.7])
def test_deviations_correlation_and_model_errors_make_the_covariance(rng, correlated, tau):
    model, sd, theta = linear_model(rng), rng.uniform(0.5, 2.0, (7, 6)), rng.standard_normal((4, 3))
    values, correlation = rng.standard_normal((7, 6)), correlation_of(rng, 6)
    data = measurements(values, sd, correlation if correlated else None)
    found = pointwise(density(model, data, volume=VOLUME), theta, tau)
    of = correlation if correlated else np.eye(6)
    for c, p in np.ndindex(4, 7):
        covariance = sd[p][:, None] * of * sd[p] + tau**2 * np.eye(6)
        assert found[c, p] == pytest.approx(closed_form(model, values[p], covariance, theta[c]), rel=1e-9)


@pytest.mark.parametrize("chosen", [(0, 1), (4, 2), (0, 1, 3), (0, 1, 2, 3, 4, 5)])
@pytest.mark.parametrize("correlated", [False, True])
def test_readings_given_commanded_positions_have_the_closed_form(rng, chosen, correlated):
    """The pose normal with a huge variance, over its density: flat in the commanded channels as a surface."""
    model, sd, theta = linear_model(rng), rng.uniform(0.5, 2.0, 6), rng.standard_normal((4, 3))
    values, of = rng.standard_normal((7, 6)), correlation_of(rng, 6) if correlated else np.eye(6)
    data = replace(measurements(values, sd, of), commanded=np.tile(np.isin(np.arange(6), chosen), (7, 1)))
    found = pointwise(density(model, data, volume=VOLUME), theta)
    wide = 1e3
    covariance = sd[:, None] * of * sd + wide**2 * model.by_pose @ model.by_pose.T
    own = model.by_pose[list(chosen)]
    flat = np.log(2.0 * np.pi * wide**2) + 0.5 * np.linalg.slogdet(own.T @ own)[1]
    expected = [multivariate_normal.logpdf(values, model.by_parameters @ one, covariance) + flat for one in theta]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_as_many_commanded_channels_as_coordinates_leave_the_density_of_the_others_given_them(rng):
    """That of what they predict of the others, normalised: neither workspace nor unit of the coordinates matter."""
    model, sd, theta = linear_model(rng), rng.uniform(0.5, 2.0, 6), rng.standard_normal(3)
    values, commanded = rng.standard_normal((7, 6)), np.arange(6) < 2
    data = replace(measurements(values, sd), commanded=np.tile(commanded, (7, 1)))
    shifted = values - model.by_parameters @ theta
    gain = model.by_pose[2:] @ np.linalg.inv(model.by_pose[:2])
    covariance = np.diag(sd[2:] ** 2) + gain @ np.diag(sd[:2] ** 2) @ gain.T
    expected = multivariate_normal.logpdf(shifted[:, 2:] - shifted[:, :2] @ gain.T, cov=covariance)
    for volume, scale in ((1.0, 1.0), (VOLUME, 0.01)):
        one = LinearModel(scale * model.by_pose, model.by_parameters)
        found = pointwise(density(one, data, volume=volume), theta[None])[0]
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_each_pose_has_commanded_channels_of_its_own_or_none(rng):
    model, sd, theta = linear_model(rng), rng.uniform(0.5, 2.0, 6), rng.standard_normal((4, 3))
    commanded = np.array([[1, 1, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0], [0, 0, 1, 1, 1, 0]], dtype=bool)
    data = replace(measurements(rng.standard_normal((3, 6)), sd), commanded=commanded)
    found = pointwise(density(model, data, volume=VOLUME), theta)
    for k in range(3):
        alone = data.pick(np.array([k]))
        alone = alone if commanded[k].any() else replace(alone, commanded=None)
        np.testing.assert_allclose(found[:, k], pointwise(density(model, alone, volume=VOLUME), theta)[:, 0])
    left = data.only(np.arange(6) != 2)
    np.testing.assert_array_equal(left.commanded, commanded & [[True], [True], [False]])


def test_a_reading_not_taken_is_no_reading(rng):
    """As of a machine that does not have the sensor, with correlated noise as well."""
    model, sd, theta = linear_model(rng), rng.uniform(0.5, 2.0, 6), rng.standard_normal((4, 3))
    values, left = rng.standard_normal((7, 6)), np.array([0, 1, 2, 4, 5])
    without = LinearModel(model.by_pose[left], model.by_parameters[left])
    for correlation in (None, correlation_of(rng, 6)):
        few = None if correlation is None else correlation[np.ix_(left, left)]
        missing = values.copy()
        missing[:, 3] = np.nan
        found = pointwise(density(model, measurements(missing, sd, correlation)), theta, 0.3)
        expected = pointwise(density(without, measurements(values[:, left], sd[left], few)), theta, 0.3)
        np.testing.assert_allclose(found, expected, rtol=1e-12)
        here = measurements(values, sd, correlation)
        alone = pointwise(density(model, here.only(np.arange(6) != 3)), theta, 0.3)
        np.testing.assert_allclose(alone, expected, rtol=1e-12)


def test_each_pose_may_lack_readings_of_its_own(rng):
    model, sd, theta = linear_model(rng), rng.uniform(0.5, 2.0, 6), rng.standard_normal((4, 3))
    values = np.where(np.eye(7, 6) > 0, np.nan, rng.standard_normal((7, 6)))
    likelihood = density(model, measurements(values, sd, correlation_of(rng, 6)))
    whole = pointwise(likelihood, theta)
    for p in range(7):
        alone = pointwise(likelihood.pick(np.array([p])), theta)
        np.testing.assert_allclose(whole[:, [p]], alone, rtol=1e-12)
    np.testing.assert_array_equal(likelihood.n_readings, [5] * 6 + [6])


def test_too_few_readings_to_tell_a_pose_have_no_density(rng):
    model = linear_model(rng)
    values = rng.standard_normal((2, 6))
    values[1, 1:] = np.nan
    found = pointwise(density(model, measurements(values, 1.0)), rng.standard_normal((3, 3)))
    assert np.isfinite(found[:, 0]).all()
    assert np.isneginf(found[:, 1]).all()


def conditioned(model, values, sd, theta, held):
    """Return the log-density where some readings (m,) hold exactly: poses run through what they leave, a line."""
    free = np.setdiff1d(np.arange(len(values)), held)
    shifted = values - model.by_parameters @ theta
    exact = model.by_pose[held]
    along = null_space(exact)
    foot = np.linalg.pinv(exact) @ shifted[held]
    rest = (shifted[free] - model.by_pose[free] @ foot) / sd[free]
    slope = model.by_pose[free] @ along / sd[free][:, None]
    left = null_space(slope.T).T @ rest
    volume = 0.5 * np.linalg.slogdet(slope.T @ slope)[1] + 0.5 * np.linalg.slogdet(exact @ exact.T)[1]
    return multivariate_normal.logpdf(left, np.zeros(len(left))) - np.log(sd[free]).sum() - volume - np.log(VOLUME)


@pytest.mark.parametrize(("q", "held"), [(2, [4]), (3, [4]), (3, [0, 5]), (5, [2])])
def test_a_reading_without_noise_is_the_limit_of_little(rng, q, held):
    model, theta = linear_model(rng, 7, q), rng.standard_normal((4, 3))
    sd, values = rng.uniform(0.5, 2.0, 7), rng.standard_normal((5, 7))
    exact = sd.copy()
    exact[held] = 0.0
    found = pointwise(density(model, measurements(values, exact), volume=VOLUME), theta)
    expected = np.array([[conditioned(model, row, sd, machine, held) for row in values] for machine in theta])
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)
    coarse, fine = (
        pointwise(density(model, measurements(values, np.where(exact > 0.0, sd, little)), volume=VOLUME), theta)
        for little in (1e-2, 1e-3)
    )
    assert np.abs(coarse - expected).max() / np.abs(fine - expected).max() == pytest.approx(100.0, rel=0.1)
    assert np.abs(found - expected).max() < 0.02 * np.abs(fine - expected).max()


def test_a_constraint_is_tiny_beside_noise_of_its_own_unit():
    """A constraint in mm beside angles of 1e-6 rad must not drown all else."""
    units = ("mm", "rad", "mm", "1")
    data = Measurements(("a",), np.zeros((1, 4)), np.array([[0.0, 1e-6, 1e-2, 0.0]]))
    np.testing.assert_allclose(data.with_constraints(units).sd, [[1e-6, 1e-6, 1e-2, 1e-10]], rtol=1e-12)
    alone = Measurements(("a",), np.zeros((1, 1)), np.zeros((1, 1)))
    np.testing.assert_allclose(alone.with_constraints(("mm",)).sd, [[1e-4]])
    np.testing.assert_array_equal(data.sd, [[0.0, 1e-6, 1e-2, 0.0]])


def test_correlated_noise_is_a_turned_problem_of_independent_noise(rng):
    """Readings mixed by an orthogonal matrix have correlated noise; the density is that of the readings unmixed."""
    model, theta, sd = linear_model(rng), rng.standard_normal((4, 3)), rng.uniform(0.5, 2.0, 6)
    turn = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    values = rng.standard_normal((7, 6))
    covariance = turn @ np.diag(sd**2) @ turn.T
    deviation = np.sqrt(np.diag(covariance))
    mixed = LinearModel(turn @ model.by_pose, turn @ model.by_parameters)
    data = measurements(values @ turn.T, deviation, covariance / deviation[:, None] / deviation)
    for nu in (np.inf, 4.0):
        found = pointwise(density(mixed, data), theta, nu=nu)
        np.testing.assert_allclose(found, pointwise(density(model, measurements(values, sd)), theta, nu=nu), rtol=1e-11)


@pytest.mark.parametrize("nu", [1.5, 4.0, 30.0])
def test_a_robust_density_is_the_integral_over_each_poses_precision(rng, nu):
    model, theta, sd = linear_model(rng), rng.standard_normal((1, 3)), rng.uniform(0.5, 2.0, 6)
    values = 3.0 * rng.standard_normal((3, 6))
    values[2, 4] = np.nan
    robust = density(model, measurements(values, sd), volume=VOLUME)
    found = pointwise(robust, theta, nu=nu)[0]
    square = robust.stand(theta, robust.whiten(robust.sd[None], np.zeros((1, 1, 6)))).square[0]
    for p in range(3):
        alone = robust.pick(np.array([p]))

        def weigh(w, one=alone, p=p):
            wide = replace(one, data=replace(one.data, sd=one.data.sd / np.sqrt(w)))
            return np.exp(pointwise(wide, theta)[0, 0] - found[p]) * gamma.pdf(w, 0.5 * nu, scale=2.0 / nu)

        total = quad(weigh, 0.0, np.inf, epsabs=1e-12, epsrel=1e-10)[0]
        assert total == pytest.approx(1.0, abs=1e-7)
        mean = quad(lambda w, weigh=weigh: w * weigh(w), 0.0, np.inf, epsabs=1e-12, epsrel=1e-10)[0]
        assert StudentT(nu).trust(square, robust.n_spare)[p] == pytest.approx(mean, rel=1e-6)


def test_a_robust_density_of_much_freedom_is_normal(rng):
    model, theta = linear_model(rng), rng.standard_normal((4, 3))
    data = measurements(rng.standard_normal((5, 6)), 1.0)
    wide = pointwise(density(model, data), theta, nu=1e7)
    np.testing.assert_allclose(wide, pointwise(density(model, data), theta), rtol=0, atol=1e-4)


def test_without_coordinates_readings_are_normal(rng):
    model = LinearModel(np.zeros((4, 0)), rng.standard_normal((4, 3)))
    values, theta, sd = rng.standard_normal((5, 4)), rng.standard_normal((2, 3)), rng.uniform(0.5, 2.0, 4)
    found = pointwise(density(model, measurements(values, sd)), theta)
    expected = [multivariate_normal.logpdf(values - model.by_parameters @ one, cov=np.diag(sd**2)) for one in theta]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


# --- circles and rotations -----------------------------------------------------------------------------------------


def test_angles_are_compared_the_short_way_round(rng):
    turn = 2.0 * np.pi
    comparison = Comparison((Channel("a", "rad", period=turn), Channel("b", "mm"), Channel("c", "deg", period=360.0)))
    read = np.array([np.pi - 0.01, 5.0, 359.0])
    measured = np.array([-np.pi + 0.02, 1000.0, 1.0])
    np.testing.assert_allclose(comparison.subtract(measured, read), [0.03, 995.0, 2.0], rtol=1e-12)
    far = read + np.array([3.0 * turn, 0.0, -720.0])
    np.testing.assert_allclose(comparison.subtract(measured, far), [0.03, 995.0, 2.0], rtol=1e-12)
    assert np.isnan(comparison.subtract(np.full(3, np.nan), read)).all()
    many = comparison.subtract(rng.uniform(-50, 50, (9, 3)), read)
    assert (np.abs(many[:, 0]) <= np.pi + 1e-12).all()


ROTATION = tuple(Channel(f"r{axis}", "rad", rotation="platform") for axis in "xyz")


@pytest.mark.parametrize("size", [1e-9, 0.3, 2.0, np.pi - 1e-4])
def test_rotations_are_compared_as_rotations(rng, size):
    axis = rng.standard_normal((20, 3))
    read = size * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    small = 1e-3 * rng.standard_normal((20, 3))
    # just beyond half a turn the vector of the same rotation points the other way
    measured = (Rotation.from_rotvec(small) * Rotation.from_rotvec(read)).as_rotvec()
    comparison = Comparison((Channel("s", "mm"), *ROTATION))
    found = comparison.subtract(np.insert(measured, 0, 2.0, axis=1), np.insert(read, 0, 0.5, axis=1))
    np.testing.assert_allclose(found[:, 1:], small, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found[:, 0], 1.5)


@pytest.mark.parametrize("size", [0.0, 0.3, 2.0, np.pi - 1e-4, 3.5])
def test_derivatives_of_rotations_are_those_of_what_is_compared(rng, size):
    axis = rng.standard_normal((20, 3))
    read = size * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    measured = (Rotation.from_rotvec(0.4 * rng.standard_normal((20, 3))) * Rotation.from_rotvec(read)).as_rotvec()
    comparison, step = Comparison(ROTATION), 1e-6
    slope = np.broadcast_to(np.eye(3), (20, 3, 3))
    found = comparison.pull_back(comparison.subtract(measured, read), read, slope)
    for k in range(3):
        ahead, behind = (comparison.subtract(measured, read + sign * step * np.eye(3)[k]) for sign in (1.0, -1.0))
        np.testing.assert_allclose(found[..., k], (behind - ahead) / (2.0 * step), rtol=0, atol=1e-8)


# --- poses -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("anchored", [False, True])
@pytest.mark.parametrize("coarse", [1.0, 300.0])
def test_batches_change_nothing(anchored, coarse, rng):
    likelihood, near = star_problem()
    data = likelihood.data
    noisy = data.values + (coarse - 1.0) * data.sd * rng.standard_normal(data.values.shape)
    likelihood = replace(likelihood, data=replace(data, values=noisy, sd=coarse * data.sd))
    if anchored:
        white = likelihood.whiten(likelihood.sd[None], np.zeros((1, 1, 8)))
        likelihood = likelihood.anchored_at(likelihood.stand(near[:1], white).pose[0], near[0])
    spread = 10.0 ** rng.uniform(-4.0, 0.5, (40, 1))
    many = near[0] + spread * (near[rng.integers(1, 4, 40)] - near[0])
    many[7, 12] = 50.0  # a leg too short for anything
    whole = pointwise(likelihood, many)
    alone = np.concatenate([pointwise(likelihood, many[k : k + 1]) for k in range(len(many))])
    np.testing.assert_allclose(whole, alone, rtol=0, atol=1e-9)
    order = rng.permutation(40)
    np.testing.assert_allclose(pointwise(likelihood, many[order]), whole[order], rtol=0, atol=1e-9)
    assert np.isneginf(whole[7]).any()
    assert np.isfinite(np.delete(whole, 7, axis=0)).all()


@pytest.fixture
def star():
    """Return a density, machines near each other, the stated whitening and the density anchored at the first."""
    likelihood, near = star_problem()
    white = likelihood.whiten(likelihood.sd[None], np.zeros((1, 1, 8)))
    return likelihood, near, white, likelihood.anchored_at(likelihood.stand(near[:1], white).pose[0], near[0])


def test_chords_end_where_newtons_steps_do(star):
    likelihood, near, _, anchored = star
    np.testing.assert_allclose(pointwise(anchored, near), pointwise(likelihood, near), rtol=0, atol=1e-4)


def test_chords_start_where_the_parameters_take_the_poses(star):
    likelihood, near, white, anchored = star
    start, pose = (likelihood.stand(near[k : k + 1], white).pose[0] for k in (0, 1))
    moved, _ = anchored.expansion.predict(near[1:2])
    # what is left is of second order, and of first in what no pose explains
    assert np.abs(moved[0] - pose).max() < 1e-3 * np.abs(pose - start).max()


NATS = 2e-3


@pytest.mark.parametrize("case", ["plain", "correlated", "missing", "bearing", "factor", "functions"])
def test_machines_near_the_anchor_need_no_derivatives_and_others_are_exact(case, rng, monkeypatch):
    choices = {
        "correlated": {"correlation": correlation_of(rng, 4)},
        "missing": {"missing": 0.3},
        "bearing": {"bearing": True},
        "factor": {"terms": unknown_noise(4, True, True, 0.1)},
        "functions": {"terms": (line_functions(),), "n_poses": 30},
    }
    plain, *_ = lines_posterior(rng, **choices.get(case, {}))
    posterior = plain.with_pose_guesses()
    mode = plain.least_squares_start()
    _, hessian = posterior.gradient(mode)
    move = np.linalg.solve(np.linalg.cholesky(-hessian).T, rng.standard_normal((len(mode), 40))).T
    near, far = mode + move, mode + 30.0 * move[:5]
    plain = replace(plain, likelihood=replace(plain.likelihood, start=posterior.likelihood.start))
    np.testing.assert_allclose(posterior.log_density(far), plain.log_density(far), rtol=1e-5, atol=1e-3)
    expected = plain.log_density(near)

    def refuse(*_, **__):
        raise AssertionError("a derivative was taken")

    monkeypatch.setattr(type(plain.likelihood.model), "linearise", refuse)
    np.testing.assert_allclose(posterior.log_density(near), expected, rtol=0, atol=NATS)


def test_an_expansion_that_was_not_tried_is_not_used(star):
    _, near, _, anchored = star
    assert not anchored.is_near(near).any()


def test_parameters_that_did_not_differ_in_the_trials_may_not_differ(rng):
    posterior = lines_posterior(rng)[0].with_pose_guesses()
    expansion = posterior.likelihood.expansion
    theta = expansion.anchor + 1e-6 * np.eye(len(expansion.anchor))
    assert 0 < len(expansion.free) < len(theta)
    np.testing.assert_array_equal(np.flatnonzero(posterior.likelihood.is_near(theta)), expansion.free)


def test_poses_are_found_from_far_off(star, rng):
    likelihood, near, white, _ = star
    expected = likelihood.stand(near[:1], white)
    start = likelihood.start[None] + rng.uniform(-1.0, 1.0, (1, 10, 3)) * [60.0, 60.0, 0.3]
    with np.errstate(all="ignore"):
        pose, square = search_poses(likelihood, near[0], white, start)
    np.testing.assert_allclose(pose, expected.pose, rtol=0, atol=1e-5)
    np.testing.assert_allclose(square, expected.square, rtol=1e-4)
