"""Errors of poses that an instrument saw: those of the mean prediction of all draws, though few are looked at."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.density.calibration.prediction import predict_poses
from bayescal.inference.mode import find_modes
from bayescal.machines.kinematics import solve_forward_kinematics

SEEN = tuple(range(6, 12))  # x to rz, after six actuators
BY = np.arange(12) < 6
N_DRAWS, N_LOOKED_AT = 2000, 200


@pytest.fixture(scope="module")
def posterior():
    """Return the telescope by 19 poses, 20 µm of model error and a wrong deformation."""
    truth = machines.build_machine("matrix")
    theta = machines.telescope_truth(truth)
    actuators = machines.INITIAL_POSITION + machines.ACTUATOR_RANGE * machines.TABLE_3
    poses = machines.place_poses(truth, theta, actuators, np.zeros((len(actuators), 6)))
    return machines.build_posterior("linear", poses, machines.let_err(0.02)).with_pose_guesses()


@pytest.fixture(scope="module")
def draws(posterior):
    mode = find_modes(posterior)[0]
    return np.random.default_rng(1).multivariate_normal(mode.y, mode.covariance, N_DRAWS)


def predict(posterior, y, every=None, seen=SEEN):
    return predict_poses(posterior, posterior.likelihood.whole, y, np.random.default_rng(2), BY, seen, every)


def test_errors_are_those_of_the_mean_of_all_draws(posterior, draws):
    """By forward kinematics of each draw; the mean of the few alone is off by far more."""
    machine, values = posterior.likelihood.model.machine, posterior.likelihood.data.values
    every = solve_forward_kinematics(machine, posterior.theta(draws)[:, None], values[:, :6]).position
    expected = values[:, 6:9] - every.mean(axis=0)
    few = draws[:N_LOOKED_AT]
    alone, found = predict(posterior, few), predict(posterior, few, draws)
    off, rest = (np.abs(one.error[:, :3] - expected).max() for one in (alone, found))
    assert off > 5e-4
    assert rest < 0.1 * off
    np.testing.assert_array_equal(found.low, alone.low)


def test_too_few_draws_for_each_parameter_stay_as_they_are(posterior, draws):
    few = draws[:60]
    np.testing.assert_array_equal(predict(posterior, few, draws).error, predict(posterior, few).error)


def test_what_is_not_measured_stays_unknown(posterior, draws):
    few = draws[:N_LOOKED_AT]
    whole, found = predict(posterior, few, draws), predict(posterior, few, draws, (*SEEN[:3], None, None, None))
    assert np.isnan(found.error[:, 3:]).all()
    np.testing.assert_allclose(found.error[:, :3], whole.error[:, :3], rtol=0, atol=1e-12)
