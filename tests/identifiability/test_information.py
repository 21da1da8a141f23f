"""Information against closed forms and against the package's own likelihood; nothing depends on units."""

from __future__ import annotations

from dataclasses import replace

import audit_problems as problems
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.density.priors import NormalPrior
from bayescal.errors import InputError
from bayescal.experiments.audit.audit import judge_parameters
from bayescal.identifiability.directions import find_directions
from bayescal.identifiability.information import (
    Information,
    information_of_rows,
    marginalise,
    nats_from_contraction,
    root_of,
)
from bayescal.identifiability.reading_rows import see
from bayescal.identifiability.selection import select_parameters
from bayescal.identifiability.structure import find_structure
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.machines.sensors import PointSensor, PoseSensor
from bayescal.numerics.geometry import compute_pose_error, matrix_from_rotation_vector, skew_matrix
from bayescal.pose_selection import Design, WorkspaceBox


def test_contraction_of_one_measured_parameter():
    """A parameter of tolerance 2 measured four times with noise 1: 1 / (1/4 + 4) is left of its variance."""
    information = information_of_rows(np.ones((4, 1)), np.array([2.0]))
    variance = 1.0 / (0.25 + 4.0)
    assert information.contraction[0] == pytest.approx(1.0 - variance / 4.0, rel=1e-12)
    assert nats_from_contraction(information.contraction)[0] == pytest.approx(0.5 * np.log(4.0 / variance), rel=1e-12)
    assert information.nats == pytest.approx(0.5 * np.log(4.0 / variance), rel=1e-12)


def test_contraction_of_a_sum():
    """Two parameters of which only the sum is measured, exactly: half of each is left, their difference whole."""
    information = information_of_rows(np.array([[1e6, 1e6]]), np.ones(2))
    assert information.contraction == pytest.approx([0.5, 0.5], abs=1e-10)
    along = information.contraction_along(np.array([[1.0, 1.0], [1.0, -1.0]]))
    assert along == pytest.approx([1.0, 0.0], abs=1e-10)


@pytest.mark.parametrize("model", ["six_pus", "jacobian", "beam", "stiffness", "six_ups"])
@pytest.mark.parametrize("n_legs", [6, 8])
def test_information_is_that_of_the_likelihood(model, n_legs):
    """The Fisher information of the density at data without noise, redundant legs too."""
    if n_legs == 8 and model in machines.SIX_LEGS_ONLY:
        pytest.skip("six legs only")
    machine = machines.build_machine("linear", machines.build_random_mechanism(n_legs, 4), model)
    knowledge = problems.build_knowledge(machine)
    seen = problems.see_plan(knowledge, problems.build_plan(machine, 12, model_error=2e-3))
    closing = knowledge.readings.read(knowledge.theta, seen.placed.pose)
    poses = machines.place_poses(machine, knowledge.theta, closing, np.zeros((12, 6)))
    poses = replace(poses, covariance=np.linalg.inv(seen.design.inform(seen.placed)))
    noise = np.hypot(seen.design.actuator_noise, seen.design.model_error)  # actuators bend no other legs' joints
    posterior = machines.measure(machine, poses, {}, noise=noise)
    change = np.eye(machine.layout.size)[:, knowledge.free] * knowledge.sd
    expected = posterior.likelihood.inform(knowledge.theta, change, posterior.errors, np.zeros(0))
    found = information_of_rows(seen.rows, np.ones(len(knowledge.sd))).matrix
    close = 2e-3 if model == "stiffness" else 1e-7  # whose legs err by themselves, while actuators move all legs
    assert np.abs(found - expected).max() < close * np.abs(expected).max()


SEEN = {
    "poses": PoseSensor(0.01, 1e-5),
    "positions": PoseSensor(0.01, None),
    "two positions": PoseSensor(0.01, None, "xz"),
    "targets": PointSensor(100.0 * np.eye(3), 0.01, 300.0 * np.eye(3)),
}


