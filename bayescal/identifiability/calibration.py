"""Simulated calibrations: whether the accuracy that an audit predicts is the one that calibrations reach.

Machines are drawn from the priors, measured to the plan with all noise, and identified one by one; the errors of what
was identified are then set against the predicted posterior standard deviations. The audit's are those of the machine
linearised where it is expected. Averaged over machines drawn from the priors they are what a calibration can expect,
where the derivatives change within the tolerances.

Where only some parameters are identified the machines are off in the others all the same, which the calibration takes
for nominal: a simulation whose machines were nominal there would certify what it assumes. Whether calibrated machines
keep what is required as often as is claimed is found by moving each: it is sent to every pose of the workspace, and
where it truly comes to stand, actuators erring, is set against what the calibrated model predicts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.errors import InputError
from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.fits import Fitter, Measurements
from bayescal.identifiability.sensitivity import (
    compute_measured_poses,
    root_of,
)
from bayescal.limits import NINETY
from bayescal.machines.frames import N_FRAME_PARAMETERS, move_frames
from bayescal.machines.kinematics import solve_forward_kinematics, solve_inverse_kinematics
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, compute_pose_error, matrix_from_rotation_vector

ROUNDS = 20
LIMITS = (1.0, 1.96)  # standard deviations
RANK = 1e-12  # of a scaled information, below which a coordinate is not measured
CHUNK = 25  # machines at once
BAND = 0.99


@dataclass(frozen=True, eq=False)
class Calibrations:
    """Simulated calibrations of B machines that were drawn from the priors, B' of which converged.

    Attributes
    ----------
    names : tuple of str
        Of the m parameters that were identified.
    errors, claimed : ndarray, shape (B', m)
        Estimate minus truth, and standard deviations that each calibration claims, linearised at its estimate, in units
        of the tolerances.
    converged : ndarray of bool, shape (B,)
    n_redrawn : int
        Draws that were no machine or could not take every planned pose, and were drawn again.
    """

    names: tuple[str, ...]
    errors: Array
    claimed: Array
    converged: np.ndarray
    n_redrawn: int


@dataclass(frozen=True, eq=False)
class SimulatedCalibrations(Calibrations):
    """Calibrations of machines with legs.

    Attributes
    ----------
    knowledge : Knowledge
    truth, estimate : ndarray, shape (B', D)
        Machines and frames, mm, rad, or the parameter's unit.
    """

    knowledge: Knowledge
    truth: Array
    estimate: Array

    def pose_errors(self, actuators: Array) -> Array:
        """Return true less predicted poses of the converged ones at actuator positions (W, N), shape (B', W, 6).

        As the instrument sees them, mm and rad; NaN where one of both machines has no pose.
        """
        errors = np.empty((len(self.truth), len(actuators), DEGREES_OF_FREEDOM))
        for k in range(0, len(errors), CHUNK):
            here, there = (
                compute_measured_poses(self.knowledge, theta[k : k + CHUNK], actuators)
                for theta in (self.truth, self.estimate)
            )
            errors[k : k + CHUNK] = compute_pose_error(*here, *there)
        return np.where(np.isnan(errors[..., :1]), np.nan, errors)


def simulate_calibrations(
    knowledge: Knowledge,
    plan: Plan,
    n: int,
    rng: np.random.Generator,
    fitted: Sequence[int] | None = None,
    prior_weight: float = 1.0,
) -> SimulatedCalibrations:
    """Return n calibrations of machines drawn from the priors, all parameters off by their tolerances.

    Parameters
    ----------
    knowledge : Knowledge
    plan : Plan
    n : int
    rng : Generator
    fitted : sequence of int, optional
        Which of the free parameters are identified, the others being taken for nominal; all by default.
    prior_weight : float
        On the precision of the priors in the identification.

    What the sensors tell of a pose is taken at the expected machine; a coordinate of which they tell nothing is not
    used. Actuators err by σ_ρ, and a leg's closure by τ times what a millimetre of its actuator does to it.

    Redundant legs close only at some actuator positions. Machines then stand where the planned positions bring them
    closest to closing, and their encoders read what holds them there; a plan that does not close for the expected
    machine is therefore not measured as it is planned.

    Raises
    ------
    InputError
        Where too few draws of the priors are machines that can take the planned poses.
    """
    fitter = Fitter(knowledge, plan)
    moves, measured, n_redrawn = _draw(fitter, n, rng)
    chosen = np.arange(len(knowledge.sd)) if fitted is None else np.array(fitted, dtype=int)
    weight = np.zeros_like(moves)
    weight[:, chosen] = prior_weight  # of no weight are those that stay at nominal
    fits = fitter.fit(measured, prior_weight=weight)
    good, places = fits.converged, knowledge.free[chosen]
    truth, estimate = fitter.theta(moves)[good], fitter.theta(fits.moves)[good]
    covariance = np.linalg.inv(fits.information[good][:, chosen[:, None], chosen] + prior_weight * np.eye(len(chosen)))
    with np.errstate(invalid="ignore"):  # without priors poses may determine too little
        claimed = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    errors = (estimate - truth)[:, places] / knowledge.sd[chosen]
    names = tuple(knowledge.names[k] for k in chosen)
    return SimulatedCalibrations(names, errors, claimed, good, n_redrawn, knowledge, truth, estimate)


def simulate_measurements(fitter: Fitter, moves: Array, rng: np.random.Generator) -> tuple[Measurements, np.ndarray]:
    """Return the measured poses of machines (B, n), and which machines can take all poses, shape (B,)."""
    theta = fitter.theta(moves)
    good = fitter.knowledge.layout.inside(theta)
    machine_theta = np.where(good[:, None], theta, fitter.knowledge.centre)[:, None, :-N_FRAME_PARAMETERS]
    machine, planned = fitter.knowledge.machine, fitter.plan.actuators
    error = _actuator_errors(fitter, len(moves), rng)
    if not fitter.redundant:
        found = solve_forward_kinematics(machine, machine_theta, planned + error, check=False)
        actuators, reached = np.broadcast_to(planned, error.shape), found.converged
    else:  # redundant legs must close: encoders err, not the legs
        found = solve_forward_kinematics(machine, machine_theta, planned, check=False)
        position = np.where(found.converged[..., None], found.position, fitter.expected.poses.position)
        held = solve_inverse_kinematics(machine, machine_theta, position, found.rotation, check=False)
        actuators, reached = held.actuators - error, found.converged & held.converged
    position, rotation = move_frames(theta[:, -N_FRAME_PARAMETERS:], found.position, found.rotation)
    noise = np.einsum(
        "pij,bpj->bpi", _sensor_noise(fitter.seen), rng.standard_normal((*error.shape[:-1], DEGREES_OF_FREEDOM))
    )
    position, rotation = position + noise[..., :3], matrix_from_rotation_vector(noise[..., 3:]) @ rotation
    return Measurements(position, rotation, actuators), good & reached.all(axis=1)


def _draw(fitter: Fitter, n: int, rng: np.random.Generator) -> tuple[Array, Measurements, int]:
    """Return n machines of the priors as moves with their measured poses, and how many were drawn anew."""
    moves = rng.standard_normal((n, len(fitter.knowledge.sd)))
    measured, good = simulate_measurements(fitter, moves, rng)
    actuators = np.array(measured.actuators)
    n_redrawn = 0
    for _ in range(ROUNDS):
        bad = np.flatnonzero(~good)
        if not len(bad):
            return moves, Measurements(measured.position, measured.rotation, actuators), n_redrawn
        n_redrawn += len(bad)
        moves[bad] = rng.standard_normal((len(bad), moves.shape[1]))
        again, good[bad] = simulate_measurements(fitter, moves[bad], rng)
        measured.position[bad], measured.rotation[bad], actuators[bad] = again.position, again.rotation, again.actuators
    raise InputError(
        f"tolerances: found {np.sum(~good)} of {n} machines that cannot take the planned poses after {ROUNDS} draws, "
        "expected smaller tolerances or poses closer to home"
    )


def _actuator_errors(fitter: Fitter, n: int, rng: np.random.Generator) -> Array:
    """Return what actuators, and the model in terms of actuators, err by, shape (n, P, N), mm."""
    plan, by_actuators = fitter.plan, fitter.expected.by_actuators
    own = np.diagonal(by_actuators, axis1=-2, axis2=-1)
    shape = (n, *plan.actuators.shape)
    model = np.linalg.solve(by_actuators, (own * rng.standard_normal(shape))[..., None])[..., 0]
    return plan.actuator_noise * rng.standard_normal(shape) + plan.model_error * model


def _sensor_noise(seen: Array) -> Array:
    """Return roots of the covariances that belong to information (P, 6, 6); zero for what is not measured."""
    scale = np.sqrt(np.diagonal(seen, axis1=-2, axis2=-1))
    scale = np.where(scale > 0.0, scale, 1.0)[..., None]  # mm and rad side by side
    covariance = np.linalg.pinv(seen / scale / np.swapaxes(scale, -1, -2), rcond=RANK, hermitian=True)
    return np.swapaxes(root_of(covariance / scale / np.swapaxes(scale, -1, -2)), -1, -2)


# --- prediction against what happened ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Comparison:
    """Predicted posterior standard deviations against the errors of calibrations.

    Attributes
    ----------
    names : tuple of str
    predicted, found : ndarray, shape (n,)
        Posterior standard deviation and root mean square error, in units of the tolerances.
    ratio, ratio_error : ndarray, shape (n,)
        Found by predicted, and its standard error with the errors' own kurtosis.
    coverage : dict of float to ndarray, shape (n,)
        Share of the errors within so many predicted standard deviations; 0.683 and 0.95 were they normal.
    chi_square : float
        Mean squared length of the errors in the metric of the predicted covariance, by n: one where all is as
        predicted.
    chi_square_error : float
        Its standard error.
    claimed : ndarray, shape (n,)
        Root mean square of the standard deviations that the calibrations claim, in units of the tolerances.
    covered : ndarray, shape (n,)
        Share of the calibrations whose 90 % interval holds the truth.
    z : ndarray, shape (n,)
        Root mean square error in units of what each calibration claims: one where the claims are true.
    """

    names: tuple[str, ...]
    predicted: Array
    found: Array
    ratio: Array
    ratio_error: Array
    coverage: dict[float, Array]
    chi_square: float
    chi_square_error: float
    claimed: Array
    covered: Array
    z: Array

    def by_symbol(self) -> dict[str, float]:
        """Return the ratio of root mean squares over all parameters of a symbol."""
        symbols = np.array([name.partition("[")[0] for name in self.names])
        result = {}
        for symbol in dict.fromkeys(symbols.tolist()):
            part = symbols == symbol
            result[symbol] = float(np.sqrt(np.sum(self.found[part] ** 2) / np.sum(self.predicted[part] ** 2)))
        return result


def compare_with_prediction(simulated: Calibrations, covariance: Array) -> Comparison:
    """Return how calibrations' errors compare with a predicted posterior covariance.

    Parameters
    ----------
    simulated : Calibrations
    covariance : ndarray, shape (m, m)
        Of the errors of the identified parameters in units of the tolerances: `Information.covariance`, or a part of
        `Information.errors_of_reduced`.

    Raises
    ------
    InputError
        Where fewer than two calibrations converged.
    """
    errors = simulated.errors
    if len(errors) < 2:
        raise InputError(f"calibrations: found {len(errors)} that converged, expected two at least")
    predicted = np.sqrt(np.diagonal(covariance))
    square = np.mean(errors**2, axis=0)
    kurtosis = np.mean(errors**4, axis=0) / square**2
    ratio = np.sqrt(square) / predicted
    z, own = errors / predicted, errors / simulated.claimed
    variances, axes = np.linalg.eigh(covariance)
    lengths = ((errors @ axes) ** 2 / variances).mean(axis=1)
    return Comparison(
        simulated.names,
        predicted,
        np.sqrt(square),
        ratio,
        ratio * np.sqrt(np.maximum(kurtosis - 1.0, 0.0) / (4.0 * len(errors))),
        {limit: np.mean(np.abs(z) < limit, axis=0) for limit in LIMITS},
        float(lengths.mean()),
        float(lengths.std(ddof=1) / np.sqrt(len(lengths))),
        np.sqrt(np.mean(simulated.claimed**2, axis=0)),
        np.mean(np.abs(own) < NINETY, axis=0),
        np.sqrt(np.mean(own**2, axis=0)),
    )


# --- requirements kept ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Kept:
    """How many of n calibrated machines kept a requirement in the whole workspace.

    Attributes
    ----------
    kept, n : int
    low, high : int
        Between which the number lies with a probability of 99 %, if the claimed probability is right.
    """

    kept: int
    n: int
    low: int
    high: int

    @property
    def agrees(self) -> bool:
        """Whether the number is one to expect."""
        return self.low <= self.kept <= self.high


def compare_kept(kept: int, n: int, probability: float, draws: int) -> Kept:
    """Return the number of machines that kept a requirement beside what a claimed probability lets expect.

    The probability was itself counted, in so many draws; its uncertainty widens the band.
    """
    from scipy.stats import betabinom  # half a second to import

    good = probability * draws
    low, high = betabinom.interval(BAND, n, good + 0.5, draws - good + 0.5)
    return Kept(kept, n, int(low), int(high))
