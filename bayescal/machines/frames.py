"""Frames that are not known: where the instrument's frame lies against the base, and the tool against the platform.

A measured pose is T = T_base T_platform(θ, ρ) T_tool. Each frame has six parameters, a displacement and a rotation
vector, nominally zero. Where the frames and the joints are all free, moving a frame and the joints with it changes no
measurement: six gauge freedoms a frame.
"""

from __future__ import annotations

import numpy as np

from bayescal.machines.parameters import ParameterBlock
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector

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
