"""Yu's coordinates of a pose: position and the angles α, β, γ about fixed x, y, z axes, R = R_z(γ) R_y(β) R_x(α).

The rest of the package has rotation vectors; at ±10 deg their errors differ from those of the angles by up to a sixth,
through the rates of `angle_rates` of pose selection. Measurement noise is on the angles; so are the attitude errors of
the paper and the Jacobian that it selects poses by.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.numerics.geometry import Array

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
