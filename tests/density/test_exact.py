"""The standing contract of the two eliminations: legs' exact density is that of the general route, commanded actuators.

Nothing is free between them: constants agree too, so that evidences of the two routes may be compared. What is left is
the second order about the best pose, where model errors move poses far: up to 0.015 nats of all poses together, where
they are 60 µm on the telescope; 1e-4 otherwise. Errors that all poses have in common, such as that of a measured K, are
no part of either elimination: here K is known.

The exact density against brute force: differences of forward kinematics, and scipy's normal of all poses at once.
"""

from dataclasses import replace
from functools import cache

import frozen_densities as frozen
import numpy as np
import pytest
import telescope_machines as machines
from eliminated_legs import eliminate_legs, evaluate_legs
from scipy.stats import multivariate_normal

from bayescal.density.exact import CommonErrors, ExactDensity
from bayescal.density.functions import FunctionLikelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.experiments.frame.load import load
from bayescal.experiments.study.inputs import load_inputs
from bayescal.machines.deformations import MatrixDeformation
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.numerics.geometry import compute_pose_error
from bayescal.numerics.units import MICROMETRE

CLOSE = 0.02
DRAWS, FEW_DRAWS = 20, 5
MACHINES = [
    *(
        ("experiments/telescope/study.toml", f"{model}/{deformation}")
        for model in ("six_pus", "beam", "stiffness", "jacobian")
        for deformation in ("none", "linear", "matrix")
    ),
    *(("experiments/m2_hexapod/study.toml", f"six_ups/{deformation}") for deformation in ("none", "linear", "matrix")),
    *(("experiments/hexaglide/study.toml", f"six_pus/{deformation}") for deformation in ("none", "linear")),
]
FEW = [MACHINES[k] for k in (0, 4, 8, 11, 12, 16)]


@cache
def read(path):
    """Return the inputs of a study."""
    return load_inputs(load(frozen.ROOT / path)[1], (frozen.ROOT / path).parent)


def draw(path, name, n_draws):
    """Return a machine, its poses and actuator noise, and draws of the posterior: θ (B, D), τ (B, N)."""
    inputs = read(path)
    variant = inputs.variant(name)
    posterior, mode = inputs.posterior(variant, True), frozen.read_frozen()[f"{path}: {name}"]["mode"]
    factor = np.linalg.cholesky(-posterior.gradient(mode)[1])
    z = np.random.default_rng(28).standard_normal((len(mode), n_draws))
    y = np.concatenate([mode[None], mode + np.linalg.solve(factor.T, z).T])
    noise = inputs.config.measured.actuator_noise_um * MICROMETRE
    tau = posterior.errors.tau(posterior.zeta(y))
    return inputs.machine(variant), inputs.poses(verification=False), noise, posterior.theta(y), tau


def compare(machine, poses, noise, theta, tau):
    """Return the general density minus the exact one, (B,)."""
    exact = ExactDensity(PoseLikelihood(machine, poses, noise), noise)
    general = evaluate_legs(eliminate_legs(machine, poses, noise, theta[0]), theta, tau)
    return general.sum(axis=1) - exact(theta, tau)


@pytest.mark.parametrize(("path", "name"), FEW)
def test_the_general_density_is_that_of_legs(path, name):
    assert np.abs(compare(*draw(path, name, FEW_DRAWS))).max() < CLOSE


@pytest.mark.slow
@pytest.mark.parametrize(("path", "name"), MACHINES)
def test_the_general_density_is_that_of_legs_for_all_machines(path, name):
    difference = compare(*draw(path, name, DRAWS))
    assert np.abs(difference).max() < CLOSE
    if "telescope" not in path or "jacobian/none" in name or "jacobian/linear" in name:
        assert np.abs(difference).max() < 1e-3


def test_the_measure_of_the_pose_matters():
    """Without commanded actuators the two differ by what varies from machine to machine."""
    machine, poses, noise, theta, tau = draw("experiments/telescope/study.toml", "six_pus/linear", FEW_DRAWS)
    exact = ExactDensity(PoseLikelihood(machine, poses, noise), noise)
    general = eliminate_legs(machine, poses, noise, theta[0])
    flat = replace(general, data=replace(general.data, commanded=None))
    difference = evaluate_legs(flat, theta, tau).sum(axis=1) - exact(theta, tau)
    assert np.ptp(difference) > 5 * CLOSE


