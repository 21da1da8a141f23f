"""Poses as arrays: small rotations, pose errors and covariances, batch axes first.

A pose is a pair of a position, shape (..., 3) in mm, and a rotation matrix, shape (..., 3, 3), from the body to the
reference frame. A pose error is six numbers, position error in mm and rotation vector in radians, both expressed in the
reference frame, with the convention ``R_true = Exp(w) R_estimated``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

DEGREES_OF_FREEDOM = 6
"""Of a body in space, and how many coordinates a pose has."""

LEAST_COSINE = -0.9  # of a turn, of which the skew part of its matrix tells direction and angle

type Array = NDArray[np.float64]


def skew_matrix(vector: Array) -> Array:
    """Return the matrix of ``vector × ·``, shape (..., 3) to (..., 3, 3)."""
    result = np.zeros((*vector.shape, 3))
    for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
        result[..., n, m] = vector[..., k]
        np.negative(vector[..., k], out=result[..., m, n])
    return result


def compute_rigid_jacobian(points: Array, rotation: Array) -> Array:
    """Return (1, -[R s]×) of points s (..., n, 3) on a body turned by R (..., 3, 3), shape (..., n, 3, 6)."""
    arms = points @ np.swapaxes(rotation, -1, -2)
    return np.concatenate([np.broadcast_to(np.eye(3), (*arms.shape, 3)), -skew_matrix(arms)], axis=-1)


def matrix_from_rotation_vector(rotation_vector: Array) -> Array:
    """Return the rotation matrices of rotation vectors in radians, shape (..., 3) to (..., 3, 3).

    Of complex vectors those of the real parts, to first order with imaginary ones: what a complex step takes.
    """
    if np.iscomplexobj(rotation_vector):
        real = matrix_from_rotation_vector(rotation_vector.real)
        turn = np.linalg.inv(compute_left_inverse_jacobian(rotation_vector.real)) @ rotation_vector.imag[..., None]
        return real + 1j * skew_matrix(turn[..., 0]) @ real  # type: ignore[return-value]
    flat = Rotation.from_rotvec(rotation_vector.reshape(-1, 3)).as_matrix()
    return flat.reshape(*rotation_vector.shape, 3)


def rotation_vector_from_matrix(rotation: Array) -> Array:
    """Return the rotation vectors in radians of rotation matrices, shape (..., 3, 3) to (..., 3)."""
    flat = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_rotvec()
    return flat.reshape(rotation.shape[:-1])


def rotation_vector_of_turn(turn: Array) -> Array:
    """Return `rotation_vector_from_matrix` of turns that hardly ever come near half a turn, in a fraction of its time.

    The skew part of a rotation is sin|φ| φ/|φ|, its trace 1 + 2 cos|φ|; near half a turn that says little.
    """
    skew = np.stack([turn[..., n, m] - turn[..., m, n] for m, n in ((1, 2), (2, 0), (0, 1))], axis=-1)
    cosine = np.einsum("...kk->...", turn) - 1.0  # twice, as the sine
    if cosine.min(initial=2.0) < 2.0 * LEAST_COSINE:
        return rotation_vector_from_matrix(turn)
    sine = np.sqrt(np.einsum("...k,...k->...", skew, skew))
    there = sine > 0.0
    stretch = np.divide(np.arctan2(sine, cosine), sine, out=np.full(sine.shape, 0.5), where=there)
    return np.asarray(stretch[..., None] * skew)


def compute_left_inverse_jacobian(rotation_vector: Array) -> Array:
    """Return Jl⁻¹ of Log(Exp(ω) Exp(φ)) = φ + Jl⁻¹(φ) ω + O(ω²), (..., 3) to (..., 3, 3); Jr⁻¹ is its transpose."""
    angle = np.sqrt(np.einsum("...k,...k->...", rotation_vector, rotation_vector))[..., None, None]
    half = 0.5 * angle
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.where(angle > 1e-3, (1.0 - half / np.tan(half)) / angle**2, 1 / 12 + angle**2 / 720)
    cross = skew_matrix(rotation_vector)
    return np.eye(3) - 0.5 * cross + factor * cross @ cross


def compute_left_jacobian(rotation_vector: Array) -> Array:
    """Return Jl of Exp(φ + dφ) = Exp(Jl(φ) dφ) Exp(φ) to first order, shape (..., 3) to (..., 3, 3)."""
    square = np.einsum("...k,...k->...", rotation_vector, rotation_vector)
    angle = np.sqrt(square)
    series = 1 / 6 - square / 120 + square**2 / 5040  # of (|φ| - sin|φ|) / |φ|³
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.where(angle > 0.03, (angle - np.sin(angle)) / (square * angle), series)
    result = skew_matrix((0.5 * np.sinc(0.5 * angle / np.pi) ** 2)[..., None] * rotation_vector)
    result += (factor[..., None] * rotation_vector)[..., :, None] * rotation_vector[..., None, :]
    result[..., np.arange(3), np.arange(3)] += (1.0 - factor * square)[..., None]  # [φ]² = φ φᵀ - |φ|² 1
    return result


def compute_pose_error(position: Array, rotation: Array, position_ref: Array, rotation_ref: Array) -> Array:
    """Return the error of a pose against a reference pose, shape (..., 6): mm, then rotation vector in radians."""
    delta = rotation @ np.swapaxes(rotation_ref, -1, -2)
    return np.concatenate([position - position_ref, rotation_vector_from_matrix(delta)], axis=-1)


def compute_relative_pose(
    base: tuple[Array, Array, Array], platform: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """Return the platform's pose in the base frame, with its covariance.

    Parameters
    ----------
    base, platform : tuple of arrays
        Position (..., 3) in mm, rotation (..., 3, 3) and covariance (..., 6, 6) of each body in the measurement frame.

    Returns
    -------
    position, rotation, covariance
        Pose of the platform frame in the base frame; to first order in the two independent errors, whose leverage is
        the distance from the base to the platform origin.
    """
    (position_b, rotation_b, covariance_b), (position_p, rotation_p, covariance_p) = base, platform
    to_base = np.swapaxes(rotation_b, -1, -2)
    offset = position_p - position_b
    position = np.einsum("...ij,...j->...i", to_base, offset)
    rotation = to_base @ rotation_p
    zero = np.zeros_like(to_base)
    jacobian_p = np.block([[to_base, zero], [zero, to_base]])
    jacobian_b = np.block([[-to_base, to_base @ skew_matrix(offset)], [zero, -to_base]])
    covariance = jacobian_p @ covariance_p @ np.swapaxes(jacobian_p, -1, -2)
    covariance = covariance + jacobian_b @ covariance_b @ np.swapaxes(jacobian_b, -1, -2)
    return position, rotation, 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
