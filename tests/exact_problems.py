"""Calibrations with data of the exact density: simulated machines of the prior, and posteriors as a study leaves them.

Noise moves the actuators, model errors each leg by itself, and the deformation matrix is known with an error that all
poses share. The simulation goes through forward kinematics and the closure at the true machine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import telescope_machines as machines

from bayescal.density.errors import ModelError
from bayescal.density.exact import CommonErrors, ExactDensity
from bayescal.density.legs import LegPosterior, build_leg_posterior
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import NormalPrior
from bayescal.experiments.study.fit import build_costly
from bayescal.inference.correction import correct_evidence
from bayescal.inference.exploration import explore
from bayescal.inference.importance import resample
from bayescal.machines.deformations import MatrixDeformation
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.numerics.geometry import matrix_from_rotation_vector

SCALE = 0.01
MATRIX_SD = 1.5e-4  # of the entries of K off its diagonal
N_DRAWS, N_KEPT = 2000, 600


@dataclass(frozen=True, eq=False)
class Problem:
    """A simulated calibration: what was true, the posterior of the hot path and the exact density."""

    theta: np.ndarray
    tau: np.ndarray
    posterior: LegPosterior
    exact: ExactDensity


def list_free(deformation, small=False):
    """Return the symbols of a small or of the usual free set."""
    usual = machines.FREE_SYMBOLS[deformation]
    return tuple(s for s in usual if s in ("l", "kappa", "u_x")) if small else usual


def common_errors(machine, actuators):
    """Return what all poses share of an uncertain K."""
    n_legs = machine.mechanism.n_legs
    rest = np.flatnonzero(~np.eye(n_legs, dtype=bool))
    displacement = actuators - machine.mechanism.initial_actuator_positions
    design = np.einsum("ij,pk->pijk", np.eye(n_legs), displacement).reshape(*displacement.shape, -1)[..., rest]
    return CommonErrors(design, MATRIX_SD**2 * np.eye(len(rest)))


def draw_problem(model, deformation, symbols, rng, n_poses=40):
    """Return a calibration whose truth is drawn from the prior."""
    machine = machines.build_machine(deformation, model=model)
    layout, actuators = machine.layout, machines.table_3_actuators()[:n_poses]
    theta, priors = layout.nominal.copy(), {}
    for symbol in symbols:
        index, sd = layout.index[symbol], machines.PRIOR_SD.get(symbol, 2.0)
        priors |= {layout.names[k]: NormalPrior(layout.nominal[k], sd) for k in index}
        theta[index] += sd * rng.standard_normal(len(index))
    tau = np.abs(SCALE * rng.standard_normal(6))
    common = common_errors(machine, actuators) if deformation == "matrix" else None
    poses = _simulate(machine, theta, actuators, tau, rng, common is not None)
    likelihood = PoseLikelihood(machine, poses, machines.ACTUATOR_NOISE, None if common is None else common.variance)
    exact = ExactDensity(likelihood, machines.ACTUATOR_NOISE, common)
    return Problem(theta, tau, build_leg_posterior(likelihood, priors, ModelError(SCALE)), exact)


def _simulate(machine, theta, actuators, tau, rng, with_matrix):
    """Return measured poses of a machine, of another K than the one that is known where ``with_matrix``."""
    true = machine
    if with_matrix:
        change = MATRIX_SD * rng.standard_normal((6, 6)) * ~np.eye(6, dtype=bool)
        true = Machine(machine.mechanism, machine.model, MatrixDeformation(machine.deformation.matrix + change))
    actual = actuators + machines.ACTUATOR_NOISE * rng.standard_normal(actuators.shape)
    at = solve_forward_kinematics(true, theta, actual)
    own = true.basis(actuators)
    own = replace(own, actuator_gain=own.actuator_gain * np.eye(6))  # a leg's error bends nothing at other legs
    here = true.model.linearise(true.layout, theta, at.position, at.rotation, own)
    legs = np.einsum("pij,pj->pi", here.actuators, tau * rng.standard_normal(actuators.shape))
    error = np.linalg.solve(here.pose, legs[..., None])[..., 0]
    covariance = machines.measurement_covariance(len(actuators))
    error += np.einsum("pij,pj->pi", np.linalg.cholesky(covariance), rng.standard_normal((len(actuators), 6)))
    exact = machines.place_poses(machine, theta, actuators, np.zeros((len(actuators), 6)))
    position, rotation = at.position + error[:, :3], matrix_from_rotation_vector(error[:, 3:]) @ at.rotation
    return type(exact)(exact.names, position, rotation, covariance, actuators)


def solve(problem, seed):
    """Return draws of the explored posterior and of the corrected one, in sampling coordinates, and the correction."""
    explore_seed, draw_seed, correct_seed = np.random.SeedSequence(seed).spawn(3)
    found = explore(problem.posterior, explore_seed)
    rng = np.random.default_rng(draw_seed)
    draws = resample(found.straight.log_density, found.proposal, rng, N_DRAWS, N_KEPT).draws
    correction = correct_evidence(build_costly(problem.exact, found), found, correct_seed)
    to_y = found.straight.y_from_x
    return to_y(draws), to_y(correction.move(draws)), correction


def measure(problem, y):
    """Return quantities of draws (B, n): the parameters in their units, the model errors and Σ τ²."""
    natural = problem.posterior.natural(y)
    return np.column_stack([natural, np.sum(problem.posterior.errors.tau(problem.posterior.zeta(y)) ** 2, axis=-1)])


def measure_truth(problem):
    """Return the same of the truth."""
    free = problem.theta[problem.posterior.sampling.free]
    return np.concatenate([free, problem.tau, [np.sum(problem.tau**2)]])