@pytest.mark.parametrize("n_legs", [6, 8])
@pytest.mark.parametrize("sensor", SEEN)
def test_rows_of_a_selection_are_those_of_an_audit(sensor, n_legs):
    """Sensors by what they tell of the pose, and as channels beside the actuators, poses eliminated."""
    machine = machines.build_machine("none", machines.build_random_mechanism(n_legs, 4))
    knowledge, plan = problems.build_knowledge(machine), problems.build_plan(machine, 20, sensors=(SEEN[sensor],))
    posterior = problems.read_plan(knowledge, plan)
    assert posterior.likelihood.model.names[:n_legs] == tuple(f"rho[{leg}]" for leg in range(1, n_legs + 1))
    start = posterior.likelihood.start
    rows = [see(posterior, np.zeros(posterior.n_geometry))]
    placed = WorkspaceBox(knowledge, np.ones(6)).at_moves(np.zeros_like(start))
    placed = replace(placed, position=start[:, :3], rotation=matrix_from_rotation_vector(start[:, 3:]))
    design = replace(knowledge, sensors=plan.sensors, actuator_noise=plan.actuator_noise)
    rows.append(design.see(placed).rows)
    chosen, audited = (np.einsum("pki,pkj->ij", one, one) for one in rows)
    np.testing.assert_allclose(chosen, audited, atol=1e-11 * np.abs(audited).max())


@pytest.mark.parametrize("name", ["l[1]", "a_x[4]", "b_z[6]"])
def test_columns_are_derivatives_of_the_pose(name):
    machine = machines.build_machine("none")
    actuators = machines.table_3_actuators()[:3]
    k = machine.layout.names.index(name)
    design = Design(machine, {name: NormalPrior(machine.layout.nominal[k], 1.0)})
    found = design.see(WorkspaceBox(design, np.ones(6)).at_actuators(actuators)).slope
    theta = np.tile(machine.layout.nominal, (2, 1))
    theta[:, k] += [-1e-4, 1e-4]
    low, high = (solve_forward_kinematics(machine, one, actuators) for one in theta)
    slope = compute_pose_error(high.position, high.rotation, low.position, low.rotation) / 2e-4
    np.testing.assert_allclose(found[..., 0], slope, rtol=1e-5, atol=1e-9)


def test_marginalising_is_the_inverse_of_the_whole_covariance():
    rng = np.random.default_rng(0)
    rows, others = rng.standard_normal((30, 4)), rng.standard_normal((30, 7))
    expected = rows.T @ np.linalg.solve(np.eye(30) + others @ others.T, rows)
    np.testing.assert_allclose(marginalise(rows, others).matrix, expected, rtol=1e-10)
    signs, others = np.array([1.0, 1, -1, 1, -1, 1, 1]), 0.1 * others
    expected = rows.T @ np.linalg.solve(np.eye(30) + (others * signs) @ others.T, rows)
    np.testing.assert_allclose(marginalise(rows, others, signs).matrix, expected, rtol=1e-10)


# --- units -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("deformation", ["none", "linear"])
def test_units_do_not_matter(deformation):
    """The same machine in metres, kilometres per hour would do too: contractions, nats, kinds, verdicts, selection."""
    knowledge, plan = problems.build_telescope_problem(deformation)
    rows = problems.compute_rows(knowledge, plan) / knowledge.sd
    n = rows.shape[-1]
    rng = np.random.default_rng(0)
    unit = np.array([1e-3 if u == "mm" else 180 / np.pi for u in problems.list_units(knowledge)])
    twin_noise = 1e-15 * rng.uniform(-1, 1, rows.shape)
    found = []
    for factor in (np.ones(n), unit):
        converted, sd = rows / factor, knowledge.sd * factor
        information = information_of_rows(converted, sd)
        scaled = (converted * sd).reshape(-1, n)
        structure = find_structure(scaled, [scaled * (1 + twin_noise.reshape(-1, n))])
        selection = select_parameters(information, problems.list_symbols(knowledge))
        directions = find_directions(information, structure.null_space, selection.fixed)
        found.append(
            (information, structure.rank, selection, directions, judge_parameters(information, structure.null_space))
        )
    (one, rank, selection, directions, verdicts), (other, rank_2, selection_2, directions_2, verdicts_2) = found
    assert rank == rank_2
    assert selection.free == selection_2.free
    assert verdicts == verdicts_2
    assert other.contraction == pytest.approx(one.contraction, abs=1e-9)
    assert other.nats == pytest.approx(one.nats, rel=1e-9)
    assert [d.kind for d in directions] == [d.kind for d in directions_2]
    assert [d.contraction for d in directions_2] == pytest.approx([d.contraction for d in directions], abs=1e-6)


