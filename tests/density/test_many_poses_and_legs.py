"""Some poses at a time, and many legs without a matrix of all of them: the numbers are those of all at once."""

from __future__ import annotations

import numpy as np
import pytest
from eliminated_legs import eliminate_legs, evaluate_legs

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density import pose_likelihood as likelihood_module
from bayescal.density.exact import ExactDensity
from bayescal.density.low_rank import factor_by_columns, find_low_rank
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import Machine, solve_inverse_kinematics
from bayescal.machines.models.six_ups import SixUps
from bayescal.machines.read import load_mechanism
from bayescal.numerics.geometry import matrix_from_rotation_vector
from bayescal.numerics.scratch import Scratch

NOISE = 2e-3
POSE_NOISE = np.diag([1e-2, 1e-2, 1e-2, 1e-5, 1e-5, 1e-5]) ** 2


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """Return a machine on twelve struts."""
    k = np.arange(12)
    low, high = (2 * np.pi * (k // 2 * 2 + np.where(k % 2, one, 1.0 - one)) / 12 for one in (0.7, 0.15))
    base = np.stack([900 * np.cos(low), 900 * np.sin(low), 20.0 * np.cos(3.0 * k)], axis=1)
    platform = np.stack([600 * np.cos(high), 600 * np.sin(high), 15.0 * np.sin(2.0 * k)], axis=1)
    path = tmp_path_factory.mktemp("machine") / "machine.toml"
    path.write_text(
        f'name = "struts"\n[base]\npoints_mm = {base.tolist()}\n[platform]\npoints_mm = {platform.tolist()}\n'
        '[home]\nposition_mm = [0.0, 0.0, 700.0]\n[legs]\ndrive = "strut"\nactuator_range_mm = 50.0\n'
    )
    return Machine(load_mechanism(path), SixUps(), NoDeformation())


def measure(machine, n_poses):
    """Return the density of poses that are off by some noise."""
    rng = np.random.default_rng(n_poses)
    move = rng.uniform(-20.0, 20.0, (n_poses, 6))
    move[:, 3:] *= 1e-3
    position = machine.mechanism.home_position + move[:, :3]
    rotation = matrix_from_rotation_vector(move[:, 3:])
    actuators = solve_inverse_kinematics(machine, machine.layout.nominal, position, rotation).actuators
    seen = position + 0.01 * rng.standard_normal(position.shape)
    names = tuple(f"p{k}" for k in range(n_poses))
    covariance = np.broadcast_to(POSE_NOISE, (n_poses, 6, 6))
    return PoseLikelihood(machine, MeasuredPoses(names, seen, rotation, covariance, actuators), NOISE)


@pytest.fixture(scope="module")
def density(machine):
    return measure(machine, 21)


@pytest.fixture(scope="module")
def theta(machine):
    nominal = machine.layout.nominal
    return nominal + 0.02 * np.random.default_rng(5).standard_normal((4, len(nominal)))


def test_low_rank_is_the_density_of_all_legs(density, theta):
    tau = np.random.default_rng(1).uniform(0.0, 0.02, (4, 12))
    errors = density.errors(theta).transpose(2, 1, 0)

    def add(leg):
        return density.actuator_weight[:, leg, None] * tau.T[leg] ** 2

    expected, square = factor_by_columns(density.legs_known, add, errors, Scratch())
    found, other = density._low_rank.evaluate(add, errors, Scratch())
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    np.testing.assert_allclose(other, square, rtol=1e-9)


def test_no_low_rank_where_digits_would_be_lost_or_legs_see_each_other(density):
    pose, known, few = density._pose_jacobian, density.legs_known, POSE_NOISE[None]
    assert find_low_rank(pose, few, known) is not None
    without = pose @ few @ np.swapaxes(pose, -1, -2)
    assert find_low_rank(pose, few, without + 1e-12 * np.eye(12)) is None
    assert find_low_rank(pose, few, known + 1e-5 * np.ones((12, 12))) is None
    assert find_low_rank(pose[:, :6], few, known[:, :6, :6]) is None


@pytest.mark.parametrize("kind", ["all legs alike", "each leg"])
def test_parts_are_the_whole(density, theta, monkeypatch, kind):
    tau = np.full(12, 0.01) if kind == "all legs alike" else np.random.default_rng(2).uniform(0.0, 0.02, (4, 12))
    whole = density.pointwise(theta, tau), density.errors(theta), density.evaluate(theta, tau)[1]
    exact = ExactDensity(density, NOISE)(theta, tau)
    monkeypatch.setattr(likelihood_module, "POSES", 16)  # eight poses of twelve legs
    parted = measure(density.machine, 21)
    assert len(parted.parts()) == 3
    found = parted.pointwise(theta, tau), parted.errors(theta), parted.evaluate(theta, tau)[1]
    for one, other in zip(found, whole, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(parted.leg_errors_by_leg(theta), whole[1].transpose(2, 1, 0), rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(ExactDensity(parted, NOISE)(theta, tau), exact, rtol=1e-11)
    apart = np.concatenate([part.pointwise(theta, tau) for _, part in parted.parts()], axis=1)
    np.testing.assert_array_equal(apart, found[0])


def test_more_legs_than_six_have_the_density_of_the_general_route(machine):
    """Commanded positions lie on a surface of six dimensions among twelve; struts' closures are in their units."""
    density, rng = measure(machine, 6), np.random.default_rng(8)
    theta = machine.layout.nominal + 0.003 * rng.standard_normal((3, machine.layout.size))
    tau = rng.uniform(0.0, 0.02, (3, 12))
    general = eliminate_legs(machine, density.poses, NOISE, machine.layout.nominal)
    found = evaluate_legs(general, theta, tau).sum(axis=1)
    np.testing.assert_allclose(found, ExactDensity(density, NOISE)(theta, tau), atol=0.02)
