"""The one density of machines on legs against brute force: differences of forward kinematics, scipy's normal densities.

Poses are given their commanded actuators, so that constants agree too. What is left is of second order about the best
pose: where model errors move poses far up to 0.02 nats of all poses together.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import telescope_machines as machines
from exact_problems import REST, list_matrix_terms
from frozen_densities import ROOT
from scipy.stats import multivariate_normal
from shares import run_rest

from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.pose_kernels import WAVE
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.readings.inputs import read_inputs
from bayescal.machines.deformations import MatrixDeformation
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.machines.models import MODELS
from bayescal.numerics.geometry import compute_pose_error

PUSHED = [name for name, model in MODELS.items() if model.drive == "base"]
NOISE = 1.5e-3
TAU = np.array([0.5, 1.0, 2.0, 3.0, 5.0, 8.0]) * 1e-3
UNIT = np.array([1.0] * 3 + [1e3] * 3)  # mm and mrad keep covariances well scaled
SECOND_ORDER = 3e-3  # nats of all poses together
PARAMETER_SPREAD = 0.5
EYE = np.eye(6, dtype=bool)


def draw_setup(model, deformation, seed, n_poses=4, spread=PARAMETER_SPREAD):
    """Return a random machine, parameters far from nominal, and poses measured near those it predicts."""
    rng = np.random.default_rng(seed)
    machine = machines.build_machine(deformation, machines.build_random_mechanism(6, seed), model)
    theta = machine.layout.nominal + spread * machines.spread_of(machine.layout) * rng.uniform(
        -1, 1, machine.layout.size
    )
    actuators = machine.mechanism.initial_actuator_positions + rng.uniform(-1.5, 1.5, (n_poses, 6))
    error = rng.normal(0, 5e-3, (n_poses, 6)) / UNIT * np.array([1.0] * 3 + [10.0] * 3)
    return machine, theta, machines.place_poses(machine, theta, actuators, error), rng


def evaluate(machine, theta, poses, errors=None, zeta=None, noise=NOISE):
    """Return the log-density of all poses of one machine, each leg erring by `TAU` where nothing else is said."""
    if errors is None:
        errors = machines.let_err(0.01)
        zeta = errors.priors[0].standardise(TAU)
    likelihood = machines.measure(machine, poses, {}, errors, noise=noise).likelihood
    return likelihood.density(theta[None], errors, zeta[None])[0]


def differentiate_pose(machine, theta, actuators):
    """Return the pose by the actuators, shape (P, 6, N), by differences of forward kinematics."""
    centre = solve_forward_kinematics(machine, theta, actuators)

    def pose(x):
        moved = solve_forward_kinematics(machine, theta, actuators + x)
        return compute_pose_error(moved.position, moved.rotation, centre.position, centre.rotation)

    return machines.central_difference(pose, np.zeros(6), np.full(6, 1e-3))


def differentiate_by_matrix(machine, theta, actuators, entries):
    """Return the poses' derivatives by some entries (e,) of K, which stand row by row, shape (6 P, e)."""
    columns = []
    for k in entries:
        change = 1e-4 * np.eye(36)[k].reshape(6, 6)
        ends = [
            Machine(machine.mechanism, machine.model, MatrixDeformation(machine.deformation.matrix + one))
            for one in (change, -change)
        ]
        upper, lower = (solve_forward_kinematics(end, theta, actuators) for end in ends)
        moved = compute_pose_error(upper.position, upper.rotation, lower.position, lower.rotation)
        columns.append(moved.ravel() / 2e-4)
    return np.stack(columns, axis=1)


