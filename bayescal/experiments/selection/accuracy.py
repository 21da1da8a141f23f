"""What calibrations with a set of poses achieve: pose errors over the workspace, predicted and simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.errors import InputError
from bayescal.experiments.shared.design import Design
from bayescal.identifiability.calibration import simulate_measurements
from bayescal.identifiability.design import Knowledge
from bayescal.identifiability.fits import Fitter, Measurements
from bayescal.identifiability.information import information_of_rows
from bayescal.identifiability.sensitivity import Sensitivity, compute_sensitivity
from bayescal.machines.frames import N_FRAME_PARAMETERS
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import Array, compute_pose_error

ROUNDS = 20
UNKNOWN = 1e-8  # weight of the tolerances where the identification does not know them
CHUNK = 50


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Pose errors over the workspace after calibrations with one set of poses.

    Attributes
    ----------
    predicted : ndarray, shape (3,)
        Root mean square over the workspace's poses to first order: of the position's length, mm, of the rotation's,
        rad, and of all components in units of their limits.
    simulated : ndarray, shape (B, 3)
        The same of each machine that was drawn, measured and identified, by the machine itself.
    positions : ndarray, shape (B,)
        Mean over the workspace of the position error, mm.
    parameters : ndarray, shape (B,)
        Root mean square error of the parameters in units of the tolerances.
    n_failed : int
        Calibrations that did not converge; they count in nothing else.
    """

    predicted: Array
    simulated: Array
    positions: Array
    parameters: Array
    n_failed: int


def judge_poses(
    inputs: Design,
    workspace: Sensitivity,
    limits: Array,
    actuators: Array,
    n_machines: int,
    rng: np.random.Generator,
    known: bool = True,
) -> Accuracy:
    """Return what calibrations with poses at actuator positions (n, N) achieve.

    Parameters
    ----------
    inputs : Design
        Machine, tolerances, sensors and noise.
    workspace : Sensitivity
        Derivatives at the poses where accuracy counts, those of ``inputs.workspace_actuators``.
    limits : ndarray, shape (6,)
        What errors of a pose are measured by, mm and rad.
    actuators : ndarray, shape (n, N)
    n_machines : int
        How many machines are drawn within the tolerances; the same ones for the same generator.
    rng : Generator
    known : bool
        Whether the identification knows the tolerances, or is least squares weighted by the noise.
    """
    knowledge = inputs.knowledge
    plan = replace(inputs.plan, actuators=actuators)
    weight = 1.0 if known else UNKNOWN
    covariance = _error_covariance(knowledge, compute_sensitivity(knowledge, actuators).rows(plan), weight)
    predicted = _summarise_predicted(workspace.slope * knowledge.sd, covariance, limits)
    fitter = Fitter(knowledge, plan)
    moves, measured = _draw(fitter, n_machines, rng)
    fits = fitter.fit(measured, prior_weight=np.full(moves.shape, weight))
    errors = _pose_errors(inputs, fitter.theta(moves), fitter.theta(fits.moves))
    good = fits.converged & np.isfinite(errors).all(axis=(1, 2))
    if not good.any():
        raise InputError(f"calibrations: found none of {n_machines} that converged, expected more poses or tolerances")
    errors, wrong = errors[good], (fits.moves - moves)[good]
    length = np.linalg.norm(errors[..., :3], axis=-1)
    return Accuracy(
        predicted,
        np.stack(
            [
                np.sqrt(np.mean(length**2, axis=1)),
                np.sqrt(np.mean(np.sum(errors[..., 3:] ** 2, axis=-1), axis=1)),
                np.sqrt(np.mean(np.sum((errors / limits) ** 2, axis=-1), axis=1)),
            ],
            axis=1,
        ),
        length.mean(axis=1),
        np.sqrt(np.mean(wrong**2, axis=1)),
        int(n_machines - good.sum()),
    )


def _error_covariance(knowledge: Knowledge, rows: Array, weight: float) -> Array:
    """Return the covariance of the errors of an identification, its prior weighted, in units of the tolerances.

    With K = (w + Λ)⁻¹ they are K Rᵀ ε - w K z, and of covariance K (Λ + w²) K; (1 + Λ)⁻¹ for w = 1.
    """
    values, vectors = information_of_rows(rows, knowledge.sd).spectrum()
    result: Array = (vectors * ((values + weight**2) / (values + weight) ** 2)) @ vectors.T
    return result


def _summarise_predicted(slope: Array, covariance: Array, limits: Array) -> Array:
    variance = np.einsum("wij,jk,wik->wi", slope, covariance, slope, optimize=True).mean(axis=0)
    parts = [variance[:3].sum(), variance[3:].sum(), (variance / limits**2).sum()]
    return np.sqrt(np.array(parts))


def _draw(fitter: Fitter, n: int, rng: np.random.Generator) -> tuple[Array, Measurements]:
    """Return n machines within the tolerances that can take the poses, and their measured poses."""
    moves = rng.standard_normal((n, len(fitter.knowledge.sd)))
    measured, good = simulate_measurements(fitter, moves, rng)
    position, rotation, actuators = (np.array(x) for x in (measured.position, measured.rotation, measured.actuators))
    for _ in range(ROUNDS):
        bad = np.flatnonzero(~good)
        if not len(bad):
            return moves, Measurements(position, rotation, actuators)
        moves[bad] = rng.standard_normal((len(bad), moves.shape[1]))
        again, good[bad] = simulate_measurements(fitter, moves[bad], rng)
        position[bad], rotation[bad], actuators[bad] = again.position, again.rotation, again.actuators
    raise InputError(
        f"tolerances: found {int(np.sum(~good))} of {n} machines that cannot take the poses after {ROUNDS} draws, "
        "expected smaller tolerances"
    )


def _pose_errors(inputs: Design, truth: Array, estimate: Array) -> Array:
    """Return the errors of predicted poses over the workspace, shape (B, W, 6), NaN where one machine has none."""
    machine, actuators = inputs.knowledge.machine, inputs.workspace_actuators
    parts = []
    for start in range(0, len(truth), CHUNK):
        found = [
            solve_forward_kinematics(
                machine, theta[start : start + CHUNK, None, :-N_FRAME_PARAMETERS], actuators, check=False
            )
            for theta in (truth, estimate)
        ]
        error = compute_pose_error(found[1].position, found[1].rotation, found[0].position, found[0].rotation)
        parts.append(np.where((found[0].converged & found[1].converged)[..., None], error, np.nan))
    return np.concatenate(parts)
