"""The Jacobian as a table; legs that err by functions of the pose against dense covariances."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.identifiability.information import marginalise
from bayescal.identifiability.sensitivity import tabulate_jacobian
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import compute_pose_error


def test_marginalising_is_the_inverse_of_the_whole_covariance():
    rng = np.random.default_rng(0)
    rows, others = rng.standard_normal((30, 4)), rng.standard_normal((30, 7))
    expected = rows.T @ np.linalg.solve(np.eye(30) + others @ others.T, rows)
    np.testing.assert_allclose(marginalise(rows, others).matrix, expected, rtol=1e-10)


# --- the Jacobian as a table ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["l[1]", "a_x[4]", "b_z[6]"])
def test_columns_are_derivatives_of_the_pose(name):
    machine = machines.build_machine("none")
    actuators = machines.table_3_actuators()[:3]
    table = tabulate_jacobian(machine, actuators, [name])
    k = machine.layout.names.index(name)
    poses = []
    for sign in (-1.0, 1.0):
        theta = machine.layout.nominal.copy()
        theta[k] += sign * 1e-4
        poses.append(solve_forward_kinematics(machine, theta, actuators))
    low, high = poses
    slope = compute_pose_error(high.position, high.rotation, low.position, low.rotation) / 2e-4
    assert table.index.names == ["pose", "component"]
    np.testing.assert_allclose(table[name].to_numpy().reshape(3, 6), slope, rtol=1e-5, atol=1e-9)


def test_all_parameters_by_default_in_their_order():
    machine = machines.build_machine("none")
    table = tabulate_jacobian(machine, machines.table_3_actuators()[0])
    assert list(table.columns) == list(machine.layout.names)
    assert table.shape == (6, machine.layout.size)
    assert "l[1]" in table.to_string()
