"""Errors that a named cause makes, as few columns: lead errors, joints that err by squares of the tilt, loads.

Sorts of functions (`bayescal.density.pose_kernels`) take part in every posterior by default; these do not. They are
tried beside the sorts when a cause is to be named, as directions that the geometry lacks: coefficients c ~ N(0, s²) of

    lead      of each actuator by itself, linear in its own position
    joints    of each actuator by itself, squares and products of the pose's angles; of its coordinates without angles
    gravity   of all actuators alike, linear and quadratic in the pose
"""

from __future__ import annotations

from typing import Final

import numpy as np

from bayescal.numerics.geometry import Array

LEAD: Final = "lead"
JOINTS: Final = "joints"
GRAVITY: Final = "gravity"
CAUSES: Final = (LEAD, JOINTS, GRAVITY)
MOST_CROSSED: Final = 3  # coordinates, with more of which joints have squares alone: products would be too many columns


def list_directions(cause: str, place: Array, angles: np.ndarray, travel: Array) -> Array | None:
    """Return what coefficients of size one do to N actuators at P poses, mm at the tool, shape (P, N, A).

    Parameters
    ----------
    cause : str
        Of `CAUSES`.
    place : ndarray, shape (P, q)
        Poses from home.
    angles : ndarray of bool, shape (q,)
        Which coordinates are angles.
    travel : ndarray, shape (P, N)
        Positions of the N actuators from home, zero for those whose lead errors are parameters.

    Returns
    -------
    ndarray or None
        Their squares, summed over the columns, have a mean of one over poses and actuators, so that the coefficients'
        size is a root mean square. None where poses do not differ, or are not known.
    """
    n = travel.shape[1]
    if cause == LEAD:
        found = np.einsum("pi,ij->pij", travel, np.eye(n))[..., travel.any(axis=0)]
        return _scale(found) if found.any() else None
    moved = np.isfinite(place).all() & (np.ptp(place, axis=0) > 0.0)
    if cause == JOINTS and (moved & angles).any():
        moved = moved & angles
    if not moved.any():
        return None
    place = place[:, moved] / np.abs(place[:, moved]).max(axis=0)
    first, second = np.triu_indices(place.shape[1])
    if cause == JOINTS and place.shape[1] > MOST_CROSSED:
        first = second = np.arange(place.shape[1])
    squares = place[:, first] * place[:, second]
    if cause == JOINTS:
        found = np.einsum("pa,ij->piaj", squares, np.eye(n)).reshape(len(place), n, -1)
    else:
        found = np.repeat(np.concatenate([place, squares], axis=1)[:, None], n, axis=1)
    return _scale(found)


def _scale(columns: Array) -> Array:
    """Return columns (P, N, A) whose squares, summed over A, have a mean of one."""
    return np.asarray(columns / np.sqrt(np.mean(np.sum(columns**2, axis=-1))))
