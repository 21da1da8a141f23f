"""Frames and points in closed form, from what an instrument read where the tool was: initial values of least squares.

Points s_i in an instrument's frame of axes R and origin o, of p_i in the base frame: p = o + R s, whose best rotation
is Kabsch's (Acta Cryst. A32, 1976). Poses A_i = Z⁻¹ B_i X of a frame X on the tool: R_Z R_A = R_B R_X is linear in both
rotations (Li, Wang and Wu, Int. J. Phys. Sci. 5, 2010), and so are positions then. Distances: |p - a|² is linear in the
anchor a, in the zero and in one number more. A point t of tools (p, R) that touches a plane of normal n,
n·(p + R t) = d, is linear in n, in the nine products n tᵀ and in d.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.numerics.geometry import Array, rotation_vector_from_matrix

FLAT = 0.02  # of the largest extent of points, below which these lie in a plane: no frame is left- or right-handed then
MIRRORED = 5.0  # times smaller residuals by which a left-handed frame has to fit better to be the only one that fits
OUTLYING = 6.0  # times the median residual, beyond which a point is left out
ROUNDS = 3
RANK = 1e-6  # of the largest singular value, below which both rotations of A X = Z B are not determined
SHEARED = 1.2  # ratio of singular values, below which axes that need not be orthogonal are

type Frame = tuple[Array, Array]
"""Position (3,) and axes (3, 3)."""


def vector_of(matrix: Array) -> Array:
    """Return the rotation vector (3,) of the rotation that is nearest to a matrix (3, 3)."""
    return np.asarray(rotation_vector_from_matrix(_orthogonalise(matrix)))


def _orthogonalise(matrix: Array) -> Array:
    left, _, right = np.linalg.svd(np.nan_to_num(matrix))
    return np.asarray(left * [1.0, 1.0, np.linalg.det(left @ right)] @ right)


def list_turns(vector: Array) -> list[Array]:
    """Return a rotation vector (3,) turned by the 24 rotations of a cube, itself the first."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        turn = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(turn) > 0.0:
            found.append((Rotation.from_rotvec(vector) * Rotation.from_matrix(turn)).as_rotvec())
    return found


def fit_point_frame(points: Array, seen: Array) -> tuple[Frame, bool]:
    """Return the frame in which points (P, 3) are seen (P, 3), and whether only its mirror image fits.

    Points that are not seen whole are left out, and outlying ones.
    """
    there = np.isfinite(points).all(axis=1) & np.isfinite(seen).all(axis=1)
    points, seen = points[there], seen[there]
    if len(points) < 3:
        return (np.zeros(3), np.eye(3)), False
    used = np.ones(len(points), dtype=bool)
    for _ in range(ROUNDS):
        position, axes = _fit(points[used], seen[used])
        left = np.linalg.norm(points - position - seen @ axes.T, axis=1)
        used = left <= OUTLYING * max(float(np.median(left)), 1e-9)
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if len(points) < 5 or extent[-1] < FLAT * extent[0]:
        return (position, axes), False
    mirror = seen * [-1.0, 1.0, 1.0]
    place, turned = _fit(points, mirror)
    other = np.linalg.norm(points - place - mirror @ turned.T, axis=1)
    return (position, axes), bool(np.median(left) > MIRRORED * np.median(other))


def _fit(points: Array, seen: Array) -> Frame:
    middle, own = points.mean(axis=0), seen.mean(axis=0)
    axes = _orthogonalise((points - middle).T @ (seen - own))
    return middle - axes @ own, axes


def fit_turned_frame(points: Array, rotation: Array, seen: Array, turned: Array) -> Frame:
    """Return the frame of poses seen, by their axes: rotations (P, 3, 3) in the base frame are seen (P, 3, 3)."""
    axes = _orthogonalise(np.nansum(rotation @ np.swapaxes(turned, 1, 2), axis=0))
    there = np.isfinite(points).all(axis=1) & np.isfinite(seen).all(axis=1)
    away = (points - seen @ axes.T)[there]
    return (np.median(away, axis=0) if len(away) else np.zeros(3)), axes


def fit_hand_eye(position: Array, rotation: Array, seen: Array, turned: Array) -> tuple[Frame, Frame] | None:
    """Return the frames of an instrument and on the tool that fit poses, by the tool's in the base frame and as seen.

    Positions are (P, 3), rotations (P, 3, 3). None where the tool turns too little to determine both.
    """
    there = np.isfinite(seen).all(axis=1) & np.isfinite(turned).all(axis=(1, 2)) & np.isfinite(position).all(axis=1)
    position, rotation, seen, turned = (one[there] for one in (position, rotation, seen, turned))
    if len(seen) < 3:
        return None
    eye = np.eye(3)
    # R_Z R_A - R_B R_X = 0 in the rows of both unknown matrices
    rows = [np.hstack([np.kron(eye, a.T), -np.kron(b, eye)]) for a, b in zip(turned, rotation, strict=True)]
    _, values, right = np.linalg.svd(np.concatenate(rows), full_matrices=False)
    if values[-2] < RANK * values[0]:
        return None
    first, second = right[-1].reshape(2, 3, 3)
    sign = np.sign(np.linalg.det(first))
    axes, own = _orthogonalise(sign * first), _orthogonalise(sign * second)
    place, target = fit_places(position, rotation, seen, axes)
    return (place, axes), (target, own)