def differentiate_legs(machine, theta, actuators):
    """Return the pose by the actuators, shape (P, 6, N), without the deflections that they cause at other legs."""
    whole = differentiate_pose(machine, theta, actuators)
    if not machine.deformation.uses_matrix:
        return whole
    travel, legs = actuators - machine.mechanism.initial_actuator_positions, np.arange(6)
    causes = (legs + 1) % 6  # any other leg's actuator; the diagonal of K is a parameter
    by_entry = differentiate_by_matrix(machine, theta, actuators, 6 * legs + causes).reshape(-1, 6, 6)
    by_deflection = by_entry / travel[:, None, causes]
    return whole - by_deflection @ (machine.deformation.matrix * ~EYE)


def find_error(machine, theta, poses):
    """Return measured minus predicted poses, shape (P, 6)."""
    at = solve_forward_kinematics(machine, theta, poses.actuators)
    return compute_pose_error(poses.position, poses.rotation, at.position, at.rotation)


def reference_covariance(machine, theta, poses, noise=NOISE):
    """Return the covariance of each pose error, shape (P, 6, 6)."""
    own = differentiate_pose(machine, theta, poses.actuators) * np.broadcast_to(noise, (poses.n_poses, 1, 6))
    legs = differentiate_legs(machine, theta, poses.actuators) * TAU
    return poses.covariance + own @ np.swapaxes(own, 1, 2) + legs @ np.swapaxes(legs, 1, 2)


