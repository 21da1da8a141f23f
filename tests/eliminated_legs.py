"""Mechanisms on legs by the general route: N actuators, commanded, and six channels of the measured pose."""

from __future__ import annotations

import numpy as np
from calibration_problems import evaluate_rows

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.calibration.likelihood import CalibrationLikelihood
from bayescal.density.calibration.measurements import Measurements
from bayescal.machines.kinematics import Machine
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import Array, rotation_vector_from_matrix


def list_coordinates(poses: MeasuredPoses) -> Array:
    """Return measured poses as positions and rotation vectors, shape (P, 6)."""
    return np.concatenate([poses.position, rotation_vector_from_matrix(poses.rotation)], axis=1)


def eliminate_legs(machine: Machine, poses: MeasuredPoses, noise: float, theta: Array) -> CalibrationLikelihood:
    """Return the density of measured poses given their actuators, σ_ρ being their noise; anchored at a machine (D,)."""
    n, pose = machine.mechanism.n_legs, list_coordinates(poses)
    covariance = np.broadcast_to(poses.covariance, (len(pose), 6, 6))
    spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    correlation = np.tile(np.eye(n + 6), (len(pose), 1, 1))
    correlation[:, n:, n:] = covariance / spread[:, :, None] / spread[:, None]
    data = Measurements(
        poses.names,
        np.concatenate([poses.actuators, pose], axis=1),
        np.concatenate([np.full((len(pose), n), noise), spread], axis=1),
        correlation=correlation,
        commanded=np.tile(np.arange(n + 6) < n, (len(pose), 1)),
    )
    return CalibrationLikelihood(Legs(machine), data, 1.0, pose).anchored_at(pose, theta)


def evaluate_legs(likelihood: CalibrationLikelihood, theta: Array, tau: Array) -> Array:
    """Return the log-density of each pose, (B, P), for machines (B, D), τ (B, N) or (N,)."""
    n_machines, n_legs = len(theta), tau.shape[-1]
    error = np.zeros((n_machines, 1, len(likelihood.model.channels)))
    error[:, 0, :n_legs] = tau
    own = np.broadcast_to(likelihood.sd, (n_machines, *likelihood.sd.shape))
    return evaluate_rows(likelihood, theta, own, error)
