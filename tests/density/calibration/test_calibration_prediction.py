"""Readings predicted from the others of their pose: closed forms, circles and rotations, coverage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import telescope_machines as machines
from calibration_problems import (
    climb,
    correlation_of,
    density,
    linear_model,
    lines_posterior,
    measurements,
    rows_of,
    simulate,
    unknown_noise,
)
from reading_machines import LinearModel
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from bayescal.density.calibration.prediction import predict_poses, predict_readings
from bayescal.density.calibration.terms import NO_ERRORS, ErrorModel
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior
from bayescal.inference.importance import resample
from bayescal.inference.mode import find_mode
from bayescal.inference.proposal import MixtureProposal
from bayescal.machines.readings import Channel
from bayescal.numerics.geometry import compute_pose_error

DRAWS = 20_000


def linear_problem(rng, correlation, nu=np.inf):
    """Return a posterior whose parameters hardly vary, so that its draws are the machine itself, with its data."""
    model, sd = linear_model(rng), rng.uniform(0.5, 2.0, 6)
    data = measurements(rng.standard_normal((3, 6)), sd, correlation)
    likelihood = density(model, data)
    priors = {"d[1]": NormalPrior(0.0, 1e-9)}
    return Posterior(likelihood, priors, ErrorModel((), rows_of(nu))), sd


@pytest.mark.parametrize("nu", [np.inf, 4.0])
@pytest.mark.parametrize("correlated", [False, True])
def test_a_linear_reading_has_the_closed_form(rng, correlated, nu):
    """What of the joint density is left of a reading, given the others: by differences of the log-density itself."""
    correlation = correlation_of(rng, 6) if correlated else None
    posterior, sd = linear_problem(rng, correlation, nu)
    found = predict_readings(posterior, posterior.likelihood, np.zeros((DRAWS, 1)), rng)
    assert len(found.measured) == 18
    covariance = sd[:, None] * (np.eye(6) if correlation is None else correlation) * sd
    slope = posterior.likelihood.model.by_pose
    for k, (pose, channel) in enumerate(zip(found.pose, found.channel, strict=True)):
        values = posterior.likelihood.data.values[pose]
        # readings projected across all moves of the pose are normal: condition one on the rest
        basis = null_space(slope.T)
        precision = basis @ np.linalg.inv(basis.T @ covariance @ basis) @ basis.T
        others = np.arange(6) != channel
        mean = -precision[channel, others] @ values[others] / precision[channel, channel]
        wide = 1.0 / np.sqrt(precision[channel, channel])
        half = 1.6449 * wide
        if np.isfinite(nu):
            full = np.where(others, values, mean)
            square = full @ precision @ full
            wide *= np.sqrt((nu + square) / (nu + 3.0))
            half = student.ppf(0.95, nu + 3.0) * wide
            wide *= np.sqrt((nu + 3.0) / (nu + 1.0))
        assert found.mean[k] == pytest.approx(mean, abs=1e-6)
        assert found.sd[k] == pytest.approx(wide, rel=0.04)
        np.testing.assert_allclose([found.low[k], found.high[k]], [mean - half, mean + half], rtol=0, atol=0.06 * wide)


def test_one_linearisation_of_all_readings_predicts_as_one_for_each(rng, monkeypatch):
    machine = machines.build_machine("linear")
    theta, actuators = machines.telescope_truth(machine), machines.table_3_actuators()
    poses = machines.simulate_poses(machine, theta, actuators, np.full(6, 2e-3), rng)
    posterior = machines.build_posterior("linear", poses, machines.let_err(0.002), ("l", "b_x", "b_y"), machine)
    mode = find_mode(posterior, posterior.least_squares_start())
    draws = mode.y + rng.standard_normal((40, len(mode.y))) @ np.linalg.cholesky(mode.covariance).T

    def predict():
        return predict_readings(posterior, posterior.likelihood, draws, np.random.default_rng(1))

    by_one = predict()
    monkeypatch.setattr("bayescal.density.calibration.prediction.STRAIGHT", -1.0)
    by_each = predict()
    np.testing.assert_array_equal([by_one.pose, by_one.channel], [by_each.pose, by_each.channel])
    away = np.abs((by_one.mean - by_each.mean) / by_each.sd)
    assert 0.0 < away.max() < 0.01
    np.testing.assert_allclose(by_one.sd, by_each.sd, rtol=1e-3)


def test_a_reading_that_tells_the_pose_is_not_predicted(rng):
    model = LinearModel(np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.ones((3, 1)))
    likelihood = density(model, measurements(rng.standard_normal((2, 3)), 1.0))
    posterior = Posterior(likelihood, {"d[1]": NormalPrior(0.0, 1.0)}, NO_ERRORS)
    found = predict_readings(posterior, likelihood, np.zeros((50, 1)), rng)
    assert set(found.channel) == {0, 1}
    alone = replace(likelihood, data=likelihood.data.only(np.array([True, False, True])))
    assert not len(predict_readings(posterior, alone, np.zeros((50, 1)), rng).channel)


class Turned(LinearModel):
    """A rotation vector, which two instruments read: the first as one, the second component by component."""

    sensors = (
        *(Channel(f"a{axis}", "rad", rotation="a") for axis in "xyz"),
        *(Channel(f"b{axis}", "rad", rotation="b") for axis in "xyz"),
    )


def test_rotations_are_predicted_near_half_a_turn(rng):
    model = Turned(np.concatenate([np.eye(3)] * 2), np.zeros((6, 1)))
    sd = 1e-3
    axis = rng.standard_normal((20, 3))
    pose = (np.pi - 5e-4 * rng.random((20, 1))) * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    small = [Rotation.from_rotvec(sd * rng.standard_normal((20, 3))) for _ in range(2)]
    values = np.concatenate([(one * Rotation.from_rotvec(pose)).as_rotvec() for one in small], axis=1)
    assert (np.abs(values[:, :3] - values[:, 3:]).max(axis=1) > 1.0).any()  # some lie beyond
    likelihood = density(model, measurements(values, sd), pose)
    posterior = Posterior(likelihood, {"d[1]": NormalPrior(0.0, 1.0)}, NO_ERRORS)
    found = predict_readings(posterior, likelihood, np.zeros((1000, 1)), rng)
    assert len(found.measured) == 120
    assert np.abs(found.measured - found.mean).max() < 6.0 * np.sqrt(2.0) * sd
    np.testing.assert_allclose(found.sd, np.sqrt(2.0) * sd, rtol=0.1)
    assert 0.8 < found.inside.mean() < 0.98


def test_angles_are_predicted_the_short_way_round(rng):
    posterior, y, _ = lines_posterior(rng, n_poses=60, bearing=True)
    likelihood = posterior.likelihood
    values = likelihood.data.values.copy()
    values[::2, 4] -= 2.0 * np.pi
    turned = replace(likelihood, data=replace(likelihood.data, values=values))
    found = predict_readings(posterior, turned, np.tile(y, (500, 1)), rng)
    bearing = found.channel == 4
    assert bearing.sum() == 60
    assert np.abs(found.measured - found.mean)[bearing].max() < 0.01
    assert found.inside[bearing].mean() > 0.7


# --- coverage ----------------------------------------------------------------------------------------------------


def draw_posterior(posterior, rng, n=400):
    """Return draws (n, m) of a posterior by importance, and by how much of the proposal they came."""
    posterior = posterior.with_pose_guesses()
    y, factor = climb(posterior)
    proposal = MixtureProposal(np.ones(1), y[None], 1.05 * factor[None], 8.0)
    return posterior, resample(posterior.log_density, proposal, rng, 4 * n, n)


def coverage(rng, n_sets, **case):
    """Return the part of held-back readings inside their 90 % intervals, over simulated sets."""
    inside = []
    for _ in range(n_sets):
        posterior, y, _ = lines_posterior(rng, n_poses=15, **case)
        pose = rng.uniform(-150.0, 150.0, (10, 2))
        blank = measurements(np.zeros((10, 4)), posterior.likelihood.data.sd[0], case.get("correlation"))
        empty = density(posterior.likelihood.model, blank, pose, 9e4)
        values = simulate(replace(posterior, likelihood=empty), y, pose, rng)
        held = replace(empty, data=replace(blank, values=values))
        _, drawn = draw_posterior(posterior, rng)
        inside.append(predict_readings(posterior, held, drawn.draws, rng).inside)
    return np.concatenate(inside).mean()


COVERED = {
    "stated": {},
    "factor and model error": {"terms": unknown_noise(4, True, True, 0.05)},
    "robust": {"nu": 4.0},
    "correlated": {"correlation": np.full((4, 4), 0.7) + 0.3 * np.eye(4)},
}


@pytest.mark.parametrize("case", COVERED.values(), ids=COVERED)
def test_intervals_hold_about_what_they_say(case, rng):
    assert 0.82 < coverage(rng, 8, **case) < 0.97


@pytest.mark.slow
@pytest.mark.parametrize("case", COVERED.values(), ids=COVERED)
def test_intervals_hold_nine_of_ten(case, rng):
    assert 0.88 < coverage(rng, 100, **case) < 0.92


def test_poses_that_an_instrument_saw_lie_where_intervals_say(rng):
    """Nine of ten, of each coordinate; by draws a third as wide far fewer, where the machine is hardly known."""
    machine = machines.build_machine("linear")
    theta, actuators = machines.telescope_truth(machine), machines.table_3_actuators()
    actuators = np.concatenate([actuators, machines.INITIAL_POSITION + 1.3 * rng.uniform(-1, 1, (90, 6))])
    poses = machines.simulate_poses(machine, theta, actuators, np.full(6, 2e-3), rng)
    calibration, other = poses.select(np.arange(7)), poses.select(np.arange(40, 130))
    posterior = machines.build_posterior("linear", calibration, machines.let_err(0.002), ("l", "b_x", "b_y"), machine)
    theta_free = np.isin(np.arange(len(theta)), posterior.sampling.free)
    fixed = dict(zip(machine.layout.names, np.where(theta_free, machine.layout.nominal, theta), strict=True))
    fixed = {name: value for name, value in fixed.items() if name not in posterior.names}
    posterior = replace(posterior, fixed=fixed).with_pose_guesses()
    mode = find_mode(posterior, posterior.refine_geometry(posterior.least_squares_start()))
    y = mode.y + rng.standard_normal((200, len(mode.y))) @ np.linalg.cholesky(mode.covariance).T
    held = machines.measure(machine, other, {}).likelihood
    by, seen = np.arange(12) < 6, list(range(6, 12))
    found = predict_poses(posterior, held, y, rng, by, seen)
    exact = machines.place_poses(machine, posterior.theta(mode.y[None])[0], other.actuators, np.zeros((90, 6)))
    error = compute_pose_error(other.position, other.rotation, exact.position, exact.rotation)
    np.testing.assert_allclose(found.error[:, :3], error[:, :3], atol=2e-3)
    assert found.inside.shape == (90, 6)
    assert 0.85 < found.coverage < 0.95
    assert np.mean(found.position_error < found.position_bound) == pytest.approx(0.95, abs=0.05)
    narrow = predict_poses(posterior, held, mode.y + 0.1 * (y - mode.y), rng, by, seen)
    assert narrow.coverage < found.coverage - 0.05
