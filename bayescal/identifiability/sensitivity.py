"""The identification Jacobian: how measured poses change with the parameters, and its rows in units of the noise.

At a pose the closure f(θ, pose, ρ) = 0 gives A δe + F δθ + n = 0 with A = ∂f/∂pose, F = ∂f/∂θ, and n what actuators
and model err by, of covariance D = B Bᵀ σ_ρ² + diag(B)² τ² with B = ∂f/∂ρ, as in the likelihood. For six legs the pose
moves by -A⁻¹ F δθ. More legs than six say more: what no pose explains, Zᵀ (F δθ + n) = 0 with Zᵀ A = 0, is seen without
any sensor. With D as weight both parts are independent:

    information = Sᵀ M (1 + C M)⁻¹ S + (ZᵀF)ᵀ (ZᵀDZ)⁻¹ (ZᵀF),    S = -(AᵀD⁻¹A)⁻¹AᵀD⁻¹ F,    C = (AᵀD⁻¹A)⁻¹,

with M what the sensors tell of the pose. It holds for a singular M too, where they see only a part of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.errors import InputError
from bayescal.identifiability.design import Knowledge, Plan, predict_poses
from bayescal.machines.frames import N_FRAME_PARAMETERS, frame_slopes, move_frames
from bayescal.machines.kinematics import SINGULAR_CONDITION, ForwardKinematics, solve_forward_kinematics
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array

UNSEEN = 1e-13  # of a scaled matrix: what rounding leaves of a pose's coordinate that no sensor sees


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives at P poses of one machine by its n free parameters.

    Attributes
    ----------
    actuators : ndarray, shape (P, N)
        Their positions ρ, mm.
    poses : ForwardKinematics
        Where the platform stands.
    by_pose, by_actuators, by_parameters : ndarray, shapes (P, N, 6), (P, N, N) and (P, N, n)
        A, B and F.
    gain : ndarray, shape (P, 6, N)
        Pose by closure as forward kinematics finds it: A⁻¹, or the pseudo-inverse.
    frames : ndarray, shape (P, 6, n)
        What free frames do to the measured pose.
    """

    actuators: Array
    poses: ForwardKinematics
    by_pose: Array
    by_actuators: Array
    by_parameters: Array
    gain: Array
    frames: Array

    @cached_property
    def slope(self) -> Array:
        """Pose by parameters, mm and rad, as the instrument sees it, shape (P, 6, n)."""
        return self.frames - self.gain @ self.by_parameters

    def closure_noise(self, plan: Plan) -> Array:
        """Return D, shape (P, N, N), mm²."""
        own = np.diagonal(self.by_actuators, axis1=-2, axis2=-1) ** 2
        moved = self.by_actuators @ np.swapaxes(self.by_actuators, -1, -2) * plan.actuator_noise**2
        return np.asarray(moved + np.eye(own.shape[-1]) * (own * plan.model_error**2)[:, None, :])

    def pose_noise(self, plan: Plan) -> Array:
        """Return the covariance of the pose for what actuators and model err by, shape (P, 6, 6)."""
        result: Array = self.gain @ self.closure_noise(plan) @ np.swapaxes(self.gain, -1, -2)
        return result

    def root(self, plan: Plan, noise: Array | None = None) -> Array:
        """Return what takes a pose error (mm, rad) to units of the noise, shape (P, 6, 6), by default `pose_noise`."""
        seen, noise = plan.information(self.poses), self.pose_noise(plan) if noise is None else noise
        return root_of(np.linalg.solve(np.eye(DEGREES_OF_FREEDOM) + seen @ noise, seen))

    def whiten(self, plan: Plan) -> Array:
        """Return what makes the closures of redundant legs white, shape (P, N, N); InputError where nothing errs."""
        if plan.actuator_noise == 0.0 and plan.model_error == 0.0:
            raise InputError("found no actuator noise and no model error, expected some where legs are redundant")
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.closure_noise(plan))))

    def rows(self, plan: Plan) -> Array:
        """Return the identification Jacobian in units of the noise, shape (P, N, n); of an exact six-legged one too."""
        if self.by_pose.shape[-2] == DEGREES_OF_FREEDOM:
            return self.root(plan) @ self.slope
        whiten = self.whiten(plan)
        pose, parameters = whiten @ self.by_pose, whiten @ self.by_parameters
        left, values, right = np.linalg.svd(pose)
        gain = np.swapaxes(right, -1, -2) / values[..., None, :] @ np.swapaxes(left[..., :DEGREES_OF_FREEDOM], -1, -2)
        slope = self.frames - gain @ parameters
        loops = np.swapaxes(left[..., DEGREES_OF_FREEDOM:], -1, -2) @ parameters
        return np.concatenate([self.root(plan, gain @ np.swapaxes(gain, -1, -2)) @ slope, loops], axis=1)


