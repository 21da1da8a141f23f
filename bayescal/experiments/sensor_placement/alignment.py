"""What setting up a machine mends: one motion of its table and one offset of its tool, the same at all poses.

What a machine knows of itself from its own sensors is the same wherever its base stands and wherever on the platform
its tool sits. Table and tool are set up once; an error of the tool's centre that a motion of the table or an offset of
the tool explains over the whole workspace is none of the calibration's. What remains does not depend on which points
were taken to define the frames.
"""

from __future__ import annotations

import numpy as np

from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array, skew_matrix

LEAST = 0.05  # rms of a motion of 1 mm over the workspace, in mm, below which nobody would notice it when setting up
TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


def alignment_basis(model: ReadingModel, position: Array, pose: Array, rank: int | None = None) -> Array:
    """Return orthonormal fields of the tool's centre that setting up can take away.

    Parameters
    ----------
    model : ReadingModel
    position : ndarray, shape (..., W, m)
        The tool's centre, mm, base frame.
    pose : ndarray, shape (W, q)
    rank : int, optional
        How many of the fields, the most visible ones; by default those that move the tool by 1/20 of the motion: where
        a workspace hardly turns the platform, an offset of the tool cannot be told from a shift of the table.

    Returns
    -------
    ndarray, shape (..., W m, f)
    """
    n, m = position.shape[-2:]
    away = position - position.mean(axis=-2, keepdims=True)
    away = away / np.sqrt(np.mean(np.sum(away**2, axis=-1), axis=-1))[..., None, None]
    turned = (away @ TURN.T)[..., None] if m == 2 else -skew_matrix(away)
    shape = (*position.shape, m)
    shift = np.broadcast_to(np.eye(m), shape)
    offset = np.broadcast_to(model.rotation(pose), shape)
    fields = np.concatenate([shift, turned, offset], axis=-1).reshape(*position.shape[:-2], n * m, -1)
    left, visible, _ = np.linalg.svd(fields / np.sqrt(n), full_matrices=False)
    return left[..., : int((visible >= LEAST).sum()) if rank is None else rank]


def take_away(basis: Array, field: Array) -> Array:
    """Return fields (..., W m, k) without what setting up takes away, for a basis (..., W m, f)."""
    return np.asarray(field - basis @ (np.swapaxes(basis, -1, -2) @ field))
