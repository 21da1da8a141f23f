"""A ball on the tool in a socket that does not move: the machine's own joints are all that is read.

Whatever the joints, the ball's centre at t + R b stands at the socket's place c, so that

    ball = t + R b - c,    measured as zero,

in every row that was read with the ball in this socket. Where it stands nobody has to know: it is found with the
machine; the readings are by how much its tool's centre scatters about the socket. How far two sockets are apart
is kept as a check, or stated by their places: without it the machine's scale is known by its tolerances alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np

from bayescal.config.sections import Section, Vector
from bayescal.machines.readings.base import Channel
from bayescal.machines.readings.function import Parameters
from bayescal.machines.readings.instrument import Instrument, find_target, list_points
from bayescal.numerics.geometry import Array

AXES: Final = ("x", "y", "z")


class SocketConfig(Section):
    """A socket in which a ball on the tool sits."""

    place_mm: Vector | None = None
    """Where the ball's centre is in the socket, base frame; a study finds it where nothing is said."""
    target_mm: Vector | Literal["found"] | None = None
    """Where the ball's centre is on the tool, tool frame; at the tool's centre where nothing is said. `"found"`: a
    study finds it.
    """


class SocketInstrument(Instrument):
    """A socket of a ball: by how much its centre is off the socket's place, along the axes of the base."""

    Config = SocketConfig
    touches = True

    def __init__(self, config: SocketConfig) -> None:
        """Lay out the place and the ball on the tool."""
        super().__init__(config)
        self.parameters = [*list_points("place", config.place_mm or "found"), *list_points("target", config.target_mm)]
        self.channels = [Channel(f"[{axis}]", "mm") for axis in AXES]

    def see(self, parameters: Parameters, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Return how far the ball is off the socket's place."""
        return np.asarray(find_target(parameters, position, rotation) - parameters["place"])

    def propose(
        self, stated: Mapping[str, Array], seen: Array, position: Array, rotation: Array
    ) -> Sequence[Mapping[str, Array]]:
        """Return the ball's mean place; see `Instrument.propose`."""
        return [{"place": np.nanmean(find_target(stated, position, rotation) - seen, axis=0)}]