def log_normal(error, covariance):
    """Return the log-density of errors (6 P,) of one joint normal, by scipy."""
    unit = np.tile(UNIT, len(error) // 6)
    scaled = covariance * np.outer(unit, unit)
    return multivariate_normal(np.zeros(len(error)), scaled).logpdf(error * unit) + np.log(unit).sum()


def spread_out(blocks):
    """Return a block-diagonal matrix (6 P, 6 P) of blocks (P, 6, 6)."""
    n_poses = len(blocks)
    return np.einsum("pq,pij->piqj", np.eye(n_poses), blocks).reshape(6 * n_poses, 6 * n_poses)


@pytest.mark.parametrize("deformation", run_rest(["matrix", "linear"], 1))
@pytest.mark.parametrize("model", PUSHED)
def test_density_is_that_of_differences_of_forward_kinematics(model, deformation):
    machine, theta, poses, rng = draw_setup(model, deformation, 1)
    noise = NOISE * rng.uniform(0.5, 2.0, (4, 6))
    covariance = reference_covariance(machine, theta, poses, noise[:, None])
    expected = log_normal(find_error(machine, theta, poses).ravel(), spread_out(covariance))
    assert evaluate(machine, theta, poses, noise=noise) == pytest.approx(expected, abs=SECOND_ORDER)
    alike = log_normal(
        find_error(machine, theta, poses).ravel(), spread_out(reference_covariance(machine, theta, poses))
    )
    assert abs(alike - expected) > 0.1


@pytest.mark.parametrize("dependent", [False, True])
@pytest.mark.parametrize("model", run_rest(["six_pus", "stiffness"], 1))
def test_uncertain_deflections_are_those_of_another_matrix(model, dependent):
    """The covariance of all poses at once, with the poses' derivatives by every entry of K off its diagonal.

    Where errors of K depend on those of the poses, they are K = mix · (numbers of its own) + share · (pose errors).
    """
    machine, theta, poses, rng = draw_setup(model, "matrix", 3, spread=0.0)
    mix = rng.normal(0, 1e-3, (30, 30)) / 6
    share = dependent * rng.normal(0, 0.05, (4, 30, 6)) * np.array([1.0] * 3 + [200.0] * 3)
    with_poses = share @ poses.covariance
    covariance = mix @ mix.T + np.einsum("pqk,prk->qr", share, with_poses)
    terms = list_matrix_terms(machine, poses, covariance, with_poses)
    legs = machines.let_err(0.01)
    zeta = legs.priors[0].standardise(TAU)
    found = evaluate(machine, theta, poses, ErrorModel((*legs.terms, *terms)), zeta)
    by_entry = differentiate_by_matrix(machine, theta, poses.actuators, np.arange(36)[REST])
    error, alone = find_error(machine, theta, poses).ravel(), spread_out(reference_covariance(machine, theta, poses))
    # the error in the prediction is that of the known K, measured minus predicted has the opposite one
    both = by_entry @ np.concatenate(list(with_poses), axis=1)
    independent = alone + by_entry @ covariance @ by_entry.T
    expected = log_normal(error, independent - both - both.T)
    assert found == pytest.approx(expected, abs=SECOND_ORDER)
    assert abs(log_normal(error, alone) - expected) > 0.05
    assert dependent == (abs(log_normal(error, independent) - expected) > 0.05)


@pytest.mark.parametrize(("model", "deformation"), [("six_pus", "none"), ("stiffness", "matrix")])
def test_functions_of_the_pose_move_the_platform_as_legs_do(model, deformation):
    """The covariance of all poses at once: linear in all actuators and in the own one, by a scale and norm each."""
    machine, theta, poses, _ = draw_setup(model, deformation, 3)
    terms = machines.let_functions_err(machine, poses, ("linear", "positioning"))
    errors = ErrorModel((*machines.let_err(0.01).terms, *terms))
    sizes = [7e-3, 4e-3]
    zeta = np.append(
        errors.priors[0].standardise(TAU),
        [errors.priors[6].standardise(np.array([one]))[0] for one in sizes],
    )
    z = (poses.actuators - machine.mechanism.initial_actuator_positions) / terms[0].own.range
    every = z @ z.T / np.mean(np.sum(z**2, axis=1))
    wave = np.exp(-0.5 * ((z.T[:, :, None] - z.T[:, None, :]) / WAVE) ** 2)
    alone = (np.einsum("pj,qj->jpq", z, z) + WAVE**2 * wave) / (np.mean(z**2) + WAVE**2)
    moved = differentiate_legs(machine, theta, poses.actuators)
    kernel = sizes[0] ** 2 * every + sizes[1] ** 2 * alone
    function = np.einsum("pij,jpq,qkj->piqk", moved, kernel, moved).reshape(24, 24)
    rest, error = spread_out(reference_covariance(machine, theta, poses)), find_error(machine, theta, poses).ravel()
    expected = log_normal(error, rest + function)
    assert evaluate(machine, theta, poses, errors, zeta) == pytest.approx(expected, abs=0.02)
    assert abs(log_normal(error, rest) - expected) > 1.0


# --- what it was -----------------------------------------------------------------------------------------------------


@cache
def read_exact():
    """Return machines, unknowns of the errors and densities of shipped variants, by a code of its own for legs."""
    with np.load(ROOT / "tests" / "frozen" / "legs.npz") as found:
        return dict(found)


VARIANTS = {
    "telescope": ("six_pus/matrix", "stiffness/linear"),
    "m2_hexapod": ("six_ups/matrix",),
    "hexaglide": ("six_pus/linear",),
}


@pytest.mark.parametrize("study", VARIANTS)
def test_shipped_densities_are_what_they_were(study):
    path = ROOT / "experiments" / study / "study.toml"
    config = load(path)[1]
    names = VARIANTS[study]
    config = config.model_copy(update={"variants": [one for one in config.variants if one.name in names]})
    inputs, frozen = read_inputs(config, path.parent), read_exact()
    for name in names:
        posterior, at = inputs.variants[name].posterior().with_pose_guesses(), f"{study}/{name}"
        theta = np.tile(posterior.likelihood.layout.nominal, (8, 1))
        theta[:, frozen[f"{at}/free"]] += frozen[f"{at}/change"]
        zeta, exact = frozen[f"{at}/zeta"], frozen[f"{at}/exact"]
        whole = posterior.likelihood.whole.density(theta, posterior.errors, zeta) - exact
        close = 0.012 if study == "telescope" else 5e-4
        assert whole.std() < close
        assert np.abs(whole.mean()) < 4.0 * close
