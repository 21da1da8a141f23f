"""The density of readings whose poses are integrated out."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest
from numpy.polynomial.hermite_e import hermegauss
from reading_machines import SENSORS, SETS, WORKSPACE, LinearModel, gaussian_log_evidence, sliding_star, star_of

from bayescal.density.readings.likelihood import ReadingLikelihood
from bayescal.experiments.shared.sensor_sets import SensorSet
from bayescal.experiments.shared.reading_machine import build_sensors, draw_poses, free_parameters, workspace_volume
from bayescal.machines.readings.schema import ReadingTolerancesConfig

VOLUME = workspace_volume(WORKSPACE)
TOLERANCES = ReadingTolerancesConfig(length_mm=0.3, angle_deg=0.05, zero_deg=2.0)


def make(names, seed=2, model=None):
    """Return sensors, a likelihood of noisy readings, machines within the tolerances and the poses."""
    model = model or sliding_star()
    rng = np.random.default_rng(seed)
    sensors = build_sensors(model, SENSORS, names)
    free = free_parameters(model, sensors.names, TOLERANCES)
    pose = draw_poses(model, WORKSPACE, rng)
    theta = free.draw(rng, 1)[0]
    measured = sensors.read(theta, pose) + sensors.noise * rng.standard_normal((len(pose), len(sensors.chosen)))
    near = theta + 1e-3 * free.draw(rng, 4) - 1e-3 * free.centre
    return sensors, ReadingLikelihood(sensors, measured, pose, VOLUME), near, pose


def test_linear_readings_have_the_closed_form(rng):
    model = LinearModel(rng.standard_normal((6, 2)), rng.standard_normal((6, 3)))
    sensors = SensorSet(model, np.array([0, 1, 3, 4, 5]), rng.uniform(0.5, 2.0, 5))
    measured = rng.standard_normal((7, 5))
    likelihood = ReadingLikelihood(sensors, measured, np.zeros((7, 2)), 50.0)
    theta = rng.standard_normal((3, 3))
    for machine, found in zip(theta, likelihood(theta), strict=True):
        shifted = measured - sensors.read(machine, np.zeros(2))
        assert found == pytest.approx(
            gaussian_log_evidence(sensors, shifted, np.zeros((7, 2)), np.zeros((1, 3)), 50.0), rel=1e-12
        )


@pytest.mark.parametrize("names", [*SETS.values(), ("s", "phi[2]")])
def test_it_is_the_integral_over_the_pose(names):
    """Gauss-Hermite quadrature over all three coordinates of each pose, with the machine itself."""
    sensors, likelihood, theta, _ = make(names)
    nodes, weights = hermegauss(7)
    grid = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    weight = (weights[:, None, None] * weights[:, None] * weights).ravel()
    pose, _ = likelihood.find_poses(theta[:1])
    slope = sensors.linearise(theta[0], pose[0], with_parameters=False).by_pose
    factor = np.linalg.cholesky(np.linalg.inv(np.swapaxes(slope, 1, 2) @ slope))
    stand = pose[0][:, None] + np.einsum("pij,gj->pgi", factor, grid)
    error = (likelihood.measured[:, None] - sensors.read(theta[0], stand)) / sensors.noise
    scale = -np.log(sensors.noise).sum() - 0.5 * len(sensors.noise) * np.log(2 * np.pi)
    inside = -0.5 * (error**2).sum(axis=-1) + 0.5 * (grid**2).sum(axis=-1)
    log_integral = np.log(np.sum(weight * np.exp(inside - inside[:, :1]), axis=1)) + inside[:, 0]
    expected = log_integral + scale + np.linalg.slogdet(factor)[1] - np.log(VOLUME)
    np.testing.assert_allclose(likelihood.pointwise(theta[:1])[0], expected, rtol=0, atol=1e-4)


def test_the_density_is_normalised():
    """Integrated over all readings that the workspace gives, with volume elements of its own.

    Four readings s = h(v) + t u of a machine with three legs: v over the workspace, t across its image.
    """
    model = star_of(3)
    names = ("s", "phi[1]")
    sensors = build_sensors(model, SENSORS, names)
    rng = np.random.default_rng(1)
    small = WORKSPACE.model_copy(update={"n_poses": 400, "angle_deg": 10.0})
    pose, volume = draw_poses(model, small, rng), workspace_volume(small)
    nominal, direction = model.layout.nominal, np.array([0.0, 0.0, 0.0, 1.0])
    slope = model.linearise(nominal, pose, with_parameters=False).by_pose[:, sensors.chosen]
    element = np.abs(np.linalg.det(np.concatenate([slope, np.broadcast_to(direction[:, None], (400, 4, 1))], axis=2)))
    width = 5.0 * sensors.noise[3]
    # what of t stands out of the image is seen less of, where the other readings make up for it
    steps = np.linspace(-8.0 * width, 8.0 * width, 161)
    total = np.zeros(400)
    for t in steps:
        measured = sensors.read(nominal, pose) + t * direction
        likelihood = ReadingLikelihood(sensors, measured, pose, volume)
        total += np.exp(likelihood.pointwise(nominal[None])[0]) * element * (steps[1] - steps[0])
    # E over v of ∫ p |ds/d(v, t)| dt, times the volume that v is drawn from
    assert total.mean() * volume == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("names", SETS.values())
def test_residuals_are_orthogonal_to_every_move_of_the_pose(names):
    sensors, likelihood, theta, _ = make(names)
    pose, error = likelihood.find_poses(theta)
    slope = sensors.linearise(theta[:, None], pose, with_parameters=False).by_pose
    unit = slope / np.linalg.norm(slope, axis=2, keepdims=True)
    assert np.abs(np.einsum("bpkq,bpk->bpq", unit, error)).max() < 1e-4
    left = (likelihood.measured - sensors.read(theta[:, None], pose)) / sensors.noise
    np.testing.assert_allclose(error, left, rtol=0, atol=1e-4)


@pytest.mark.parametrize("names", SETS.values())
def test_residuals_change_as_their_derivative_says(names, rng):
    _, likelihood, theta, _ = make(names)
    units = np.array(likelihood.sensors.model.layout.units)
    error, slope = likelihood.linearise(theta[0])
    move = rng.standard_normal(theta.shape[1]) * np.where(units == "mm", 1e-4, 1e-7)
    ahead, back = (likelihood.find_poses(theta[:1] + sign * move)[1][0] for sign in (1, -1))
    # what is orthogonal to H at both ends; the rest turns with H and is as small as the residual
    np.testing.assert_allclose(0.5 * (ahead - back), slope @ move, atol=2e-3 * np.abs(slope @ move).max())
    assert error.shape == likelihood.measured.shape


@pytest.mark.parametrize("misfit", [1.0, 300.0])
def test_an_anchor_shortens_the_way_and_leaves_the_end(misfit, rng):
    sensors, likelihood, theta, pose = make(SETS[8])
    spoilt = likelihood.measured + (misfit - 1.0) * sensors.noise * rng.standard_normal(likelihood.measured.shape)
    likelihood = ReadingLikelihood(sensors, spoilt, pose, VOLUME)
    anchored, counts = likelihood.anchored(theta[0]), []
    for one in (likelihood, anchored):
        with mock.patch.object(SensorSet, "read", autospec=True, side_effect=SensorSet.read) as read:
            one(theta)
        counts.append(read.call_count)
    np.testing.assert_allclose(anchored.pointwise(theta), likelihood.pointwise(theta), rtol=1e-10, atol=1e-8)
    assert counts[1] < counts[0]


def test_a_machine_that_cannot_stand_has_no_density():
    _, likelihood, theta, _ = make(SETS[8])
    theta[1, likelihood.sensors.model.layout.index["l"]] = 50.0
    found = likelihood(theta)
    assert np.isneginf(found[1])
    assert np.isfinite(found[[0, 2, 3]]).all()


def test_batches_change_nothing(rng):
    _, likelihood, theta, _ = make(SETS[4])
    many = np.repeat(theta, 40, axis=0) * (1 + 1e-7 * rng.standard_normal((160, theta.shape[1])))
    whole = likelihood.pointwise(many)
    one_by_one = np.concatenate([likelihood.pointwise(many[k : k + 1]) for k in range(len(many))])
    np.testing.assert_allclose(whole, one_by_one, rtol=0, atol=1e-9)