def fit_places(position: Array, rotation: Array, seen: Array, axes: Array) -> tuple[Array, Array]:
    """Return an instrument's origin (3,) and its target's place (3,), of known axes: o + R_Z s = p + R_B t."""
    there = np.isfinite(seen).all(axis=1) & np.isfinite(position).all(axis=1)
    rows = [np.hstack([np.eye(3), -b]) for b in rotation[there]]
    side = (position - seen @ axes.T)[there]
    found = np.linalg.lstsq(np.concatenate(rows), side.ravel(), rcond=1e-9)[0] if len(rows) else np.zeros(6)
    return found[:3], found[3:]


def is_mirrored(position: Array, rotation: Array, seen: Array, on_tool: bool) -> bool:
    """Return whether points seen (P, 3) fit a left-handed frame: p + R t = o + A s, any A, has orthogonal axes of one.

    With ``on_tool`` the instrument is on the tool and sees a point that stands still, p + R (t + A s) = o.
    """
    there = np.isfinite(seen).all(axis=1) & np.isfinite(position).all(axis=1)
    position, rotation, seen = (one[there] for one in (position, rotation, seen))
    rows = [
        np.hstack([np.eye(3), -b, np.kron(-b if on_tool else np.eye(3), s)])
        for b, s in zip(rotation, seen, strict=True)
    ]
    if len(rows) < 6:
        return False
    found, _, rank, _ = np.linalg.lstsq(np.concatenate(rows), position.ravel(), rcond=RANK)
    axes = found[6:].reshape(3, 3)
    sizes = np.linalg.svd(axes, compute_uv=False)
    return bool(rank == len(found) and sizes[0] < SHEARED * sizes[2] and np.linalg.det(axes) < 0.0)


def fit_plane(points: Array) -> list[Array]:
    """Return the unit normal, either side, and the offset (4,) of the plane n·p = d of points (P, 3), if it is one."""
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 3:
        return []
    middle = points.mean(axis=0)
    _, extent, axes = np.linalg.svd(points - middle)
    if extent[1] <= RANK * extent[0]:
        return []
    return [np.append(axes[2], axes[2] @ middle)]


def fit_plane_and_tip(position: Array, rotation: Array) -> list[Array]:
    """Return unit normals, either side, offset and tip on the tool (7,) of a plane that tools' tips touch.

    Tools are at (P, 3), turned by (P, 3, 3). One is that of tools which turn little, ω about the mean, where
    n·R t = n·t + (t × n)·ω tells the tip across the normal; the other of any turns, where they tell all of it.
    """
    there = np.isfinite(position).all(axis=1)
    position, rotation = position[there], rotation[there]
    if len(position) < 7:
        return []
    middle, size = position.mean(axis=0), np.ptp(position, axis=0).max()
    mean = _orthogonalise(rotation.sum(axis=0))
    own, one, found = (position - middle) / size, np.ones((len(position), 1)), list[Array]()
    for turned in (rotation_vector_from_matrix(rotation @ mean.T), rotation.reshape(-1, 9)):
        rows = np.hstack([own, turned, one])
        _, values, right = np.linalg.svd(rows, full_matrices=False)
        long = float(np.linalg.norm(right[-1, :3])) / size
        if len(values) < rows.shape[1] or values[-2] < RANK * values[0] or long == 0.0:
            continue
        normal, products, rest = right[-1, :3] / size / long, right[-1, 3:-1] / long, right[-1, -1] / long
        if len(products) == 3:
            tip = mean.T @ np.cross(normal, products)
            rest -= normal @ mean @ tip
        else:
            tip = normal @ products.reshape(3, 3)
        found.append(np.array([*normal, normal @ middle - rest, *tip]))
    return found


def fit_anchor(points: Array, distance: Array, with_zero: bool) -> list[Array]:
    """Return the anchor (3,) of distances (P,) to points (P, 3), with a zero behind it (4,); both sides of a plane."""
    there = np.isfinite(points).all(axis=1) & np.isfinite(distance)
    points, distance = points[there], distance[there]
    if len(points) < 4 + with_zero:
        return []
    middle = points.mean(axis=0)
    own = points - middle
    extent, axes = np.linalg.svd(own, full_matrices=False)[1:]
    # d² + 2 d z + z² = |p|² - 2 p·a + |a|², d the reading
    columns = [2.0 * own, np.ones((len(own), 1)), *([2.0 * distance[:, None]] if with_zero else [])]
    side = np.square(own).sum(axis=1) - distance**2
    found = np.linalg.lstsq(np.hstack(columns), side, rcond=1e-9)[0]
    anchor, zero = found[:3], found[4:]
    if extent[-1] >= FLAT * extent[0]:
        return [np.concatenate([middle + anchor, zero])]
    # points of a plane do not tell how far off it the anchor is, but by the length
    size = distance + (zero[0] if with_zero else 0.0)
    along = anchor - (anchor @ axes[-1]) * axes[-1]
    height = np.sqrt(max(float(np.median(size**2 - np.square(own - along).sum(axis=1))), 0.0))
    return [np.concatenate([middle + along + side * height * axes[-1], zero]) for side in (1.0, -1.0)]
