"""Rigid motions of base and tool, which a best fit takes out of errors of the tool.

Whoever uses a machine sets up its table and its tool: where the base frame lies in space, and the tool frame on the
platform, is a convention that no measurement of the machine's motion knows. Accuracy relative to what is physically
there is what remains of an error after a best fit of six numbers of the base frame, and of six of the tool frame where
the tool is said to turn. It does not depend on which parameters are taken to define the frames. A tool of two lengths
has motions in its plane; one without lengths has none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector, skew_matrix

LEAST = 0.05
"""Rms of a motion of 1 mm over the workspace, in mm, below which nobody would notice it when aligning: where a
workspace hardly turns the tool, its offset is no other motion than a shift of the base."""
MIN_WORKSPACE_MM = 1e-3  # mm, least size of a workspace, by which turns are compared with shifts


@dataclass(frozen=True, eq=False)
class Alignment:
    """Rigid motions of base and tool, the same at all W poses, as errors of the tool.

    ``motions`` (W t, f): f independent ones, in the units of the tool's t numbers; ``fits`` (f, W t): how much of each
    an error has, by least squares over the poses, turns weighed by the workspace's size. ``model``, ``centre`` (3,),
    ``size`` and ``mixed`` (12, f) make the same motions at other poses.
    """

    motions: Array
    fits: Array
    model: ReadingModel
    centre: Array
    size: float
    mixed: Array

    def fit(self, error: Array) -> Array:
        """Return how much of each motion errors (W, t, m) of the tool have, (f, m)."""
        return np.asarray(self.fits @ error.reshape(len(self.motions), -1))

    def remove(self, error: Array) -> Array:
        """Return errors (W, t, m) of the tool without what the motions explain."""
        flat = error.reshape(len(self.motions), -1)
        return np.asarray((flat - self.motions @ self.fit(error)).reshape(error.shape))

    def at(self, place: Array, pose: Array) -> Array:
        """Return the motions at other poses (P, q), the tool at ``place`` (P, t), as errors there, (P, t, f)."""
        fields, scale = _list_fields(self.model, place, pose, self.centre, self.size)
        return np.asarray(fields @ self.mixed / scale[:, None])


def find_alignment(model: ReadingModel, place: Array, pose: Array) -> Alignment:
    """Return the motions at poses (W, q) for a machine that says where its tool is, ``place`` (W, t).

    Of the tool there are some where it says how that is turned.
    """
    lengths = model.tool_lengths
    centre = np.zeros(3)
    centre[: len(lengths)] = place[:, lengths].mean(axis=0)
    away = place[:, lengths] - centre[: len(lengths)]
    size = max(float(np.sqrt((away**2).sum(axis=1).mean())), MIN_WORKSPACE_MM)
    fields, scale = _list_fields(model, place, pose, centre, size)
    n = len(place)
    basis, visible, turned = np.linalg.svd(fields.reshape(place.size, 12) / np.sqrt(n), full_matrices=False)
    chosen = visible >= LEAST
    basis, every = basis[:, chosen], np.tile(scale, n)[:, None]
    mixed = (turned[chosen] / visible[chosen, None]).T / np.sqrt(n)
    return Alignment(basis / every, (basis * every).T, model, centre, size, mixed)


def _list_fields(model: ReadingModel, place: Array, pose: Array, centre: Array, size: float) -> tuple[Array, Array]:
    """Return 12 motions as errors of the tool, (P, t, 12), turns times size, and the factors that did it, (t,).

    Shifts and turns of the base about ``centre``, then of the tool.
    """
    n, lengths, turned = len(place), model.tool_lengths, model.tool_turned
    position = np.tile(centre, (n, 1))
    position[:, : len(lengths)] = place[:, lengths]
    fields = np.zeros((n, 6, 12))
    fields[:, :3, :3] = fields[:, 3:, 3:6] = np.eye(3)
    fields[:, :3, 3:6] = -skew_matrix((position - centre) / size)
    if model.tells_rotation:
        rotation = matrix_from_rotation_vector(place[:, turned]) if turned else model.rotation_in_space(pose)
        fields[:, :3, 6:9] = fields[:, 3:, 9:] = rotation
    scale, seen = np.ones(place.shape[1]), np.zeros((*place.shape, 12))
    scale[turned] = size
    seen[:, lengths + turned] = fields[:, [*range(len(lengths)), *range(3, 3 + len(turned))]]
    return seen, scale
