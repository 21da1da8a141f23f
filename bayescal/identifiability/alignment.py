"""What aligning base and tool anew mends: one rigid motion of each, the same at all poses.

A machine that its own sensors calibrate has the frames that its joints define. Whoever uses it sets up table and tool
afterwards, so that an error of the tool which a motion of base or tool explains over the whole workspace is none of the
calibration's. What remains does not depend on which parameters are taken to define the frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector, skew_matrix

LEAST = 0.05
"""Rms of a motion of 1 mm over the workspace, in mm, below which nobody would notice it when aligning: where a
workspace hardly turns the tool, its offset is no other motion than a shift of the base."""
SMALLEST = 1e-3  # mm, least size of a workspace, by which turns are compared with shifts


@dataclass(frozen=True, eq=False)
class Alignment:
    """Rigid motions of base and tool as errors of the tool at W poses.

    ``motions`` (W t, f): f independent ones, in the units of the tool's t numbers; ``fits`` (f, W t): how much of each
    an error has, by least squares over the poses, turns weighed by the workspace's size.
    """

    motions: Array
    fits: Array

    def remove(self, error: Array) -> Array:
        """Return errors (W, t, m) of the tool without what the motions explain."""
        flat = error.reshape(len(self.motions), -1)
        return np.asarray((flat - self.motions @ (self.fits @ flat)).reshape(error.shape))


def find_alignment(model: ReadingModel, place: Array, pose: Array) -> Alignment:
    """Return the motions for a machine that says where its tool is; of the tool where it says how that is turned.

    Parameters
    ----------
    model : ReadingModel
    place : ndarray, shape (W, t)
        The tool's numbers.
    pose : ndarray, shape (W, q)
    """
    n, lengths, turned = len(place), model.tool_lengths, model.tool_turned
    position = np.zeros((n, 3))
    position[:, : len(lengths)] = place[:, lengths]
    away = position - position.mean(axis=0)
    size = max(float(np.sqrt((away**2).sum(axis=1).mean())), SMALLEST)
    fields = np.zeros((n, 6, 12))  # of position and turn times size, by shifts and turns of the base, then of the tool
    fields[:, :3, :3] = fields[:, 3:, 3:6] = np.eye(3)
    fields[:, :3, 3:6] = -skew_matrix(away / size)
    if model.tells_rotation:
        rotation = matrix_from_rotation_vector(place[:, turned]) if turned else model.rotation_in_space(pose)
        fields[:, :3, 6:9] = fields[:, 3:, 9:] = rotation
    scale, seen = np.ones(place.shape[1]), np.zeros((*place.shape, 12))
    scale[turned] = size
    seen[:, lengths + turned] = fields[:, [*range(len(lengths)), *range(3, 3 + len(turned))]]
    basis, visible, _ = np.linalg.svd(seen.reshape(place.size, 12) / np.sqrt(n), full_matrices=False)
    basis, scale = basis[:, visible >= LEAST], np.tile(scale, n)[:, None]
    return Alignment(basis / scale, (basis * scale).T)
