"""Pose of an elongated body from the straight line through its targets.

The first method of RR-8096 section 3.1: it uses the shape of the body instead of matching every target to its place,
and is kept for the comparison with the robust fit (RR-8096 figure 5). It has no defence against wrong targets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayescal.data.photogrammetry.rigid_fit import MIN_SPREAD, RigidFit, check_targets
from bayescal.errors import PoseInputError
from bayescal.numerics.geometry import Array, skew_matrix


@dataclass(frozen=True, eq=False)
class _Frame:
    """Frames attached to the lines of clouds of targets, with what their first-order propagation needs."""

    centre: Array  # (P, 3): barycentre of the seen targets, mm
    axes: Array  # (P, 3, 3): columns x, y, z
    # (P, 3, 3): principal directions of the scatter matrix as columns, and their sums of squares in mm², ascending
    vectors: Array
    values: Array  # (P, 3)
    offset: Array  # (P, n, 3): targets from the barycentre, mm; zero where not seen
    far: NDArray[np.int64]  # (P,): target that fixes x


def _build_frame(
    points: Array, seen: NDArray[np.bool_], order: Array | None = None, far: NDArray[np.int64] | None = None
) -> _Frame:
    """Return the frames of clouds (P, n, 3); ``order`` (P, n) and ``far`` (P,) are those of the reference, if given."""
    share = seen[..., None] / seen.sum(axis=-1)[:, None, None]
    centre = np.sum(share * np.where(seen[..., None], points, 0.0), axis=-2)
    offset = np.where(seen[..., None], points - centre[:, None], 0.0)
    values, vectors = np.linalg.eigh(np.swapaxes(offset, -1, -2) @ offset)
    z = vectors[..., 2]
    along = np.einsum("pni,pi->pn", offset, z)
    if order is not None:
        sign = np.where(np.sum(order * along, axis=-1) < 0, -1.0, 1.0)
        z, along = sign[:, None] * z, sign[:, None] * along
    radial = offset - along[..., None] * z[:, None]
    if far is None:
        far = np.argmax(np.linalg.norm(radial, axis=-1), axis=-1)
    x = radial[np.arange(len(far)), far]
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    axes = np.stack([x, np.cross(z, x), z], axis=-1)
    return _Frame(centre, axes, vectors, values, offset, far)


def _propagate_noise(frame: _Frame, seen: NDArray[np.bool_], noise: float) -> Array:
    """Return the covariance (P, 6, 6) of barycentre error and rotation vector of measured frames, to first order.

    With offsets a_i from the barycentre and scatter S = Σ a_i a_i^T, a displacement δ_i of target i changes the line by
    ``dz = Σ_k v_k v_k^T (δ_i a_i·z + a_i δ_i·z) / (λ_z - λ_k)`` over the two other principal directions, and x by the
    part of ``δ_far - dc - dz (a_far·z)`` along y over the distance of the far target. The rotation vector is
    ``z × dz + z (y · dx)``.
    """
    n_fits, n_targets = seen.shape
    row = np.arange(n_fits)
    x, y, z = np.moveaxis(frame.axes, -1, 0)
    gain = 1 / (frame.values[:, 2:] - frame.values[:, :2])
    project = np.einsum("pik,pk,pjk->pij", frame.vectors[..., :2], gain, frame.vectors[..., :2])
    along = np.einsum("pni,pi->pn", frame.offset, z)
    identity = np.eye(3)
    dz = along[..., None, None] * project[:, None] + np.einsum("pij,pnj,pk->pnik", project, frame.offset, z)
    dz = dz * seen[..., None, None]
    dc = (seen / seen.sum(axis=-1, keepdims=True))[..., None, None] * identity
    dfar = -dc
    dfar[row, frame.far] += identity
    arm = np.einsum("pi,pi->p", frame.offset[row, frame.far], x)
    swing = np.einsum("pi,pnik->pnk", y, dfar - dz * along[row, frame.far][:, None, None, None])
    turn = np.cross(z[:, None, None], np.swapaxes(dz, -1, -2))
    turn = np.swapaxes(turn, -1, -2) + z[:, None, :, None] * (swing / arm[:, None, None])[:, :, None, :]
    jacobian = np.concatenate([dc, turn], axis=-2)  # (P, n, 6, 3)
    jacobian = np.swapaxes(jacobian, 1, 2).reshape(n_fits, 6, 3 * n_targets)
    return noise**2 * jacobian @ np.swapaxes(jacobian, -1, -2)


def _check_shape(frame: _Frame, noise: float) -> None:
    """Refuse reference targets without one longest direction, or with none well off their line."""
    spread = np.sqrt(np.maximum(frame.values, 0))
    excess = spread[:, 2] - spread[:, 1]
    least = np.maximum(MIN_SPREAD * noise, 1e-6 * spread[:, 2])
    if np.any(excess < least):
        fit = int(np.argmax(excess < least))
        raise PoseInputError(
            fit,
            f"found targets {excess[fit]:.3g} mm longer than wide, expected at least {least[fit]:.3g} mm",
        )
    arm = np.einsum("pi,pi->p", frame.offset[np.arange(len(frame.far)), frame.far], frame.axes[..., 0])
    if np.any(arm < least):
        fit = int(np.argmax(arm < least))
        raise PoseInputError(
            fit,
            f"found no target farther than {arm[fit]:.3g} mm from the line, expected {least[fit]:.3g} mm",
        )


def fit_line(reference: ArrayLike, measured: ArrayLike, noise: float) -> RigidFit:
    """Return the pose of an elongated body from the line of least squared distances (RR-8096 section 3.1, method 1).

    The line gives z and the barycentre of the targets the position. RR-8096 takes x from the projection of the
    barycentre on the line; but the barycentre always lies on the line of least squared distances, so that this
    direction does not exist. Here x points from the line to the target that is farthest from it in the reference. The
    sign of z follows the order of the targets along the line of the reference. The pose is the measured frame times the
    inverse of the reference frame, both from the same seen targets.

    Arguments as of `fit_rigid_body`. The covariance is by first-order propagation of the noise; weights are 1 for seen
    targets and 0 for others. ``chi2`` is taken over seen targets; its mean exceeds ``dof``, since the pose is not that
    of least squares. InputError as `check_targets`, or where the seen targets have no single longest direction or none
    is well off their line.
    """
    reference, flat, seen = check_targets(reference, measured, noise)
    body = _build_frame(np.broadcast_to(reference, flat.shape), seen)
    _check_shape(body, noise)
    order = np.einsum("pni,pi->pn", body.offset, body.axes[..., 2])
    frame = _build_frame(flat, seen, order, body.far)
    rotation = frame.axes @ np.swapaxes(body.axes, -1, -2)
    lever = np.einsum("pij,pj->pi", rotation, body.centre)
    position = frame.centre - lever
    to_origin = np.broadcast_to(np.eye(6), (len(lever), 6, 6)).copy()
    to_origin[..., :3, 3:] = skew_matrix(lever)  # dp = dc - w × lever = dc + [lever]× w
    covariance = to_origin @ _propagate_noise(frame, seen, noise) @ np.swapaxes(to_origin, -1, -2)
    covariance = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
    fit = RigidFit.of_targets(reference, flat, (position, rotation), seen.astype(float), noise, covariance)
    return fit.with_batch(np.shape(measured)[:-2])
