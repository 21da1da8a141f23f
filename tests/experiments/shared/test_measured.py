"""Poses measured of legs as readings: the same posterior, the same data when they are taken again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.density.errors import ModelError
from bayescal.experiments.shared.measured import MeasuredVariant, see_legs

SYMBOLS = ("l", "kappa")


@pytest.fixture(scope="module")
def legs():
    machine = machines.build_machine("linear")
    actuators = machines.table_3_actuators()[:12]
    tau = np.zeros(6)
    poses = machines.simulate_poses(machine, machine.layout.nominal, actuators, tau, np.random.default_rng(3))
    posterior = machines.build_posterior("linear", poses, ModelError(0.002), SYMBOLS)
    noise = machines.ACTUATOR_NOISE
    fields = {"priors": posterior.priors, "fixed": {}}
    return MeasuredVariant(
        "linear",
        "Simulated",
        machine=machine,
        posterior=posterior,
        poses=poses,
        actuator_noise=noise,
        **fields,
    )


def test_the_posterior_of_readings_is_that_of_legs(legs):
    """But for a constant, that of the measure of y, and what the legs' density takes at the nominal machine."""
    measured, own = see_legs(legs), legs.posterior
    start = own.approach()
    spread = np.linalg.cholesky(np.linalg.inv(-own.gradient(start)[1]))
    y = start + np.random.default_rng(1).standard_normal((20, len(start))) @ spread.T
    ours = measured.adopt(y)
    np.testing.assert_allclose(measured.posterior.theta(ours), own.theta(y), atol=1e-9)
    np.testing.assert_allclose(measured.posterior.natural(ours), own.natural(y), rtol=1e-9, atol=1e-12)
    exact = own.finer()
    density = (exact.log_density(y) - exact.log_prior(y)) - (
        measured.posterior.log_density(ours) - measured.posterior.log_prior(ours)
    )
    assert np.abs(density).max() < 0.05


def test_a_covariance_is_taken_over(legs):
    measured, own = see_legs(legs), legs.posterior
    start = own.approach()
    covariance = 1e-6 * np.eye(len(start))
    draws = start + 1e-3 * np.random.default_rng(2).standard_normal((4000, len(start)))
    found = measured.adopt_covariance(covariance, measured.adopt(start[None])[0])
    m = own.n_geometry
    expected = np.cov(measured.adopt(draws)[:, :m], rowvar=False)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.1)


def test_readings_taken_again_are_those_poses(legs):
    measured = see_legs(legs)
    values = measured.posterior.likelihood.data.values
    twice = measured.retake(np.concatenate([values, values + 1e-3]))
    assert twice.legs.poses.n_poses == twice.posterior.likelihood.data.n_poses == 24
    assert len(set(twice.legs.poses.names)) == 24
    np.testing.assert_allclose(twice.legs.poses.rotation[:12], legs.poses.rotation, atol=1e-12)
    np.testing.assert_array_equal(twice.legs.poses.actuators[12:], legs.poses.actuators + 1e-3)
    y = measured.found.approach()[None]
    alone = measured.found.log_density(y) - measured.found.log_prior(y)
    same = measured.retake(np.concatenate([values, values]))
    both = same.found.log_density(y) - same.found.log_prior(y)
    assert both == pytest.approx(2.0 * alone, rel=1e-9)
    some = replace(measured, legs=None).pick(np.arange(5))
    assert some.posterior.likelihood.data.n_poses == 5
