"""Calibrations of simulated machines of the prior, by the fast form of their density, and what corrects that.

Noise moves the actuators, model errors each leg by itself, and the deformation matrix is known with an error that all
poses share. The simulation goes through forward kinematics and the closure at the true machine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import telescope_machines as machines

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.terms import CorrelatedNoise, ErrorModel
from bayescal.experiments.shared.readings.pads import Pads
from bayescal.experiments.study.readings import weigh_beside
from bayescal.inference.correction import correct_evidence
from bayescal.inference.exploration import explore
from bayescal.inference.importance import resample
from bayescal.machines.deformations import MatrixDeformation
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import matrix_from_rotation_vector

SCALE = 0.01
MATRIX_SD = 1.5e-4  # of the entries of K off its diagonal
N_DRAWS, N_KEPT = 2000, 600
OFF_DIAGONAL = ~np.eye(6, dtype=bool)
REST = np.flatnonzero(OFF_DIAGONAL)


@dataclass(frozen=True, eq=False)
class Problem:
    """A simulated calibration: what was true, and the posterior about the machine that explains the readings."""

    theta: np.ndarray
    tau: np.ndarray
    posterior: CalibrationPosterior


def list_free(deformation, small=False):
    """Return the symbols of a small or of the usual free set."""
    usual = machines.FREE_SYMBOLS[deformation]
    return tuple(s for s in usual if s in ("l", "kappa", "u_x")) if small else usual


def list_matrix_terms(machine, poses, covariance, with_poses) -> tuple[CorrelatedNoise, ...]:
    """Return what errors of K off its diagonal do, of covariances (30, 30), and (P, 30, 6) with those of the poses."""
    whole, pairs = np.zeros((36, 36)), np.zeros((poses.n_poses, 36, 6))
    whole[np.ix_(REST, REST)], pairs[:, REST] = covariance, with_poses
    base = SimpleNamespace(base=SimpleNamespace(rotation=np.tile(np.eye(3), (poses.n_poses, 1, 1))))
    pads = Pads(None, SimpleNamespace(covariance=whole, with_pose=pairs), None, base)
    legs = Legs(machine)
    both, alone = pads.list_terms(legs, legs.names, poses, np.zeros(poses.n_poses, dtype=bool))
    return CorrelatedNoise(both), CorrelatedNoise(alone, -1.0)


def draw_problem(model, deformation, symbols, rng, n_poses=40, shared=False, matrix_sd=MATRIX_SD):
    """Return a calibration whose truth is drawn from the prior."""
    machine = machines.build_machine(deformation, model=model)
    layout, actuators = machine.layout, machines.table_3_actuators()[:n_poses]
    theta, priors = layout.nominal.copy(), machines.list_priors(machine, symbols)
    for name, prior in priors.items():
        theta[layout.names.index(name)] = prior.value(rng.standard_normal())
    tau = np.abs(SCALE * rng.standard_normal(6))
    poses = _simulate(machine, theta, actuators, tau, matrix_sd, rng)
    terms = machines.let_err(SCALE, shared).terms
    if deformation == "matrix":
        terms += list_matrix_terms(machine, poses, matrix_sd**2 * np.eye(30), np.zeros((n_poses, 30, 6)))
    return Problem(theta, tau, machines.measure(machine, poses, priors, ErrorModel(terms)).with_pose_guesses())


def _simulate(machine, theta, actuators, tau, matrix_sd, rng):
    """Return measured poses of a machine, of another K than the one that is known."""
    true = machine
    if machine.deformation.uses_matrix:
        change = matrix_sd * rng.standard_normal((6, 6)) * OFF_DIAGONAL
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
    correction = correct_evidence(weigh_beside(problem.posterior, found), found, correct_seed)
    to_y = found.straight.y_from_x
    return to_y(draws), to_y(correction.move(draws)), correction


def measure(problem, y):
    """Return quantities of draws (B, n): the parameters in their units, the model errors and Σ τ²."""
    natural = problem.posterior.natural(y)
    return np.column_stack([natural, np.sum(natural[:, problem.posterior.n_geometry :] ** 2, axis=-1)])


def measure_truth(problem):
    """Return the same of the truth."""
    free = problem.theta[problem.posterior.sampling.free]
    return np.concatenate([free, problem.tau, [np.sum(problem.tau**2)]])
