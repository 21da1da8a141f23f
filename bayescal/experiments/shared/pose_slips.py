"""Slips of measured poses: rotations of another form or the other way round, axes of the other sign or exchanged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.data.instruments.rotations import FIXED, ROLL_PITCH_YAW, name_angles
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.numerics.geometry import Array, rotation_vector_from_matrix


def list_rereads(poses: MeasuredPoses) -> Iterator[tuple[str, MeasuredPoses]]:
    """Yield what may have happened to poses, in words, and the poses without it; their covariances stay as they are."""
    position, rotation = poses.position, poses.rotation
    vectors = rotation_vector_from_matrix(rotation)
    for axes in permutations(FIXED):
        order = [FIXED.index(axis) for axis in axes]
        turned = Rotation.from_euler("".join(axes), vectors[:, order]).as_matrix()
        yield _describe_angles("".join(axes)), replace(poses, rotation=turned)
    back = np.swapaxes(rotation, 1, 2)
    yield (
        "rotations seem to be those of the base seen from the platform, the other way round",
        replace(poses, rotation=back),
    )
    yield (
        "poses seem to be those of the base in the platform's frame",
        replace(poses, position=-np.einsum("pij,pj->pi", back, position), rotation=back),
    )
    for k, axis in enumerate(FIXED):
        yield f"{axis}_mm seems to be of the other sign", replace(poses, position=position * _flip(k))
    for one, other in combinations(range(3), 2):
        exchanged = position.copy()
        exchanged[:, [one, other]] = position[:, [other, one]]
        text = f"{FIXED[one]}_mm and {FIXED[other]}_mm seem to be exchanged"
        yield text, replace(poses, position=exchanged)


def _describe_angles(axes: str) -> str:
    columns = ROLL_PITCH_YAW if axes == FIXED else name_angles(axes)
    return (
        "rx_deg, ry_deg and rz_deg seem to be no rotation vectors but angles about the fixed axes "
        f"{', '.join(axes)} one after the other: call them {', '.join(columns)}"
        + ("" if axes == FIXED else ", in that order of axes")
    )


def _flip(k: int) -> Array:
    signs = np.ones(3)
    signs[k] = -1.0
    return signs
