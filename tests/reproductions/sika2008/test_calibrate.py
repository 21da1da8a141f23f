"""Batched self-calibrations against SciPy with the poses as unknowns, the truth, and their own stated spread."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from sika_problems import make_problem

from sika2008.sensors import find_poses
from sika2008.simulate import BATCH, calibrate, unweighted


def measure(sensors, free, pose, n, seed=2, noise=1.0):
    rng = np.random.default_rng(seed)
    theta = free.draw(rng, n)
    readings = sensors.read(theta[:, None], pose)
    return theta, readings + noise * sensors.noise * rng.standard_normal(readings.shape)


@pytest.mark.parametrize("n_sensors", [4, 8, 12])
@pytest.mark.parametrize("with_priors", [False, True])
def test_truth_comes_back_without_noise(n_sensors, with_priors):
    sensors, free, pose = make_problem(n_sensors, 60)
    truth, measured = measure(sensors, free, pose, 5, noise=0.0)
    weighted = sensors if with_priors else unweighted(sensors)
    found = calibrate(weighted, free, measured, pose, with_priors)
    assert found.converged.all()
    off = (found.theta - truth)[:, free.places] / free.scale
    if not with_priors:
        assert np.abs(off).max() < 1e-5
        assert found.square.max() < 1e-12
        assert found.n_iterations.max() <= 5  # Newton's method converges like that without noise
    else:  # priors pull, by less than what they leave open
        sd = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2)) / free.scale
        assert np.abs(off / sd).max() < 3.0
    fixed = np.setdiff1d(np.arange(len(free.centre)), free.places)
    np.testing.assert_array_equal(found.theta[:, fixed], np.broadcast_to(free.centre[fixed], (5, len(fixed))))


@pytest.mark.parametrize(("n_sensors", "with_priors"), [(4, False), (8, False), (12, False), (4, True), (12, True)])
def test_agrees_with_scipy_where_poses_are_unknowns_too(n_sensors, with_priors):
    sensors, free, pose = make_problem(n_sensors, 30)
    _, measured = measure(sensors, free, pose, 1)
    weighted = sensors if with_priors else unweighted(sensors)
    n = len(free.places)

    def unpack(x):
        theta = free.centre.copy()
        theta[free.places] += x[:n] * free.scale
        return theta, pose + x[n:].reshape(pose.shape) * [1.0, 1.0, 0.01]

    def residual(x):
        theta, at = unpack(x)
        rows = ((measured[0] - weighted.read(theta, at)) / weighted.noise).ravel()
        return np.concatenate([rows, x[:n]]) if with_priors else rows

    def slope(x):
        theta, at = unpack(x)
        here = weighted.linearise(theta, at)
        rows = np.zeros((*measured[0].shape, len(x)))
        rows[..., :n] = -here.by_parameters[..., free.places] * free.scale
        for k in range(len(pose)):
            rows[k, :, n + 3 * k : n + 3 * k + 3] = -here.by_pose[k] * [1.0, 1.0, 0.01]
        rows = rows.reshape(-1, len(x))
        return np.concatenate([rows, np.eye(n, len(x))]) if with_priors else rows

    start = np.zeros(n + pose.size)
    alone = least_squares(residual, start, slope, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    found = calibrate(weighted, free, measured, pose, with_priors)
    assert found.converged.all()
    off = (found.theta[0] - free.centre)[free.places] / free.scale
    sd = np.sqrt(np.diagonal(found.covariance[0])) / free.scale * (1.0 if with_priors else 1e-6)
    np.testing.assert_allclose(off, alone.x[:n], atol=1e-4 * max(sd.max(), 1e-3) + 1e-6)
    assert found.square[0] == pytest.approx(np.sum(residual(alone.x) ** 2), rel=1e-6)
    if with_priors:
        whole = slope(alone.x)
        theirs = np.linalg.inv(whole.T @ whole)[:n, :n] * np.outer(free.scale, free.scale)
        np.testing.assert_allclose(found.covariance[0], theirs, rtol=1e-5, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.parametrize("n_sensors", [4, 12])
def test_scatter_is_the_stated_one(n_sensors):
    sensors, free, pose = make_problem(n_sensors, 40)
    n = 300
    truth, measured = measure(sensors, free, pose, n)
    found = calibrate(sensors, free, measured, pose, True)
    assert found.converged.all()
    sd = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    scaled = (found.theta - truth)[:, free.places] / sd
    assert np.abs(np.sqrt(np.mean(scaled**2, axis=0)) - 1.0).max() < 4.5 / np.sqrt(2 * n)
    assert np.abs(scaled.mean(axis=0)).max() < 4.5 / np.sqrt(n)
    expected = len(pose) * sensors.redundancy  # chi square of readings and priors, the parameters taken off
    assert found.square.mean() == pytest.approx(expected, abs=4.5 * np.sqrt(2 * expected / n))
    # negative control: readings twice as noisy as stated
    _, worse = measure(sensors, free, pose, 40, noise=2.0)
    wrong = calibrate(sensors, free, worse, pose, True)
    assert wrong.square.mean() > 1.5 * expected


def test_machines_do_not_depend_on_their_batch():
    sensors, free, pose = make_problem(8, 20)
    _, measured = measure(sensors, free, pose, BATCH + 3)
    together = calibrate(unweighted(sensors), free, measured, pose, False)
    for k in (0, BATCH - 1, BATCH, BATCH + 2):
        alone = calibrate(unweighted(sensors), free, measured[k : k + 1], pose, False)
        np.testing.assert_allclose(alone.theta[0], together.theta[k], rtol=0, atol=1e-10)


def test_a_machine_without_solution_says_so_and_spoils_no_other():
    sensors, free, pose = make_problem(12, 20)
    _, measured = measure(sensors, free, pose, 3)
    good = calibrate(unweighted(sensors), free, measured, pose, False)
    spoilt = measured.copy()
    spoilt[1, 4, 2] = np.nan
    found = calibrate(unweighted(sensors), free, spoilt, pose, False)
    assert found.converged.tolist() == [True, False, True]
    assert np.isnan(found.covariance[1]).all()
    np.testing.assert_allclose(found.theta[[0, 2]], good.theta[[0, 2]], rtol=0, atol=1e-10)


def test_too_few_poses_have_no_solution_without_priors():
    sensors, free, pose = make_problem(4, 17)  # 17 equations for 18 parameters
    _, measured = measure(sensors, free, pose, 2)
    found = calibrate(unweighted(sensors), free, measured, pose, False)
    assert not found.converged.any()
    assert np.isnan(found.covariance).all()
    known = calibrate(sensors, free, measured, pose, True)
    assert known.converged.all()
    sd = np.sqrt(np.diagonal(known.covariance, axis1=1, axis2=2)) / free.scale
    assert (sd <= 1.0 + 1e-12).all()
    assert sd.max() > 0.5


def test_readings_at_the_calibrated_machine_are_those_of_some_pose():
    """The poses that were eliminated are still there: located again, they leave the same sum of squares."""
    sensors, free, pose = make_problem(8, 25)
    _, measured = measure(sensors, free, pose, 4)
    found = calibrate(sensors, free, measured, pose, True)
    left = find_poses(sensors, found.theta[:, None], measured, pose)
    prior = ((found.theta - free.centre)[:, free.places] / free.scale) ** 2
    np.testing.assert_allclose((left.error**2).sum(axis=(1, 2)) + prior.sum(axis=1), found.square, rtol=1e-6)


def test_weights_count():
    """Angles ten times as noisy as the unweighted procedure believes: weights reduce the errors."""
    sensors, free, pose = make_problem(12, 40)
    noisy = type(sensors)(sensors.model, sensors.chosen, np.where(sensors.chosen < 4, 1e-3, 1e-4))
    truth, measured = measure(noisy, free, pose, 40)
    paper = calibrate(unweighted(noisy), free, measured, pose, False)
    ours = calibrate(noisy, free, measured, pose, False)
    errors = [np.mean(((one.theta - truth)[:, free.places] / free.scale) ** 2) for one in (paper, ours)]
    assert errors[1] < 0.25 * errors[0]
