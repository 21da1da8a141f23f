"""What a calibrated machine does: poses of actuator positions, actuator positions of poses, and how sure both are.

By the closure F(pose, ρ; θ) = e of the legs, e their errors, a machine θ near the posterior mean θ̄ has its pose moved
by -F_x⁻¹ (F(θ) - e), and the actuators that hold a pose by -F_ρ⁻¹ (F(θ) - e), with F at what θ̄ has there. Where
draws of the posterior keep to the tangent, F_θ (θ - θ̄) stands for it: the mean is that of the machine θ̄, and the
covariance follows from that of θ. Along a bent ridge they do not: some draws are put into F as they are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.errors import InputError
from bayescal.machines.kinematics import ForwardKinematics, solve_forward_kinematics, solve_inverse_kinematics
from bayescal.machines.models.base import Linearisation
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector

SPREAD_DRAWS = 300
"""Draws that tell a covariance, its standard deviations to 4 %."""
SPREAD_POSES = 16  # at a time: scratch memory of these draws stays in the cache
LOOKS = 16  # poses of the workspace at which the closure is held against its tangent
BENT = 0.1  # of a standard deviation that draws may be off the tangent, root mean square
SLACK = 1e-6  # mm beyond an actuator's range, which digits of a table leave
CHUNK = 1024
"""Poses at a time: what they take of the memory stays small."""


@dataclass(frozen=True, eq=False)
class PosePrediction:
    """Poses of P actuator positions.

    Attributes
    ----------
    position, rotation : ndarray, shapes (P, 3) and (P, 3, 3)
        Platform frame in the base frame, mm: posterior mean. Without draws that of the mean machine.
    covariance : ndarray, shape (P, 6, 6), or None
        Of position (mm) and rotation vector (rad) about the base axes: geometry, errors of the legs and noise of the
        actuators. None where the posterior's covariance is not known.
    of_geometry : ndarray, shape (P, 6, 6), or None
        The part of the geometry alone.
    found : ndarray of bool, shape (P,)
        Whether the machine has a pose there.
    """

    position: Array
    rotation: Array
    covariance: Array | None
    of_geometry: Array | None
    found: np.ndarray


@dataclass(frozen=True, eq=False)
class Command:
    """Actuator positions of P poses.

    Attributes
    ----------
    actuators : ndarray, shape (P, N)
        Posterior mean, mm; NaN where a leg does not reach. Without draws that of the mean machine.
    covariance : ndarray, shape (P, N, N), or None
        Of the positions that hold the pose, mm²: geometry, errors of the legs and noise of the actuators.
    faults : tuple of str, length P
        Why a pose is out of reach, in words; empty where it is not.
    """

    actuators: Array
    covariance: Array | None
    faults: tuple[str, ...]

    @property
    def sd(self) -> Array | None:
        """Standard deviations of the actuator positions, shape (P, N), mm."""
        return None if self.covariance is None else np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @property
    def reached(self) -> np.ndarray:
        """Which poses are within reach, shape (P,)."""
        return np.array([not fault for fault in self.faults], dtype=bool)


def predict_poses(calibrated: CalibratedMachine, actuators: Array) -> PosePrediction:
    """Return the poses of actuator positions ρ, shape (P, N), mm, with their covariance.

    Raises
    ------
    InputError
        For another shape.
    """
    _check_shape(actuators, calibrated.n_legs, "actuator positions")
    bent = _find_bent(calibrated)
    parts = [_predict_some(calibrated, actuators[part], bent) for part in _split(len(actuators))]
    return PosePrediction(
        np.concatenate([one.position for one in parts]),
        np.concatenate([one.rotation for one in parts]),
        _join([one.covariance for one in parts]),
        _join([one.of_geometry for one in parts]),
        np.concatenate([one.found for one in parts]),
    )


def _predict_some(calibrated: CalibratedMachine, actuators: Array, bent: Array | None) -> PosePrediction:
    machine, theta = calibrated.machine, calibrated.theta
    displacement = actuators - machine.mechanism.initial_actuator_positions
    found = solve_forward_kinematics(machine, theta, actuators, check=False)
    here = machine.linearise(theta, found.position, found.rotation, actuators)
    gain = _invert(here.pose, found.converged)
    moved = np.einsum("pij,pj->pi", gain, calibrated.errors.mean(displacement))
    if calibrated.covariance is None:
        return PosePrediction(*_move(found, moved), None, None, found.converged)
    shift, of_geometry = _spread(calibrated, gain, here, (found.position, found.rotation), actuators, bent)
    position, rotation = _move(found, moved + shift)
    others = gain @ calibrated.errors.covariance(displacement, here.actuators) @ np.swapaxes(gain, 1, 2)
    return PosePrediction(position, rotation, of_geometry + others, of_geometry, found.converged)


def command_poses(calibrated: CalibratedMachine, position: Array, rotation: Array) -> Command:
    """Return the actuator positions that hold poses (P, 3), (P, 3, 3), base frame, mm, and which are out of reach.

    Raises
    ------
    InputError
        For another shape.
    """
    _check_shape(position, 3, "positions")
    bent = _find_bent(calibrated)
    parts = [_command_some(calibrated, position[part], rotation[part], bent) for part in _split(len(position))]
    covariance = _join([one.covariance for one in parts])
    faults = tuple(fault for one in parts for fault in one.faults)
    return Command(np.concatenate([one.actuators for one in parts]), covariance, faults)


def _command_some(calibrated: CalibratedMachine, position: Array, rotation: Array, bent: Array | None) -> Command:
    machine, theta = calibrated.machine, calibrated.theta
    found = solve_inverse_kinematics(machine, theta, position, rotation, check=False)
    actuators = found.actuators
    faults = _name_faults(calibrated, position, rotation, actuators, found.converged)
    here = machine.linearise(theta, position, rotation, actuators)
    gain = _invert(here.actuators, found.converged)
    displacement = actuators - machine.mechanism.initial_actuator_positions
    moved = actuators + np.einsum("pij,pj->pi", gain, calibrated.errors.mean(displacement))
    moved = np.where(found.converged[:, None], moved, np.nan)
    if calibrated.covariance is None:
        return Command(moved, None, faults)
    shift, of_geometry = _spread(calibrated, gain, here, (position, rotation), actuators, bent)
    others = gain @ calibrated.errors.covariance(displacement, here.actuators) @ np.swapaxes(gain, 1, 2)
    return Command(moved + shift, of_geometry + others, faults)


def draw_poses(
    calibrated: CalibratedMachine, actuators: Array, n_draws: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return what draws of the posterior predict, each with errors of the legs of its own.

    Parameters
    ----------
    calibrated : CalibratedMachine
        With draws.
    actuators : ndarray, shape (P, N)
        mm.
    n_draws : int
        At most so many S.
    rng : Generator
        For the errors of the legs.

    Returns
    -------
    position, rotation : ndarray, shapes (S, P, 3) and (S, P, 3, 3)
        NaN where a draw's machine has no pose.

    Raises
    ------
    InputError
        Where there are no draws.
    """
    if calibrated.draws is None:
        raise InputError(f"experiment {calibrated.source.experiment}: found no draws of its posterior, expected some")
    mean, theta = predict_poses(calibrated, actuators), calibrated.thin(n_draws)
    errors = _draw_errors(calibrated, mean, actuators, len(theta), rng)
    positions, rotations = [], []
    for part in _split(len(theta), max(1, CHUNK // len(actuators))):
        found = solve_forward_kinematics(calibrated.machine, theta[part, None], actuators, check=False)
        position, rotation = _move(found, errors[part])
        positions.append(position)
        rotations.append(rotation)
    return np.concatenate(positions), np.concatenate(rotations)


def _draw_errors(
    calibrated: CalibratedMachine, mean: PosePrediction, actuators: Array, n_draws: int, rng: np.random.Generator
) -> Array:
    """Return pose errors (S, P, 6) in mm and rad by the errors of the legs."""
    machine = calibrated.machine
    displacement = actuators - machine.mechanism.initial_actuator_positions
    here = machine.linearise(calibrated.theta, mean.position, mean.rotation, actuators)
    gain = _invert(here.pose, mean.found)
    values, vectors = np.linalg.eigh(calibrated.errors.covariance(displacement, here.actuators))
    root = gain @ vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    shift = np.einsum("pij,pj->pi", gain, calibrated.errors.mean(displacement))
    normal = rng.standard_normal((n_draws, *displacement.shape))
    return shift + np.einsum("pij,spj->spi", root, normal)


def _move(found: ForwardKinematics, moved: Array) -> tuple[Array, Array]:
    """Return poses moved by errors (..., 6) in mm and rad; NaN where none was found."""
    good = found.converged[..., None]
    position = np.where(good, found.position + moved[..., :3], np.nan)
    turned = matrix_from_rotation_vector(np.where(good, moved[..., 3:], 0.0)) @ found.rotation
    return position, np.where(good[..., None], turned, np.nan)


def _name_faults(
    calibrated: CalibratedMachine, position: Array, rotation: Array, actuators: Array, closed: np.ndarray
) -> tuple[str, ...]:
    """Return why poses are out of reach: a leg that does not, an actuator beyond its range, another branch."""
    machine = calibrated.machine
    mechanism = machine.mechanism
    moved = actuators - mechanism.initial_actuator_positions
    furthest = np.argmax(np.nan_to_num(np.abs(moved)), axis=1)
    on_branch = machine.holds_branch(calibrated.theta, position, rotation, actuators)
    faults = []
    for k, leg in enumerate(furthest):
        travel = moved[k, leg]
        if not closed[k]:
            faults.append("no actuator positions hold it")
        elif abs(travel) > mechanism.actuator_range + SLACK:
            faults.append(f"leg {leg + 1} would move by {travel:.4g} mm, its range is {mechanism.actuator_range:g} mm")
        else:
            faults.append("" if on_branch[k] else "only on another assembly branch")
    return tuple(faults)


def _find_bent(calibrated: CalibratedMachine) -> Array | None:
    """Return draws (S, D) where these leave the tangent at the mean somewhere in the workspace; None where they do not.

    It is seen at poses of actuators anywhere within their range, the same ones at every call.
    """
    if calibrated.draws is None:
        return None
    machine, theta = calibrated.machine, calibrated.thin(SPREAD_DRAWS)
    share = np.random.default_rng(0).uniform(-1.0, 1.0, (LOOKS, calibrated.n_legs))
    actuators = machine.mechanism.initial_actuator_positions + machine.mechanism.actuator_range * share
    found = solve_forward_kinematics(machine, calibrated.theta, actuators, check=False)
    position, rotation, actuators = (one[found.converged] for one in (found.position, found.rotation, actuators))
    here = machine.linearise(calibrated.theta, position, rotation, actuators)
    gain = np.linalg.pinv(here.pose)
    moved = _respond(calibrated, gain, position, rotation, actuators, theta)
    tangent = gain @ here.parameters @ (calibrated.theta - theta).T
    off = np.sqrt(np.mean((moved - tangent) ** 2, axis=-1))
    return theta if np.any(off > BENT * moved.std(axis=-1)) else None


def _spread(
    calibrated: CalibratedMachine,
    gain: Array,
    here: Linearisation,
    pose: tuple[Array, Array],
    actuators: Array,
    bent: Array | None,
) -> tuple[Array, Array]:
    """Return how a posterior moves what the mean machine does, in the mean (P, m) and as a covariance (P, m, m).

    Parameters
    ----------
    calibrated : CalibratedMachine
    gain : ndarray, shape (P, m, N)
        What moves by a unit of the closure; NaN where there is nothing.
    here : Linearisation
        Of the mean machine there.
    pose : pair of ndarray, shapes (P, 3) and (P, 3, 3)
    actuators : ndarray, shape (P, N)
    bent : ndarray, shape (S, D), or None
        Draws, where the tangent does not do.
    """
    assert calibrated.covariance is not None
    slope = gain @ here.parameters[..., calibrated.free]
    if bent is None:
        return np.zeros(gain.shape[:2]), slope @ calibrated.covariance @ np.swapaxes(slope, 1, 2)
    mean, covariance = np.empty(gain.shape[:2]), np.empty((*gain.shape[:2], gain.shape[1]))
    for part in _split(len(gain), SPREAD_POSES):
        moved = _respond(calibrated, gain[part], pose[0][part], pose[1][part], actuators[part], bent)
        mean[part] = moved.mean(axis=-1)
        apart = moved - mean[part, :, None]
        covariance[part] = apart @ np.swapaxes(apart, 1, 2) / (len(bent) - 1)
    chance = (bent.mean(axis=0) - calibrated.theta)[calibrated.free]  # that these draws have another mean than all
    return mean + np.einsum("pik,k->pi", slope, chance), covariance


def _respond(
    calibrated: CalibratedMachine, gain: Array, position: Array, rotation: Array, actuators: Array, theta: Array
) -> Array:
    """Return what moves by machines θ, shape (S, D), by their closures as they are, shape (P, m, S)."""
    machine = calibrated.machine
    closure = machine.model.bind(machine.layout, position, rotation, machine.basis(actuators))
    with np.errstate(all="ignore"):  # poses that were not found
        return np.asarray(-(gain @ closure.evaluate(np.asfortranarray(theta)).transpose(1, 0, 2)))


def _invert(slopes: Array, good: np.ndarray) -> Array:
    """Return pseudo-inverses of (P, N, m), shape (P, m, N); NaN where there is nothing to invert."""
    usable = good & np.isfinite(slopes).all(axis=(1, 2))
    inverse = np.linalg.pinv(np.where(usable[:, None, None], slopes, np.eye(*slopes.shape[1:])))
    return np.where(usable[:, None, None], inverse, np.nan)


def _check_shape(values: Array, n: int, what: str) -> None:
    if values.ndim != 2 or values.shape[1] != n:
        raise InputError(f"{what}: found shape {values.shape}, expected (poses, {n})")
    if not len(values):
        raise InputError(f"{what}: found none, expected at least one")


def _split(n: int, size: int = CHUNK) -> Iterator[slice]:
    return (slice(k, k + size) for k in range(0, n, size))


def _join(parts: list[Array | None]) -> Array | None:
    there = [one for one in parts if one is not None]
    return np.concatenate(there) if there else None
