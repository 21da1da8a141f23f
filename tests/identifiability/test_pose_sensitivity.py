"""Derivatives of poses by parameters, and marginal information, against differences and dense covariances."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.identifiability.design import Knowledge
from bayescal.identifiability.information import marginalise
from bayescal.identifiability.sensitivity import compute_sensitivity
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import compute_pose_error


def test_marginalising_is_the_inverse_of_the_whole_covariance():
    rng = np.random.default_rng(0)
    rows, others = rng.standard_normal((30, 4)), rng.standard_normal((30, 7))
    expected = rows.T @ np.linalg.solve(np.eye(30) + others @ others.T, rows)
    np.testing.assert_allclose(marginalise(rows, others).matrix, expected, rtol=1e-10)


@pytest.mark.parametrize("name", ["l[1]", "a_x[4]", "b_z[6]"])
def test_columns_are_derivatives_of_the_pose(name):
    machine = machines.build_machine("none")
    actuators = machines.table_3_actuators()[:3]
    found = compute_sensitivity(Knowledge(machine, {name: 1.0}), actuators).slope
    k = machine.layout.names.index(name)
    poses = []
    for sign in (-1.0, 1.0):
        theta = machine.layout.nominal.copy()
        theta[k] += sign * 1e-4
        poses.append(solve_forward_kinematics(machine, theta, actuators))
    low, high = poses
    slope = compute_pose_error(high.position, high.rotation, low.position, low.rotation) / 2e-4
    np.testing.assert_allclose(found[..., 0], slope, rtol=1e-5, atol=1e-9)
