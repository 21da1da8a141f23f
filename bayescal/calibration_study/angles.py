"""Yu's coordinates of a pose: position and the angles α, β, γ about fixed x, y, z axes, R = R_z(γ) R_y(β) R_x(α).

The rest of the package has rotation vectors; at ±10 deg their errors differ from those of the angles by up to a sixth,
through the rates of `angle_rates`. Measurement noise is on the angles, and so are the attitude errors of the paper.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.geometry import Array

SEQUENCE = "xyz"  # about fixed axes


def coordinates_from_pose(position: Array, rotation: Array) -> Array:
    """Return q = (x, y, z, α, β, γ), shape (..., 6), mm and rad (Yu, Wu and Wang 2023 eq. 2)."""
    flat = Rotation.from_matrix(rotation.reshape(-1, 3, 3), assume_valid=True).as_euler(SEQUENCE)
    return np.concatenate([position, flat.reshape(position.shape)], axis=-1)


def pose_from_coordinates(coordinates: Array) -> tuple[Array, Array]:
    """Return positions (..., 3) and rotations (..., 3, 3) of q, shape (..., 6)."""
    angles = coordinates[..., 3:]
    flat = Rotation.from_euler(SEQUENCE, angles.reshape(-1, 3)).as_matrix()
    return coordinates[..., :3], flat.reshape(*angles.shape, 3)


def angle_rates(angles: Array) -> Array:
    """Return what takes rotation vectors to changes of the angles (..., 3), shape (..., 3, 3); none at β = ±90 deg."""
    beta, gamma = angles[..., 1], angles[..., 2]
    cosine, sine = np.cos(gamma), np.sin(gamma)
    rates = np.zeros((*angles.shape, 3))
    rates[..., 0, 0], rates[..., 0, 1] = cosine / np.cos(beta), sine / np.cos(beta)
    rates[..., 1, 0], rates[..., 1, 1] = -sine, cosine
    rates[..., 2, 0], rates[..., 2, 1] = cosine * np.tan(beta), sine * np.tan(beta)
    rates[..., 2, 2] = 1.0
    return rates