MODELS = ("six_pus", "jacobian", "beam", "stiffness")
NOISE = 1.5e-3
TAU = np.array([0.5, 1.0, 2.0, 3.0, 5.0, 8.0]) * 1e-3
UNIT = np.array([1.0] * 3 + [1e3] * 3)  # mm and mrad keep covariances well scaled
PARAMETER_SPREAD = 0.5
SLOW_CASE = pytest.param("stiffness", "matrix", marks=pytest.mark.slow)


def draw_setup(model, deformation, seed, n_poses=4):
    """Return a random machine, parameters far from nominal, and poses measured near those it predicts."""
    rng = np.random.default_rng(seed)
    machine = machines.build_machine(deformation, machines.build_random_mechanism(6, seed), model)
    spread = PARAMETER_SPREAD * machines.spread_of(machine.layout)
    theta = machine.layout.nominal + spread * rng.uniform(-1, 1, machine.layout.size)
    home = machine.mechanism.initial_actuator_positions
    actuators = home + rng.uniform(-1.5, 1.5, (n_poses, 6))
    error = rng.normal(0, 5e-3, (n_poses, 6)) / UNIT * np.array([1.0] * 3 + [10.0] * 3)
    return machine, theta, machines.place_poses(machine, theta, actuators, error), rng


def differentiate_pose(machine, theta, actuators):
    """Return the pose by the actuators, shape (P, 6, N), by differences of forward kinematics."""
    centre = solve_forward_kinematics(machine, theta, actuators)

    def pose(x):
        moved = solve_forward_kinematics(machine, theta, actuators + x)
        return compute_pose_error(moved.position, moved.rotation, centre.position, centre.rotation)

    return machines.central_difference(pose, np.zeros(6), np.full(6, 1e-3))


def differentiate_legs(machine, theta, actuators):
    """Return the pose by the actuators, shape (P, 6, N), without the deflections that they cause at other legs."""
    whole = differentiate_pose(machine, theta, actuators)
    if not machine.deformation.uses_matrix:
        return whole
    others = machine.deformation.matrix * ~np.eye(6, dtype=bool)
    by_entry = differentiate_by_matrix(machine, theta, actuators).reshape(-1, 6, 6, 6)
    travel = actuators - machine.mechanism.initial_actuator_positions
    legs = np.arange(6)
    causes = (legs + 1) % 6  # any other leg's actuator; the diagonal of K is a parameter
    by_deflection = by_entry[..., legs, causes] / travel[:, None, causes]
    return whole - by_deflection @ others


def find_error(machine, theta, poses):
    """Return measured minus predicted poses, shape (P, 6)."""
    at = solve_forward_kinematics(machine, theta, poses.actuators)
    return compute_pose_error(poses.position, poses.rotation, at.position, at.rotation)


def reference_covariance(machine, theta, poses, variance=0.0):
    """Return the covariance of each pose error, shape (P, 6, 6)."""
    noise = NOISE * differentiate_pose(machine, theta, poses.actuators)
    legs = differentiate_legs(machine, theta, poses.actuators) * np.sqrt(TAU**2 + variance)[..., None, :]
    return poses.covariance + noise @ np.swapaxes(noise, 1, 2) + legs @ np.swapaxes(legs, 1, 2)