# --- sensors -----------------------------------------------------------------------------------------------------


def test_root_gives_back_the_matrix():
    rng = np.random.default_rng(3)
    slope = rng.normal(size=(5, 4, 6)) * np.array([1, 1, 1, 1e3, 1e3, 1e3])
    matrix = np.swapaxes(slope, -1, -2) @ slope
    root = root_of(matrix)
    assert np.abs(np.swapaxes(root, -1, -2) @ root - matrix).max() < 1e-12 * np.abs(matrix).max()


def test_points_tell_what_a_rigid_fit_would():
    """Noise of simulated targets, fitted to first order, has the covariance that the sensor claims."""
    rng = np.random.default_rng(5)
    points = rng.normal(0, 100, (10, 3))
    rotation = matrix_from_rotation_vector(np.array([0.3, -0.2, 0.5]))
    sensor = PointSensor(points, 0.01)
    information = sensor.information(np.zeros((1, 3)), rotation[None])[0]
    arms = points @ rotation.T
    design = np.concatenate([np.concatenate([np.eye(3), -skew_matrix(arm)], axis=1) for arm in arms])
    noise = rng.normal(0, 0.01, (20000, 30))
    fits = noise @ np.linalg.pinv(design).T
    ratio = np.sqrt(np.diagonal(np.cov(fits.T)) / np.diagonal(np.linalg.inv(information)))
    assert ratio == pytest.approx(np.ones(6), abs=0.03)


def test_base_targets_cost_what_their_fit_is_uncertain():
    """A base seen with many targets is as good as one that is known; with few it is worse."""
    rng = np.random.default_rng(6)
    platform, place = rng.normal(0, 100, (12, 3)), (np.array([[0.0, 0.0, 500.0]]), np.eye(3)[None])
    known = np.trace(np.linalg.inv(PointSensor(platform, 0.003).information(*place)[0])[:3, :3])
    few, many = (
        np.trace(np.linalg.inv(PointSensor(platform, 0.003, rng.normal(0, 150, (n, 3))).information(*place)[0])[:3, :3])
        for n in (4, 40_000)
    )
    assert many == pytest.approx(known, rel=0.01)
    assert few > 2.0 * known


def test_redundant_legs_need_actuator_noise():
    machine = machines.build_machine("none", machines.build_random_mechanism(7, 1))
    knowledge = problems.build_knowledge(machine)
    plan = problems.build_plan(machine, 6, actuator_noise=0.0)
    with pytest.raises(InputError, match="redundant"):
        problems.compute_rows(knowledge, plan)


def test_actuators_without_noise_are_the_limit_of_little_noise():
    machine = machines.build_machine()
    knowledge = problems.build_knowledge(machine, ("l", "a_x"))
    rows = [problems.compute_rows(knowledge, problems.build_plan(machine, 8, actuator_noise=s)) for s in (0.0, 1e-7)]
    assert np.abs(rows[0] - rows[1]).max() < 1e-6 * np.abs(rows[0]).max()


def test_sensor_noise_scales_information():
    machine = machines.build_machine()
    knowledge = problems.build_knowledge(machine, ("l", "a_x"))
    plan = problems.build_plan(machine, 8, actuator_noise=0.0)
    coarse = problems.Plan(plan.actuators, (PoseSensor(0.02, np.radians(4 / 3600)),), 0.0)
    assert problems.compute_rows(knowledge, coarse) == pytest.approx(0.5 * problems.compute_rows(knowledge, plan))


def test_verdicts_follow_what_is_left():
    """Known; hidden in a sum that is known with another; known too little."""
    rows = np.array([[10.0, 0.0, 0.0, 0.0], [0.0, 10.0, 10.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    information = Information(rows)
    null = np.array([[0.0], [1.0], [-1.0], [0.0]]) / np.sqrt(2)
    assert judge_parameters(information, null) == ("identifiable", "not", "not", "weak")
