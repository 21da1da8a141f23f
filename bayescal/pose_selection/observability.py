"""Observability indices of an identification Jacobian: numbers that say how well measured poses tell the parameters.

With σ_1 ≥ … ≥ σ_L the singular values of J_B of n poses and L parameters, in the normalisation of Yu, Wu and Wang
(2023, section 3.1):

    O1 = (σ_1 … σ_L)^(1/L) / √n     Borm and Menq 1989, 1991: volume of the ellipsoid of pose errors
    O2 = σ_L / σ_1                  Driels and Pathre 1990: inverse condition number
    O3 = σ_L                        Nahvi, Hollerbach and Hayward 1994: least singular value
    O4 = σ_L² / σ_1                 Nahvi and Hollerbach 1996: noise amplification index
    O5 = 1 / Σ 1/σ_i                Sun and Hollerbach 2008: harmonic mean over L

They depend on the units of poses and parameters, O1 by a factor only.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.geometry import Array


def compute_o1(values: Array, n_poses: int) -> Array:
    """Return O1 of singular values (..., L)."""
    with np.errstate(divide="ignore"):
        mean = np.exp(np.log(values).mean(axis=-1))
    return np.asarray(mean / np.sqrt(n_poses))


def compute_o2(values: Array, n_poses: int) -> Array:
    """Return O2 of singular values (..., L)."""
    del n_poses
    return np.asarray(values.min(axis=-1) / values.max(axis=-1))


def compute_o3(values: Array, n_poses: int) -> Array:
    """Return O3 of singular values (..., L)."""
    del n_poses
    return np.asarray(values.min(axis=-1))


def compute_o4(values: Array, n_poses: int) -> Array:
    """Return O4 of singular values (..., L)."""
    del n_poses
    return np.asarray(values.min(axis=-1) ** 2 / values.max(axis=-1))


def compute_o5(values: Array, n_poses: int) -> Array:
    """Return O5 of singular values (..., L)."""
    del n_poses
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sum(1.0 / values, axis=-1))


INDICES: dict[str, Callable[[Array, int], Array]] = {
    "O1": compute_o1,
    "O2": compute_o2,
    "O3": compute_o3,
    "O4": compute_o4,
    "O5": compute_o5,
}


def compute_observability(jacobian: Array) -> dict[str, Array]:
    """Return the five indices of sets of poses.

    Parameters
    ----------
    jacobian : ndarray, shape (..., n, k, L)
        J_b of each of n poses, mm and rad by the parameters' units.

    Returns
    -------
    dict of name to ndarray, shape (...)
        Zero where there are fewer rows than parameters.
    """
    values = singular_values(jacobian.reshape(*jacobian.shape[:-3], -1, jacobian.shape[-1]))
    return {name: index(values, jacobian.shape[-3]) for name, index in INDICES.items()}


def singular_values(rows: Array) -> Array:
    """Return all L singular values of rows (..., R, L), largest first, zeros where R is below L."""
    values = np.linalg.svd(rows, compute_uv=False)
    missing = rows.shape[-1] - values.shape[-1]
    return np.concatenate([values, np.zeros((*values.shape[:-1], missing))], axis=-1)
