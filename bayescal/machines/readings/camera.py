"""A camera and a calibration board, one of them on the tool: poses of the board as the camera sees it.

OpenCV's ``solvePnP`` returns them: ``tvec`` and ``rvec`` of the board's frame in the camera's. With the tool at T, what
is fixed at F in the base frame and what is at X on the tool, a fixed camera (eye to hand) sees F⁻¹ T X, one on
the tool (eye in hand) the inverse. Neither F nor X is known; they follow from A X = Z B.

The unit of ``tvec`` is the square of the board. Where squares are larger than was stated by a share κ, it reads
1 / (1 + κ) of the distance. With κ free an arm's lengths and both frames may grow alike: the scale is known by
tolerances, or from elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from pydantic import Field

from bayescal.config.sections import Vector
from bayescal.errors import InputError
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.closed_forms import is_mirrored
from bayescal.machines.readings.function import Parameters
from bayescal.machines.readings.instrument import turn
from bayescal.machines.readings.points import PoseConfig, PoseInstrument
from bayescal.numerics.analytic import rotation_matrix
from bayescal.numerics.geometry import Array

LEAST_ROWS = 3


class CameraConfig(PoseConfig):
    """A camera that sees a calibration board: one of them on the tool, the other fixed."""

    mounted: Literal["base", "tool"]
    """Where the camera is: fixed (`base`, eye to hand), or on the tool (`tool`, eye in hand)."""
    frame_mm: Vector | None = None
    """Where the frame of what is fixed has its origin, base frame; a study finds it where nothing is said."""
    frame_deg: Vector | None = None
    """Rotation vector that turns the base's axes to its axes; a study finds it where nothing is said."""
    target_mm: Vector | Literal["found"] | None = "found"
    """Where the frame of what is on the tool has its origin, tool frame; a study finds it where nothing is said."""
    target_deg: Vector | Literal["found"] = Field(default="found")
    """Rotation vector that turns the tool's axes to its axes; a study finds it where nothing is said."""


class CameraInstrument(PoseInstrument):
    """A camera: position and rotation vector of a calibration board in the camera's frame."""

    Config = CameraConfig  # type: ignore[assignment]  # has a key that has to be stated

    def __init__(self, config: CameraConfig) -> None:
        """Lay out both frames, and by which share the board's squares are larger than stated."""
        super().__init__(config)
        self.on_tool = config.mounted == "tool"
        self.parameters = [*self.parameters, ParameterBlock("scale", (0.0,), "1", per_leg=False)]

    def see(self, parameters: Parameters, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Return the board's pose in the camera's frame."""
        seen = super().see(parameters, position, rotation)
        place, vector = self._invert(seen) if self.on_tool else (seen[..., :3], seen[..., 3:])
        parts = np.broadcast_arrays(place / (1.0 + parameters["scale"][..., None]), vector)
        return np.concatenate(parts, axis=-1)

    @staticmethod
    def _invert(seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return position and rotation vector of inverse poses (..., 6)."""
        return turn(np.swapaxes(rotation_matrix(seen[..., 3:]), -1, -2), -seen[..., :3]), -seen[..., 3:]

    def propose(
        self, stated: Mapping[str, Array], seen: Array, position: Array, rotation: Array
    ) -> Sequence[Mapping[str, Array]]:
        """Return frames that fit best, those of a camera on the tool by the inverse poses; see `PoseInstrument`."""
        whole = int(np.isfinite(seen).all(axis=1).sum())
        if whole < LEAST_ROWS:
            raise InputError(f"found {whole} rows with position and rotation of the board, expected {LEAST_ROWS}")
        poses = np.concatenate([seen[:, :3] * (1.0 + stated["scale"]), seen[:, 3:]], axis=1)
        if self.on_tool:
            poses = np.concatenate(self._invert(poses), axis=1)
        return super().propose(stated, poses, position, rotation)

    def find_mirrored(self, seen: Array, position: Array, rotation: Array) -> bool:
        """Return whether positions of the board fit a left-handed camera alone; see `Instrument.find_mirrored`."""
        if self.on_tool:
            return is_mirrored(position, rotation, seen[:, :3], self.on_tool)
        return super().find_mirrored(seen, position, rotation)
