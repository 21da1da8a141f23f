"""Calibration as Yu, Wu and Wang (2023) do it, of many simulated machines at once, and with the noise and the priors.

Each iteration solves dq_B = J_B dC by least squares at the parameters found so far and corrects them (their section
4.1, figure 4). dq_B is the measured minus the predicted pose in x, y, z, α, β, γ. They count a millimetre as much as a
radian. Divided by the standard deviations of the noise the same equations give the most likely machine; with the rows
of a normal prior beside them, the most probable one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.errors import InputError, NumericalError
from bayescal.machines.kinematics import Machine
from bayescal.machines.models.base import newton_step
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector
from bayescal.pose_selection.observability import angle_rates

SEQUENCE = "xyz"  # about fixed axes
PER_UNIT = {"rad": 1.0, "deg": 180.0 / np.pi}
POSES_AT_ONCE = 1 << 17
POSE_STEPS = 30
POSE_TOLERANCE = 1e-7  # of the last Newton step, mm and rad: what is left is its square
MAX_ITERATIONS = 50
TOLERANCE = 1e-6  # mm, the largest correction of the last iteration
LARGEST = 1e6  # mm, a correction that is no longer one
CHUNK = 1 << 19  # numbers in one array of derivatives, 4 MB


@dataclass(frozen=True, eq=False)
class Weighting:
    """What least squares divides by.

    Attributes
    ----------
    scale : ndarray, shape (6,)
        Of the pose errors, mm and rad: ones as in the paper, or the standard deviations of the noise.
    prior : float, optional
        Standard deviation of all parameters about nominal, mm.
    """

    scale: Array
    prior: float | None = None


@dataclass(frozen=True, eq=False)
class Calibrations:
    """Calibrated machines.

    Attributes
    ----------
    theta : ndarray, shape (B, D)
        Parameters found; NaN for a machine whose iteration left all machines.
    trace : ndarray, shape (K, B, D)
        Parameters after each iteration, nominal first; those that have settled stay.
    converged : ndarray of bool, shape (B,)
    n_iterations : ndarray of int, shape (B,)
    """

    theta: Array
    trace: Array
    converged: np.ndarray
    n_iterations: np.ndarray


def find_lengths(machine: Machine, theta: Array, position: Array, rotation: Array) -> Array:
    """Return the displacements of the struts that hold poses, shape (..., N), mm: |g| - l (their eq. 3)."""
    here = machine.mechanism.initial_actuator_positions
    shape = np.broadcast_shapes(theta.shape[:-1], position.shape[:-1])
    basis = machine.basis(np.broadcast_to(here, (*shape, len(here))))
    closure = machine.model.prepare(machine.layout, theta)
    return here - closure(position, rotation, basis, with_parameters=False).residual


def move(
    machine: Machine, theta: Array, actuators: Array, position: Array, rotation: Array
) -> tuple[Array, Array, np.ndarray]:
    """Return the poses that machines (B, D) take for actuators (P, N) or (B, P, N), sought from poses close by.

    Returns
    -------
    position, rotation : ndarray, shapes (B, P, 3) and (B, P, 3, 3)
        mm, base frame.
    found : ndarray of bool, shape (B,)
        Whether Newton's method found all poses of a machine.
    """
    closure = machine.model.prepare(machine.layout, theta[:, None])
    basis = machine.basis(np.broadcast_to(actuators, (*position.shape[:-1], actuators.shape[-1])))
    found = np.zeros(len(theta), dtype=bool)
    for _ in range(POSE_STEPS):
        step = newton_step(closure(position, rotation, basis, with_parameters=False))
        position = position + step[..., :3]
        rotation = matrix_from_rotation_vector(np.nan_to_num(step[..., 3:])) @ rotation
        found = np.abs(step).max(axis=(1, 2)) < POSE_TOLERANCE
        if found.all():
            break
    return position, rotation, found


def calibrate(machine: Machine, actuators: Array, measured: Array, weighting: Weighting) -> Calibrations:
    """Identify all parameters of B machines from their measured poses.

    Parameters
    ----------
    machine : Machine
        The nominal machine, where the iteration starts.
    actuators : ndarray, shape (P, N) or (B, P, N)
        Positions commanded, mm.
    measured : ndarray, shape (B, P, 6)
        q as measured, mm and rad.
    weighting : Weighting

    Raises
    ------
    InputError
        Where there are fewer equations than parameters and no prior, or the poses do not determine the parameters.
    NumericalError
        Where not a single machine is found.
    """
    n_parameters, n_poses = machine.layout.size, actuators.shape[-2]
    actuators = np.broadcast_to(actuators, (len(measured), *actuators.shape[-2:]))
    if weighting.prior is None and 6 * n_poses < n_parameters:
        least = -(-n_parameters // 6)
        raise InputError(f"poses: found {n_poses}, expected at least {least} for {n_parameters} parameters")
    size = max(1, CHUNK // (n_poses * machine.mechanism.n_legs * n_parameters))
    parts = [
        _calibrate(machine, actuators[k : k + size], measured[k : k + size], weighting)
        for k in range(0, len(measured), size)
    ]
    if not any(part.converged.any() for part in parts):
        raise NumericalError(
            f"none of {len(measured)} calibrations converged, expected less noise or smaller errors of the parameters"
        )
    longest = max(len(part.trace) for part in parts)
    traces = [np.concatenate([p.trace, np.repeat(p.trace[-1:], longest - len(p.trace), axis=0)]) for p in parts]
    return Calibrations(
        np.concatenate([part.theta for part in parts]),
        np.concatenate(traces, axis=1),
        np.concatenate([part.converged for part in parts]),
        np.concatenate([part.n_iterations for part in parts]),
    )


def _calibrate(machine: Machine, actuators: Array, measured: Array, weighting: Weighting) -> Calibrations:
    nominal, n_machines = machine.layout.nominal, len(measured)
    theta = np.tile(nominal, (n_machines, 1))
    position, rotation = (np.array(part) for part in pose_from_coordinates(measured))
    trace, n_iterations = [theta.copy()], np.zeros(n_machines, dtype=int)
    converged, active = np.zeros(n_machines, dtype=bool), np.arange(n_machines)
    while len(active) and len(trace) <= MAX_ITERATIONS:
        here = theta[active]
        p, r, found = move(machine, here, actuators[active], position[active], rotation[active])
        position[active], rotation[active] = p, r
        correction = np.full_like(here, np.nan)
        kept = active[found]
        if len(kept):
            rows, error = linearise(machine, here[found], actuators[kept], p[found], r[found], measured[kept])
            correction[found] = _solve(rows, error, weighting, here[found] - nominal)
        theta[active] += correction
        n_iterations[active] += 1
        largest = np.abs(correction).max(axis=1)
        converged[active] = largest < TOLERANCE
        active = active[(largest >= TOLERANCE) & (largest < LARGEST)]
        trace.append(theta.copy())
    return Calibrations(theta, np.array(trace), converged, n_iterations)


def linearise(
    machine: Machine, theta: Array, actuators: Array, position: Array, rotation: Array, measured: Array
) -> tuple[Array, Array]:
    """Return J_B, shape (b, P, 6, D), and dq_B, shape (b, P, 6)."""
    predicted = coordinates_from_pose(position, rotation)
    here = machine.linearise(theta[:, None], position, rotation, actuators)
    gain = np.linalg.inv(here.pose)
    gain[..., 3:, :] = angle_rates(rotation) @ gain[..., 3:, :]
    return -(gain @ here.parameters), measured - predicted


def _solve(rows: Array, error: Array, weighting: Weighting, off: Array) -> Array:
    """Return the corrections (b, D) of parameters that are off nominal."""
    flat = (rows / weighting.scale[:, None]).reshape(len(rows), -1, rows.shape[-1])
    right = (error / weighting.scale).reshape(len(rows), -1, 1)
    transposed = np.swapaxes(flat, -1, -2).copy()  # a product with its own transposed view is slow
    normal, gradient = transposed @ flat, (transposed @ right)[..., 0]
    if weighting.prior is not None:
        normal += np.eye(normal.shape[-1]) / weighting.prior**2
        gradient -= off / weighting.prior**2
    try:
        return np.asarray(np.linalg.solve(normal, gradient[..., None])[..., 0])
    except np.linalg.LinAlgError as error_:
        raise InputError("poses: found ones that do not determine the parameters, expected others or more") from error_


def coordinates_from_pose(position: Array, rotation: Array) -> Array:
    """Return q = (x, y, z, α, β, γ), shape (..., 6), mm and rad (Yu, Wu and Wang 2023 eq. 2)."""
    flat = Rotation.from_matrix(rotation.reshape(-1, 3, 3), assume_valid=True).as_euler(SEQUENCE)
    return np.concatenate([position, flat.reshape(position.shape)], axis=-1)


def pose_from_coordinates(coordinates: Array) -> tuple[Array, Array]:
    """Return positions (..., 3) and rotations (..., 3, 3) of q, shape (..., 6)."""
    angles = coordinates[..., 3:]
    flat = Rotation.from_euler(SEQUENCE, angles.reshape(-1, 3)).as_matrix()
    return coordinates[..., :3], flat.reshape(*angles.shape, 3)


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of calibrated machines at verification poses (Yu, Wu and Wang 2023 eqs. 39 to 42).

    Attributes
    ----------
    position : ndarray, shape (B, V)
        dX_tn, mm.
    attitude : ndarray, shape (B, V)
        dX_sn, the norm of the errors of α, β, γ, rad.
    """

    position: Array
    attitude: Array

    def integrated(self, unit: str) -> Array:
        """Return dX_z, the root mean square of position in mm plus attitude in a unit, shape (B,).

        Their eq. (43) adds up 20 poses and divides by 30; both are read as the number of poses.
        """
        both = self.position + PER_UNIT[unit] * self.attitude
        return np.asarray(np.sqrt(np.mean(both**2, axis=-1)))

    @property
    def figures(self) -> dict[str, Array]:
        """The figures of their table 8, each of shape (B,), mm and deg."""
        degrees = np.degrees(self.attitude)
        return {
            "position_max_mm": self.position.max(axis=-1),
            "position_mean_mm": self.position.mean(axis=-1),
            "attitude_max_deg": degrees.max(axis=-1),
            "attitude_mean_deg": degrees.mean(axis=-1),
        }


