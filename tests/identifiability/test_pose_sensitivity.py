"""The Jacobian as a table; legs that err by functions of the pose against dense covariances."""

from __future__ import annotations

from dataclasses import replace

import audit_problems as problems
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.density.errors import FunctionScales, LegErrors, ModelError
from bayescal.density.functions import FunctionLikelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import SmoothKernel
from bayescal.identifiability.design import SystematicErrors
from bayescal.identifiability.information import information_of_rows, marginalise
from bayescal.identifiability.sensitivity import compute_sensitivity, inform, tabulate_jacobian
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import compute_pose_error


def build(sizes, n_legs=6):
    machine = machines.build_machine("linear", machines.build_random_mechanism(n_legs, 4))
    knowledge, plan = problems.build_knowledge(machine), problems.build_plan(machine, 14, model_error=2e-3)
    return knowledge, replace(plan, systematic=SystematicErrors(sizes))


@pytest.mark.parametrize(("drift", "within"), [({}, 1e-6), ({"drift": 7e-3}, 2e-3)])  # it is of twelve columns
def test_information_beside_errors_of_several_sorts_is_that_of_a_study(drift, within):
    """An audit's columns against the study's covariance of all rows, at the same sizes and places in order."""
    sizes = {"linear": 5e-3, "own": 8e-3, "smooth": 12e-3, **drift}
    knowledge, plan = build(sizes)
    machine, theta, free = knowledge.machine, knowledge.machine.layout.nominal, knowledge.free
    poses = machines.place_poses(machine, theta, plan.actuators, np.zeros((14, 6)))
    poses = replace(poses, covariance=np.linalg.inv(plan.sensors[0].information(poses.position, poses.rotation)))
    order = {name: k / 14 for k, name in enumerate(poses.names)}
    base = PoseLikelihood(machine, poses, plan.actuator_noise)
    study = FunctionLikelihood(base, tuple(sizes), machine.mechanism.actuator_range, order)
    errors = LegErrors.of_legs(6, [ModelError(1e-2, shared=True), FunctionScales(tuple(sizes), 0.02)])
    values = [plan.model_error, *sizes.values()]
    zeta = np.array([float(one.standardise(np.array(x))) for one, x in zip(errors.priors, values, strict=True)])
    change = np.eye(len(theta))[:, free] * knowledge.sd
    expected, found = study.inform(theta, change, errors, zeta), inform(knowledge, plan)
    assert np.abs(found.matrix - expected).max() < within * np.abs(expected).max()
    bare = inform(knowledge, replace(plan, systematic=None))
    assert bare.nats > found.nats + 5.0


@pytest.mark.parametrize("n_legs", [6, 8])
def test_an_error_that_is_small_changes_nothing_and_a_larger_one_tells_less(n_legs):
    knowledge, plan = build({"linear": 1e-9}, n_legs)
    rows = compute_sensitivity(knowledge, plan.actuators).rows(plan)
    without = information_of_rows(rows, knowledge.sd)
    np.testing.assert_allclose(inform(knowledge, plan).contraction, without.contraction, atol=1e-7)
    nats = [inform(knowledge, replace(plan, systematic=SystematicErrors({"linear": s}))).nats for s in (5e-3, 0.05)]
    assert without.nats > nats[0] + 1.0 > nats[1] + 2.0


def test_marginalising_is_the_inverse_of_the_whole_covariance():
    rng = np.random.default_rng(0)
    rows, others = rng.standard_normal((30, 4)), rng.standard_normal((30, 7))
    expected = rows.T @ np.linalg.solve(np.eye(30) + others @ others.T, rows)
    np.testing.assert_allclose(marginalise(rows, others).matrix, expected, rtol=1e-10)


def test_simulated_calibrations_err_as_foretold():
    """Linear least squares of twins whose legs err by functions drawn from the kernel: sds to four standard errors."""
    rng, n = np.random.default_rng(1), 4000
    knowledge, plan = build({"smooth": 0.02})
    sensitivity = compute_sensitivity(knowledge, plan.actuators)
    mechanism = knowledge.machine.mechanism
    travel = (plan.actuators - mechanism.initial_actuator_positions) / mechanism.actuator_range
    kernel = SmoothKernel(1.0)(travel, travel)
    root = np.linalg.cholesky(kernel / np.diagonal(kernel).mean() + 1e-12 * np.eye(14))
    drawn = 0.02 * np.einsum("pq,nqi->npi", root, rng.standard_normal((n, 14, 6)))
    own = np.diagonal(sensitivity.by_actuators, axis1=-2, axis2=-1)
    moved = -np.einsum("pij,npj->npi", sensitivity.gain, own * drawn)
    rows = (sensitivity.rows(plan) * knowledge.sd).reshape(-1, len(knowledge.sd))
    seen = np.einsum("pij,npj->npi", sensitivity.root(plan), moved).reshape(n, -1)
    truth = rng.standard_normal((n, len(knowledge.sd)))
    measured = truth @ rows.T + seen + rng.standard_normal(seen.shape)
    whole = np.linalg.inv(np.eye(rows.shape[0]) + np.cov(seen, rowvar=False))  # nothing of the package's own columns
    information = rows.T @ whole @ rows
    estimate = measured @ whole @ rows @ np.linalg.inv(np.eye(len(information)) + information)
    found, foretold = (estimate - truth).std(axis=0), np.sqrt(np.diagonal(inform(knowledge, plan).covariance))
    assert np.abs(found / foretold - 1.0).max() < 4.0 / np.sqrt(2.0 * n)
    assert (foretold / np.sqrt(np.diagonal(information_of_rows(rows, np.ones(rows.shape[1])).covariance))).max() > 1.5


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
