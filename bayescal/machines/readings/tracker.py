"""An instrument whose frames are not known: where each station's frame lies, and that of the tool on the platform.

It sees T_base,s T T_tool, with T the platform's pose and the frames of `bayescal.machines.frames`, nominally zero: as a
pose, or as points on the tool.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayescal.machines.frames import AXES, frame_blocks, frame_symbols, name_frames
from bayescal.machines.readings.base import Channel
from bayescal.machines.readings.function import Parameters
from bayescal.machines.readings.placed import Instrument
from bayescal.numerics.analytic import rotation_matrix, rotation_vector
from bayescal.numerics.geometry import Array


class Tracker(Instrument):
    """What S stations see of the tool in frames of their own, a pose or points each.

    Parameters
    ----------
    stations : sequence of str
        Their names.
    seen : sequence of (int, ndarray or None)
        The station, and the point (3,) on the platform that it sees, mm; None for a pose.
    """

    def __init__(self, stations: Sequence[str], seen: Sequence[tuple[int, Array | None]]) -> None:
        """Lay out frames and channels."""
        super().__init__(None)
        self._seen = list(seen)
        self._frames = [frame_symbols(name) for name in name_frames(len(stations))]
        self.parameters = list(frame_blocks(len(stations)))
        self.channels = []
        for k, (_, point) in enumerate(self._seen):
            name = f"seen{k + 1}" if len(self._seen) > 1 else "seen"
            self.channels += [Channel(f"{name}[{axis}]", "mm") for axis in AXES]
            if point is None:
                self.channels += [Channel(f"{name}_r[{axis}]", "rad", rotation=f"{name}_r") for axis in AXES]

    def _frame(self, parameters: Parameters, k: int) -> tuple[Any, Any]:
        """Return position (..., 3) and rotation (..., 3, 3) of a frame."""
        moved, turned = self._frames[k]
        position, vector = (np.stack([parameters[one] for one in some], axis=-1) for some in (moved, turned))
        return position, rotation_matrix(vector)

    def see(self, parameters: Parameters, position: Any, rotation: Any) -> Any:
        """Return what each station sees, in the order of the channels."""
        offset, turn = self._frame(parameters, -1)
        tool, turned, found = position + _turn(rotation, offset), rotation @ turn, []
        for station, point in self._seen:
            place, frame = self._frame(parameters, station)
            at, way = place + _turn(frame, tool), frame @ turned
            found += [at, rotation_vector(way)] if point is None else [at + _turn(way, point)]
        return np.concatenate(np.broadcast_arrays(*found), axis=-1)


def _turn(rotation: Any, vector: Any) -> Any:
    return (rotation @ vector[..., None])[..., 0]