def evaluate(machine: Machine, truth: Array, found: Array, targets: Array) -> PoseErrors:
    """Return the pose errors of calibrated machines.

    Parameters
    ----------
    machine : Machine
    truth, found : ndarray, shapes (B, D)
        Parameters of the machines as they are, and as calibrated; NaN where the calibration failed.
    targets : ndarray, shape (V, 6)
        q of the poses to take.
    """
    size = max(1, POSES_AT_ONCE // len(targets))
    parts = [_deviate(machine, truth[k : k + size], found[k : k + size], targets) for k in range(0, len(truth), size)]
    deviation = np.concatenate(parts)
    return PoseErrors(np.linalg.norm(deviation[..., :3], axis=-1), np.linalg.norm(deviation[..., 3:], axis=-1))


def _deviate(machine: Machine, truth: Array, found: Array, targets: Array) -> Array:
    """Return dX, shape (b, V, 6); NaN where there is none."""
    shape = (len(truth), *targets.shape)
    position, rotation = pose_from_coordinates(targets)
    lengths = find_lengths(machine, found[:, None], position, rotation)
    start = np.broadcast_to(position, (*shape[:2], 3)), np.broadcast_to(rotation, (*shape[:2], 3, 3))
    reached_position, reached_rotation, reached = move(machine, truth, lengths, *start)
    deviation = coordinates_from_pose(reached_position, reached_rotation) - targets
    return np.where(reached[:, None, None], deviation, np.nan)
