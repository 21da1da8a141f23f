"""An instrument whose frames are not known: where each station's frame lies, and that of the tool on the platform.

It sees T_base,s T T_tool, with T the platform's pose: as a pose, or as points on the tool. Each frame has six
parameters, a displacement and a rotation vector, nominally zero. Where the frames and the joints are all free, moving a
frame and the joints with it changes no measurement: six gauge freedoms a frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import Channel
from bayescal.machines.readings.closed_forms import fit_hand_eye, fit_point_frame, fit_turned_frame, vector_of
from bayescal.machines.readings.function import Parameters
from bayescal.machines.readings.instrument import Instrument, turn
from bayescal.numerics.analytic import rotation_matrix, rotation_vector
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
    own = matrix_from_rotation_vector(base[..., 3:])
    seen = np.einsum("...ij,...j->...i", rotation, tool[..., :3]) + position
    turned = own @ rotation @ matrix_from_rotation_vector(tool[..., 3:])
    return base[..., :3] + np.einsum("...ij,...j->...i", own, seen), turned


class Tracker(Instrument):
    """What S stations see of the tool in frames of their own, a pose or points each.

    Parameters
    ----------
    stations : sequence of str
        Their names.
    seen : sequence of (int, ndarray or None)
        The station, and the point (3,) on the platform that it sees, mm; None for a pose.
    turned : bool
        Whether the machine says how its tool is turned; otherwise the tool's centre is all that is seen, and the tool
        has no frame.
    """

    def __init__(self, stations: Sequence[str], seen: Sequence[tuple[int, Array | None]], turned: bool = True) -> None:
        """Lay out frames and channels."""
        super().__init__(None)
        self._seen, self._turned = list(seen), turned
        self._frames = [frame_symbols(name) for name in name_frames(len(stations))]
        self.parameters = list(frame_blocks(len(stations)))
        if not turned:
            self.parameters = self.parameters[:-6]
        self.channels = []
        for k, (_, point) in enumerate(self._seen):
            name = f"seen{k + 1}" if len(self._seen) > 1 else "seen"
            self.channels += [Channel(f"{name}[{axis}]", "mm") for axis in AXES]
            if point is None and turned:
                self.channels += [Channel(f"{name}_r[{axis}]", "rad", rotation=f"{name}_r") for axis in AXES]

    def _frame(self, parameters: Parameters, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Return position (..., 3) and rotation (..., 3, 3) of a frame."""
        moved, turned = self._frames[k]
        position, vector = (np.stack([parameters[one] for one in some], axis=-1) for some in (moved, turned))
        return position, rotation_matrix(vector)

    def see(self, parameters: Parameters, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Return what each station sees, in the order of the channels."""
        if not self._turned:
            places = [self._frame(parameters, station) for station, _ in self._seen]
            parts = [place + turn(frame, position) for place, frame in places]
            return np.concatenate(np.broadcast_arrays(*parts), axis=-1)
        offset, own = self._frame(parameters, -1)
        tool, turned, found = position + turn(rotation, offset), rotation @ own, []
        for station, point in self._seen:
            place, frame = self._frame(parameters, station)
            at, way = place + turn(frame, tool), frame @ turned
            found += [at, rotation_vector(way)] if point is None else [at + turn(way, point)]
        return np.concatenate(np.broadcast_arrays(*found), axis=-1)

    def propose(
        self, stated: Mapping[str, Array], seen: Array, position: Array, rotation: Array
    ) -> Sequence[Mapping[str, Array]]:
        """Return frames of the stations that fit best beside the stated tool's, and those of A X = Z B."""
        if not self._turned:
            return [{}]
        offset, own = (np.concatenate([stated[one] for one in some]) for some in self._frames[-1])
        tool, turned = position + turn(rotation, offset), rotation @ matrix_from_rotation_vector(own)
        ends = np.cumsum([6 if point is None else 3 for _, point in self._seen])
        beside, both, parts = dict[str, Array](), dict[str, Array](), np.split(seen, ends[:-1], axis=1)
        for station in sorted({station for station, _ in self._seen}):
            points, places, axes = list[Array](), list[Array](), list[Array]()
            for part, (one, point) in zip(parts, self._seen, strict=True):
                if one != station:
                    continue
                points.append(tool if point is None else tool + turn(turned, point))
                places.append(part[:, :3])
                if point is None:
                    axes.append(matrix_from_rotation_vector(np.nan_to_num(part[:, 3:])))
                    axes[-1][~np.isfinite(part).all(axis=1)] = np.nan
            if axes:  # poses: seen axes are those of the frame that turns the tool's
                back, place = fit_turned_frame(places[0], axes[0], points[0], turned)[::-1]
                frames = fit_hand_eye(position, rotation, places[0], axes[0])
                if frames is not None:
                    (origin, way), (moved, own_axes) = frames
                    both |= self._name(station, -way.T @ origin, way.T) | self._name(-1, moved, own_axes)
            else:
                place, back = fit_point_frame(np.concatenate(places), np.concatenate(points))[0]
            beside |= self._name(station, place, back)
        return [{}, beside, {**beside, **both}]

    def _name(self, k: int, position: Array, axes: Array) -> dict[str, Array]:
        """Return values of a frame by symbol."""
        moved, turned = self._frames[k]
        values = zip((*moved, *turned), (*position, *vector_of(axes)), strict=True)
        return {symbol: np.array([value]) for symbol, value in values}