def root_of(matrix: Array) -> Array:
    """Return the roots R of positive semi-definite matrices that are symmetric but for units, RᵀR = M, (..., k, k).

    Unlike a factor from an eigendecomposition it hangs continuously together with M, so that Jacobians can be compared.
    """
    symmetric = 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
    scale = np.sqrt(np.maximum(np.diagonal(symmetric, axis1=-2, axis2=-1), 0.0))
    scale = np.where(scale > 0.0, scale, 1.0)[..., None]  # mm and rad side by side: first without units
    values, vectors = np.linalg.eigh(symmetric / scale / np.swapaxes(scale, -1, -2))
    values = np.where(values > UNSEEN, values, 0.0)
    half = (vectors * np.sqrt(values)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return half * np.swapaxes(scale, -1, -2)


def compute_sensitivity(knowledge: Knowledge, actuators: Array, theta: Array | None = None) -> Sensitivity:
    """Return the derivatives at the poses that a machine takes for actuator positions (P, N), mm.

    Parameters
    ----------
    knowledge : Knowledge
    actuators : ndarray, shape (P, N)
    theta : ndarray, shape (D,), optional
        The machine, with its frames at zero, in place of the expected one.

    Raises
    ------
    InputError
        Names the first pose that the machine cannot take or at which it is singular.
    """
    theta = knowledge.centre if theta is None else theta
    machine_theta, frames = theta[:-N_FRAME_PARAMETERS], theta[-N_FRAME_PARAMETERS:]
    if frames.any():
        raise InputError("found a frame away from zero, expected all frames at zero")
    found = predict_poses(knowledge.machine, machine_theta, actuators)
    return linearise_at(knowledge, machine_theta, found, actuators)


def linearise_at(
    knowledge: Knowledge,
    theta: Array,
    found: ForwardKinematics,
    actuators: Array,
    name: Callable[[int], str] = lambda index: f"pose {index + 1}",
) -> Sensitivity:
    """Return the derivatives at poses that are known to belong to actuator positions.

    Parameters
    ----------
    knowledge : Knowledge
    theta : ndarray
        The machine's parameters, without frames, which are at zero.
    found : ForwardKinematics
        P poses.
    actuators : ndarray, shape (P, N)
        Their actuator positions, mm.
    name : callable
        What a singular pose is called in the complaint.
    """
    here = knowledge.machine.linearise(theta, found.position, found.rotation, actuators)
    own = np.zeros((*here.parameters.shape[:-1], N_FRAME_PARAMETERS))
    seen = np.zeros((len(actuators), DEGREES_OF_FREEDOM, knowledge.layout.size))
    seen[..., -N_FRAME_PARAMETERS:] = frame_slopes(found.position, found.rotation)
    parameters = np.concatenate([here.parameters, own], axis=-1)[..., knowledge.free]
    gain = _invert(here.pose, name)
    return Sensitivity(actuators, found, here.pose, here.actuators, parameters, gain, seen[..., knowledge.free])


def _invert(jacobian: Array, name: Callable[[int], str]) -> Array:
    """Return the pseudo-inverses of pose Jacobians (P, N, 6); InputError names the first singular one."""
    scale = np.linalg.norm(jacobian, axis=-2, keepdims=True)  # mm and rad side by side
    scaled = jacobian / np.where(scale > 0.0, scale, 1.0)
    condition = np.linalg.cond(scaled)
    if not np.all(condition < SINGULAR_CONDITION):
        index = int(np.argmax(~(condition < SINGULAR_CONDITION)))
        raise InputError(f"{name(index)}: singular pose Jacobian J_1, expected poses away from singularities")
    return np.asarray(np.linalg.pinv(scaled) / np.swapaxes(scale, -1, -2))


def compute_measured_poses(knowledge: Knowledge, theta: Array, actuators: Array) -> tuple[Array, Array]:
    """Return the poses as the instrument sees them, (..., P, 3) and (..., P, 3, 3), NaN where there is none.

    Parameters
    ----------
    knowledge : Knowledge
    theta : ndarray, shape (..., D)
        Machines and their frames.
    actuators : ndarray, shape (P, N)
        Actuator positions, mm; leading axes as those of ``theta`` are possible.
    """
    machine = knowledge.machine
    found = solve_forward_kinematics(machine, theta[..., None, :-N_FRAME_PARAMETERS], actuators, check=False)
    position, rotation = move_frames(theta[..., -N_FRAME_PARAMETERS:], found.position, found.rotation)
    return np.where(found.converged[..., None], position, np.nan), rotation
