"""Observability indices of an identification Jacobian: numbers that say how well measured poses tell the parameters.

With σ_1 ≥ … ≥ σ_L the singular values of J_B of n poses and L parameters, in the normalisation of Yu, Wu and Wang
(2023, section 3.1):

    O1 = (σ_1 … σ_L)^(1/L) / √n     Menq, Borm and Lai 1989, Borm and Menq 1991: volume of the ellipsoid of pose errors
    O2 = σ_L / σ_1                  Driels and Pathre 1990: inverse condition number
    O3 = σ_L                        Nahvi, Hollerbach and Hayward 1994: least singular value
    O4 = σ_L² / σ_1                 Nahvi and Hollerbach 1996: noise amplification index
    O5 = 1 / Σ 1/σ_i                Sun and Hollerbach 2008: harmonic mean over L

They depend on the units of poses and parameters, O1 by a factor only, and on what stands for the attitude: Yu, Wu and
Wang differentiate by the angles of R = R_z(γ) R_y(β) R_x(α) (sections 2.1 and 2.2), which change faster than the
rotation itself, by 3 % at 10 deg.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from bayescal.numerics.geometry import Array
from bayescal.pose_selection.design import SeenPoses

type JacobianForm = Literal["pose", "angles", "closure"]


INDICES = ("O1", "O2", "O3", "O4", "O5")


def compute_index(name: str, values: Array, n_poses: int) -> Array:
    """Return an index of singular values (..., L) at n poses, largest first, shape (...)."""
    largest, least = values[..., 0], values[..., -1]
    with np.errstate(divide="ignore"):
        match name:
            case "O1":
                found = np.exp(np.log(values).mean(axis=-1)) / np.sqrt(n_poses)
            case "O2":
                found = least / largest
            case "O3":
                found = least
            case "O4":
                found = least**2 / largest
            case _:
                found = 1.0 / np.sum(1.0 / values, axis=-1)
    return np.asarray(found)


def identification_rows(seen: SeenPoses, form: JacobianForm = "pose") -> Array:
    """Return what each of P poses contributes to the identification Jacobian: (P, 6, L), or (P, N, L) of the closure.

    ``pose``: J_b = J_1⁻¹ J_2 (Yu, Wu and Wang 2023 eq. 23), displacement in mm and rotation vector in rad; ``angles``:
    the same with the angles of R = R_z R_y R_x in rad; ``closure``: J_2 alone (RR-8096 eq. 37 but for its factor 1/2).
    """
    if form == "closure":
        return seen.closure
    if form == "pose":
        return seen.slope
    rates = angle_rates(seen.placed.rotation)
    return np.concatenate([seen.slope[:, :3], rates @ seen.slope[:, 3:]], axis=1)


def angle_rates(rotation: Array) -> Array:
    """Return how angles α, β, γ of R = R_z(γ) R_y(β) R_x(α), (..., 3, 3), follow small rotations in the base frame.

    Of shape (..., 3, 3), not finite at β = ±90 deg.
    """
    tangent = -rotation[..., 2, 0] / np.hypot(rotation[..., 0, 0], rotation[..., 1, 0])  # tan β
    gamma = np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0])
    cosine, sine = np.cos(gamma), np.sin(gamma)
    secant = np.hypot(1.0, tangent)
    rows = [
        [cosine * secant, sine * secant, np.zeros_like(gamma)],
        [-sine, cosine, np.zeros_like(gamma)],
        [cosine * tangent, sine * tangent, np.ones_like(gamma)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def compute_observability(jacobian: Array) -> dict[str, Array]:
    """Return the five indices (...) of sets of n poses with J_b (..., n, k, L), mm and rad by the parameters' units.

    Zero where there are fewer rows than parameters.
    """
    values = singular_values(jacobian.reshape(*jacobian.shape[:-3], -1, jacobian.shape[-1]))
    return {name: compute_index(name, values, jacobian.shape[-3]) for name in INDICES}


def singular_values(rows: Array) -> Array:
    """Return all L singular values of rows (..., R, L), largest first, zeros where R is below L."""
    values = np.linalg.svd(rows, compute_uv=False)
    missing = rows.shape[-1] - values.shape[-1]
    return np.concatenate([values, np.zeros((*values.shape[:-1], missing))], axis=-1)
