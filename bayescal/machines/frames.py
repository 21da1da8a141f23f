"""Frames that are not known: where the instrument's frame lies against the base, and the tool against the platform.

A measured pose is T = T_base T_platform(θ, ρ) T_tool. Each frame has six parameters, a displacement and a rotation
vector, nominally zero. Where the frames and the joints are all free, moving a frame and the joints with it changes no
measurement: six gauge freedoms a frame.
"""

from __future__ import annotations

import numpy as np

from bayescal.machines.parameters import ParameterBlock
from bayescal.numerics.geometry import Array, compute_left_inverse_jacobian, matrix_from_rotation_vector, skew_matrix

AXES = ("x", "y", "z")


def frame_symbols(frame: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the symbols of a frame's displacement and of its rotation vector."""
    return tuple(f"{frame}_{axis}" for axis in AXES), tuple(f"{frame}_r{axis}" for axis in AXES)


def name_frames(n_stations: int) -> tuple[str, ...]:
    """Return the names of all frames: ``base`` of one instrument, ``base1`` ... of several stations, then the tool."""
    bases = ("base",) if n_stations == 1 else tuple(f"base{station}" for station in range(1, n_stations + 1))
    return (*bases, "tool")


def frame_blocks(n_stations: int) -> tuple[ParameterBlock, ...]:
    """Return the parameters of all frames, six of each, in the order of `name_frames`."""
    return tuple(
        ParameterBlock(symbol, (0.0,), unit, per_leg=False)
        for frame in name_frames(n_stations)
        for symbols, unit in zip(frame_symbols(frame), ("mm", "rad"), strict=True)
        for symbol in symbols
    )


def move_frames(values: Array, position: Array, rotation: Array) -> tuple[Array, Array]:
    """Return poses as the instrument sees them, (..., P, 3) and (..., P, 3, 3), for frame parameters (..., 12)."""
    base, tool = values[..., None, :6], values[..., None, 6:]
    turn = matrix_from_rotation_vector(base[..., 3:])
    seen = np.einsum("...ij,...j->...i", rotation, tool[..., :3]) + position
    turned = turn @ rotation @ matrix_from_rotation_vector(tool[..., 3:])
    return base[..., :3] + np.einsum("...ij,...j->...i", turn, seen), turned


def measured_pose_slopes(values: Array, position: Array, rotation: Array) -> tuple[Array, Array]:
    """Return the derivatives of the measured pose by the platform's pose and by the frame parameters, anywhere.

    Parameters
    ----------
    values : ndarray, shape (..., 12)
        Frame parameters, mm and rad.
    position, rotation : ndarray, shapes (..., P, 3) and (..., P, 3, 3)
        Poses of the platform, mm.

    Returns
    -------
    by_pose, by_frames : ndarray, shapes (..., P, 6, 6) and (..., P, 6, 12)
        Poses on both sides as displacement and rotation vector of a rotation applied from the left.
    """
    base, tool = values[..., None, :6], values[..., None, 6:]
    turn = matrix_from_rotation_vector(base[..., 3:])
    base_turn, tool_turn = (np.linalg.inv(compute_left_inverse_jacobian(frame[..., 3:])) for frame in (base, tool))
    arm = np.einsum("...ij,...j->...i", rotation, tool[..., :3])
    turn = np.broadcast_to(turn, rotation.shape)
    zero = np.zeros_like(rotation)
    by_pose = np.block([[turn, -turn @ skew_matrix(arm)], [zero, turn]])
    seen = np.einsum("...ij,...j->...i", turn, position + arm)
    base_turn = np.broadcast_to(base_turn, rotation.shape)
    eye, turned = np.broadcast_to(np.eye(3), rotation.shape), turn @ rotation
    by_base = np.block([[eye, -skew_matrix(seen) @ base_turn], [zero, base_turn]])
    by_tool = np.block([[turned, zero], [zero, turned @ tool_turn]])
    return by_pose, np.concatenate([by_base, by_tool], axis=-1)
