"""What error remains: by tangent and by closures alike, against forward kinematics, and how probable it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.errors import NumericalError
from bayescal.identifiability import requirements
from bayescal.identifiability.requirements import Requirement, Standing, ToolRemaining, move_draws
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import compute_pose_error

N_DRAWS, N_POSES = 60, 15
QUIET = 1e-9  # mm
REQUIREMENTS = [Requirement("z", 0.02), Requirement("position", 0.05), Requirement("rotation_x", 1e-4)]


@pytest.fixture(scope="module")
def place():
    """Return where a machine is to be accurate, without any noise, and true machines."""
    machine, rng = machines.build_machine("none"), np.random.default_rng(2)
    theta = machine.layout.nominal
    start = machine.mechanism.initial_actuator_positions
    actuators = start + 5.0 * rng.uniform(-1.0, 1.0, (N_POSES, 6))
    true = np.tile(theta, (N_DRAWS, 1))
    true[:, machine.layout.index["l"]] += 0.02 * rng.standard_normal((N_DRAWS, 6))
    pose, _ = Legs(machine).locate(theta, actuators)
    return ToolRemaining(Legs(machine), np.arange(6), theta, pose, {}, np.full((N_DRAWS, 6), QUIET), 1), true


def compute_directly(place: ToolRemaining, true: np.ndarray) -> np.ndarray:
    """Return the largest errors in shares of the limits by forward kinematics of both machines."""
    machine, actuators = place.model.machine, place.model.read(place.theta, place.pose)[:, :6]
    predicted = solve_forward_kinematics(machine, place.theta, actuators)
    stood = solve_forward_kinematics(machine, true[:, None], actuators)
    error = compute_pose_error(stood.position, stood.rotation, predicted.position, predicted.rotation)
    return np.stack([(r.take(error) / r.limit).max(axis=1) for r in REQUIREMENTS], axis=1)


def test_errors_are_those_of_forward_kinematics(place):
    found, true = place
    np.testing.assert_allclose(
        found.find_largest(REQUIREMENTS, true), compute_directly(found, true), rtol=0.0, atol=2e-3
    )


def test_bent_machines_are_followed_by_their_closures(place, monkeypatch):
    """Joints off by a tenth of a leg's length: the tangent misses more than the closure does."""
    found, true = place
    far, a_x = np.tile(found.theta, (N_DRAWS, 1)), found.model.layout.index["a_x"]
    far[:, a_x] += 15.0 * np.random.default_rng(7).standard_normal((N_DRAWS, 6))
    assert found._leaves_tangent(far)
    assert not found._leaves_tangent(true)
    followed = found.find_largest(REQUIREMENTS, far)
    monkeypatch.setattr(requirements, "BENT", np.inf)
    expected, tangent = compute_directly(found, far), found.find_largest(REQUIREMENTS, far)
    off = [np.median(np.abs(one / expected - 1.0)) for one in (followed, tangent)]
    assert off[0] < 0.9 * off[1], off


def test_noise_has_the_spread_that_is_stated(place):
    """A single pose: actuators with σ of each draw move it as those with the root mean square of all would."""
    one = replace(place[0], pose=place[0].pose[:1])
    exact, limits = np.tile(one.theta, (4000, 1)), [Requirement("z", 1.0)]
    each = 0.005 * np.sqrt(np.tile([0.5, 1.5], 2000))[:, None] * np.ones(6)
    both = replace(one, sd=each).find_largest(limits, exact)
    alone = replace(one, sd=np.full((4000, 6), 0.005), seed=8).find_largest(limits, exact)
    assert np.mean(both**2) / np.mean(alone**2) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 * 2.0 / 4000))
    gain = np.linalg.inv(one.model.linearise(one.theta, one.pose[0]).by_pose[:6])
    assert np.sqrt(np.mean(alone**2)) == pytest.approx(0.005 * np.linalg.norm(gain[2]), rel=0.05)


def test_a_workspace_out_of_reach_is_told(place):
    with pytest.raises(NumericalError, match="poses that the calibrated machine cannot take"):
        replace(place[0], pose=place[0].pose + 1e5).find_largest(REQUIREMENTS, place[1])


def test_a_machine_that_cannot_be_there_exceeds_every_limit(place):
    found, true = place
    broken = true.copy()
    broken[3] = np.nan
    largest = found.find_largest(REQUIREMENTS, broken)
    assert np.isinf(largest[3]).all()
    assert np.isfinite(np.delete(largest, 3, axis=0)).all()


def test_requirements_hold_together_where_each_does():
    standing = Standing(np.array([[0.5, 0.5], [0.9, 1.1], [1.2, 0.8], [1.0, 0.2]]))
    assert standing.probability == 0.5
    np.testing.assert_allclose(standing.probabilities, [0.75, 0.75])
    assert list(standing.bound(0.75)) == [1.2, 1.1]
    assert standing.standard_error == pytest.approx(0.25)


def test_moved_draws_have_the_other_covariance():
    rng = np.random.default_rng(4)
    before, after = (a @ a.T for a in rng.standard_normal((2, 5, 5)))
    draws = np.linalg.cholesky(before) @ rng.standard_normal((5, 50))
    moved = move_draws(draws.T, before, after)
    whitened = [np.linalg.solve(np.linalg.cholesky(c), d) for c, d in ((before, draws), (after, moved.T))]
    np.testing.assert_allclose(*whitened)
