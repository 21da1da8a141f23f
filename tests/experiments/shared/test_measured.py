"""Readings of a machine that was measured, taken again or some of them: the same posterior of the same data."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.experiments.shared.measured import MeasuredReadings


@pytest.fixture(scope="module")
def measured():
    machine, rng = machines.build_machine("linear"), np.random.default_rng(3)
    actuators = machines.table_3_actuators()[:12]
    poses = machines.simulate_poses(machine, machine.layout.nominal, actuators, np.zeros(6), rng)
    posterior = machines.build_posterior("linear", poses, symbols=("l", "kappa"))
    internal = np.array([not one.external for one in posterior.likelihood.model.channels])
    return MeasuredReadings("linear", "Simulated", posterior, -np.ones(6), np.ones(6), internal)


def test_readings_taken_twice_count_twice(measured):
    values = measured.posterior.likelihood.data.values
    twice = measured.retake(np.concatenate([values, values]))
    data = twice.posterior.likelihood.data
    assert data.n_poses == len(set(data.poses)) == 24
    y = measured.posterior.least_squares_start()[None]
    alone, both = (
        one.log_density(y) - one.log_prior(y) for one in (measured.with_pose_guesses, twice.with_pose_guesses)
    )
    assert both == pytest.approx(2.0 * alone, rel=1e-6)


def test_some_poses_are_those_of_all(measured):
    some, y = measured.pick(np.arange(5)), measured.posterior.least_squares_start()[None]
    assert some.posterior.likelihood.data.poses == measured.posterior.likelihood.data.poses[:5]
    np.testing.assert_allclose(some.posterior.pointwise(y), measured.posterior.pointwise(y)[:, :5], rtol=1e-9)
