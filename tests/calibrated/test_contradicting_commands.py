"""More commands than coordinates: another minimum of their least squares is left, and where they contradict is said."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from test_every_machine import build

from bayescal.calibrated.predict import bound_workspace, compensate_poses, predict_poses
from bayescal.calibrated.tables import MISFIT, format_prediction, read_commanded, say_contradictory

REDUNDANT = ("sliding platform", "hangprinter", "eight legs")


def command(machine, pose, rng=None):
    """Return the commands of poses (P, q); of drawn machines, with the errors that these have, where there is a rng."""
    model, own = machine.model, machine.commanded
    if rng is None:
        return model.read(machine.theta, pose)[:, own]
    found = []
    for draw, one in zip(machine.draws, pose, strict=False):
        theta = machine.theta.copy()
        theta[machine.free] = draw
        (read,) = model.read(theta, one[None])[:, own]
        (covariance,) = machine.errors.covariance(one[None], read[None])
        found.append(rng.multivariate_normal(read, covariance))
    return np.array(found)


def spread(machine, n, rng):
    low, high = bound_workspace(machine)
    return 0.5 * (low + high) + 0.4 * (high - low) * rng.uniform(-1.0, 1.0, (n, len(low)))


@pytest.mark.parametrize("name", REDUNDANT)
def test_commands_contradict_as_much_as_the_calibration_leaves(name, tmp_path, rng):
    machine = build(name, tmp_path)
    spare = len(machine.commanded) - len(machine.model.coordinates)
    found = predict_poses(machine, command(machine, spread(machine, 200, rng), rng))
    assert not found.contradictory.any()
    square = np.mean(found.misfit**2)  # of mean one
    assert abs(square - 1.0) < 4.0 * np.sqrt(2.0 / (200 * spare))


@pytest.mark.parametrize("name", REDUNDANT)
def test_a_row_of_contradicting_commands_is_named(name, tmp_path, rng):
    machine = build(name, tmp_path)
    pose = spread(machine, 5, rng)
    commands, model = command(machine, pose), machine.model
    slope = model.linearise(machine.theta, pose[2:3], False, {}).by_pose[0, machine.commanded] * model.pose_scale
    commands[2] += 0.1 * np.ptp(commands) * np.linalg.svd(slope)[0][:, -1]
    found, names = predict_poses(machine, commands), ["A", "B", "C", "D", "E"]
    np.testing.assert_array_equal(found.contradictory, [False, False, True, False, False])
    said = say_contradictory(tmp_path / "c.csv", names, found)
    assert "'C'" in said
    assert "'B'" not in said
    (tmp_path / "p.csv").write_text(format_prediction(machine, names, found, {}))
    table = pd.read_csv(tmp_path / "p.csv", comment="#")
    np.testing.assert_allclose(table[MISFIT], found.misfit, rtol=1e-3, atol=1e-3)
    assert len(read_commanded(tmp_path / "p.csv", machine).poses) == 5


def test_another_minimum_is_left_or_said(tmp_path, rng):
    machine = build("sliding platform", tmp_path)
    model = machine.model
    pose = model.home_pose + np.array([300.0, 300.0, 1.3]) * rng.uniform(-1.0, 1.0, (1000, 3))
    commands = command(machine, pose)
    pose, commands = (one[np.isfinite(commands).all(axis=1)] for one in (pose, commands))

    def is_off(found):
        turns = 2.0 * np.pi * np.array([0.0, 0.0, 1.0])
        apart = found - pose - turns * np.round((found - pose) / (2.0 * np.pi))
        return np.abs(apart).max(axis=1) > 1e-3

    alone, _ = model.locate(machine.theta, commands, weights=machine.weights)
    found = predict_poses(machine, commands)
    assert np.nansum(is_off(alone)) >= 10
    assert is_off(found.pose).sum() <= 0.25 * np.nansum(is_off(alone))
    assert found.found.all()
    assert not (found.contradictory & ~is_off(found.pose)).any()
    silent = is_off(found.pose) & ~found.contradictory  # close to where two poses become one, both fit
    assert silent.sum() <= 0.1 * np.nansum(is_off(alone))


def test_no_more_commands_than_coordinates_cannot_contradict(tmp_path, rng):
    machine = build("delta", tmp_path)
    found = predict_poses(machine, machine.measured)
    assert found.misfit is None
    assert not found.contradictory.any()
    assert say_contradictory(tmp_path, [], found) == ""
    assert compensate_poses(machine, found.pose, coordinates=True).reached.all()