def log_normal(error, covariance):
    """Return the log-density of errors (6 P,) of one joint normal, by scipy."""
    unit = np.tile(UNIT, len(error) // 6)
    scaled = covariance * np.outer(unit, unit)
    return multivariate_normal(np.zeros(len(error)), scaled).logpdf(error * unit) + np.log(unit).sum()


def spread_out(blocks):
    """Return a block-diagonal matrix (6 P, 6 P) of blocks (P, 6, 6)."""
    n_poses = len(blocks)
    return np.einsum("pq,pij->piqj", np.eye(n_poses), blocks).reshape(6 * n_poses, 6 * n_poses)


@pytest.mark.runs
@pytest.mark.parametrize("deformation", ["none", "linear", "matrix"])
@pytest.mark.parametrize("model", MODELS)
def test_density_is_that_of_differences_of_forward_kinematics(model, deformation):
    for seed in (1, 2):
        machine, theta, poses, rng = draw_setup(model, deformation, seed)
        variance = rng.uniform(0, 4e-6, (4, 6))
        likelihood = PoseLikelihood(machine, poses, NOISE, variance)
        found = ExactDensity(likelihood, NOISE, actuator_variance=variance)(theta[None], TAU)[0]
        covariance = reference_covariance(machine, theta, poses, variance)
        expected = log_normal(find_error(machine, theta, poses).ravel(), spread_out(covariance))
        assert found == pytest.approx(expected, abs=2e-5)
        # what is corrected: the density of the hot path has C_n of another machine
        assert abs(likelihood(theta[None], TAU)[0] - expected) > 1e-3


def change_matrix(machine, change):
    """Return the machine with another K, its diagonal as it was."""
    return Machine(machine.mechanism, machine.model, MatrixDeformation(machine.deformation.matrix + change))


@pytest.mark.runs
@pytest.mark.parametrize("dependent", [False, True])
@pytest.mark.parametrize("model", MODELS)
def test_common_errors_are_those_of_another_matrix(model, dependent):
    """The covariance of all poses at once, with the poses' derivatives by every entry of K off its diagonal.

    Where errors of K depend on those of the poses, they are K = mix · (numbers of its own) + share · (pose errors).
    """
    machine, theta, poses, rng = draw_setup(model, "matrix", 3)
    rest = np.flatnonzero(~np.eye(6, dtype=bool))
    mix = rng.normal(0, 1e-3, (30, 30)) / 6
    share = dependent * rng.normal(0, 0.05, (4, 30, 6)) * np.array([1.0] * 3 + [200.0] * 3)
    with_poses = share @ poses.covariance
    covariance = mix @ mix.T + np.einsum("pqk,prk->qr", share, with_poses)
    displacement = poses.actuators - machine.mechanism.initial_actuator_positions
    design = np.einsum("ij,pk->pijk", np.eye(6), displacement).reshape(4, 6, 36)[..., rest]
    common = CommonErrors(design, covariance, with_poses if dependent else None)
    likelihood = PoseLikelihood(machine, poses, NOISE, common.variance)
    found = ExactDensity(likelihood, NOISE, common)(theta[None], TAU)[0]
    by_entry = differentiate_by_matrix(machine, theta, poses.actuators)[:, rest]
    error, alone = find_error(machine, theta, poses).ravel(), spread_out(reference_covariance(machine, theta, poses))
    # the error in the prediction is that of the known K, measured minus predicted has the opposite one
    both = by_entry @ np.concatenate(list(with_poses), axis=1)
    independent = alone + by_entry @ covariance @ by_entry.T
    expected = log_normal(error, independent - both - both.T)
    assert found == pytest.approx(expected, abs=5e-5)
    assert abs(log_normal(error, alone) - expected) > 0.05
    assert dependent == (abs(log_normal(error, independent) - expected) > 0.05)


def differentiate_by_matrix(machine, theta, actuators):
    """Return the poses' derivatives by the entries of K, row by row, shape (6 P, N * N)."""
    columns = []
    for k in range(36):
        change = 1e-4 * np.eye(36)[k].reshape(6, 6)
        ends = [change_matrix(machine, sign * change) for sign in (1, -1)]
        upper, lower = (solve_forward_kinematics(end, theta, actuators) for end in ends)
        moved = compute_pose_error(upper.position, upper.rotation, lower.position, lower.rotation)
        columns.append(moved.ravel() / 2e-4)
    return np.stack(columns, axis=1)


@pytest.mark.parametrize(("model", "deformation"), [("six_pus", "none"), SLOW_CASE])
def test_functions_of_several_sorts(model, deformation):
    """The covariance of all poses at once: linear in all actuators and in the own one, by a scale and norm each."""
    machine, theta, poses, _ = draw_setup(model, deformation, 3)
    travel = 1.3
    z = (poses.actuators - machine.mechanism.initial_actuator_positions) / travel
    likelihood = PoseLikelihood(machine, poses, NOISE)
    functions = FunctionLikelihood(likelihood, ("linear", "own"), travel, {})
    errors = np.append(TAU, [7e-3, 4e-3])
    legs = differentiate_legs(machine, theta, poses.actuators)
    every = z @ z.T / np.mean(np.sum(z**2, axis=1))
    own = np.einsum("pj,qj->jpq", z, z) / np.mean(z**2)
    kernel = 7e-3**2 * every + 4e-3**2 * own
    function = np.einsum("pij,jpq,qkj->piqk", legs, kernel, legs).reshape(24, 24)
    alone = spread_out(reference_covariance(machine, theta, poses))
    error = find_error(machine, theta, poses).ravel()
    expected = log_normal(error, alone + function)
    exact = ExactDensity(likelihood, NOISE, functions=functions)
    # what is common adds to the covariance, whatever else does
    common = CommonErrors(np.random.default_rng(7).normal(0, 1, (4, 6, 2)), 1e-6 * np.array([[2.0, 0.5], [0.5, 1.0]]))
    both = ExactDensity(likelihood, NOISE, common, functions=functions)
    none = both(theta[None], np.append(TAU, [0.0, 0.0]))[0]
    assert none == pytest.approx(ExactDensity(likelihood, NOISE, common)(theta[None], TAU)[0], abs=1e-9)
    assert abs(both(theta[None], errors)[0] - exact(theta[None], errors)[0]) > 1e-3
    assert exact(theta[None], errors)[0] == pytest.approx(expected, abs=1e-4)
    assert abs(log_normal(error, alone) - expected) > 1.0
    several = exact(np.tile(theta, (3, 1)), np.array([errors, 0.5 * errors, errors]))
    assert several[[0, 2]] == pytest.approx(np.full(2, expected), abs=1e-4)
    assert abs(several[1] - expected) > 1e-3


def test_redundant_legs_keep_the_density_of_the_hot_path():
    """Eight legs: at the nominal machine, where C_n is frozen, both densities are the same."""
    mechanism = machines.build_random_mechanism(8, 5)
    machine = machines.build_machine("linear", mechanism)
    nominal, rng = machine.layout.nominal, np.random.default_rng(8)
    actuators = mechanism.initial_actuator_positions + rng.uniform(-1, 1, (5, 1))
    poses = machines.place_poses(machine, nominal, actuators, rng.normal(0, 5e-3, (5, 6)) / UNIT)
    likelihood, tau = PoseLikelihood(machine, poses, NOISE), np.full(8, 2e-3)
    exact = ExactDensity(likelihood, NOISE)
    assert exact(nominal[None], tau)[0] == pytest.approx(likelihood(nominal[None], tau)[0], abs=1e-3)
    moved = nominal + 0.3 * machines.spread_of(machine.layout) * rng.uniform(-1, 1, (3, len(nominal)))
    assert not np.allclose(exact(moved, tau), likelihood(moved, tau), atol=1e-3)


def test_what_is_no_machine_has_no_density():
    machine, theta, poses, _ = draw_setup("six_pus", "none", 4)
    exact = ExactDensity(PoseLikelihood(machine, poses, NOISE), NOISE)
    bad = np.stack([theta, theta])
    bad[1, machine.layout.index["u_x"]] = 1.5
    found = exact(bad, TAU)
    assert np.isfinite(found[0])
    assert found[1] == -np.inf


def test_batches_change_nothing():
    """Near the data: where one machine of a batch needs another Newton step, all others take it, too."""
    machine, theta, poses, rng = draw_setup("stiffness", "linear", 6)
    exact = ExactDensity(PoseLikelihood(machine, poses, NOISE), NOISE)
    many = theta + 1e-3 * machines.spread_of(machine.layout) * rng.uniform(-1, 1, (19, len(theta)))
    taus = np.abs(rng.normal(0, 3e-3, (19, 6)))
    one_by_one = [exact(row[None], tau)[0] for row, tau in zip(many, taus, strict=True)]
    np.testing.assert_allclose(exact(many, taus), one_by_one, rtol=1e-10)
