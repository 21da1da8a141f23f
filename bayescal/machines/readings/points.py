"""Instruments that see a point or a frame on the tool, or how far a point on it is from one that does not move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from pydantic import Field

from bayescal.config.sections import Section, Vector
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import (
    Channel,
)
from bayescal.machines.readings.closed_forms import (
    fit_anchor,
    fit_hand_eye,
    fit_places,
    fit_point_frame,
    fit_turned_frame,
    is_mirrored,
    list_turns,
    vector_of,
)
from bayescal.machines.readings.function import Parameters
from bayescal.machines.readings.instrument import UNSTATED, Instrument, find_target, list_points, state, turn
from bayescal.numerics.analytic import norm, rotation_matrix, rotation_vector
from bayescal.numerics.geometry import Array


class PointConfig(Section):
    """A target on the tool that an instrument sees in its own frame."""

    frame_mm: Vector | None = None
    """Where the instrument's frame has its origin, base frame; a study finds it where nothing is said."""
    frame_deg: Vector | None = None
    """Rotation vector that turns the base's axes to the instrument's; a study finds it where nothing is said."""
    target_mm: Vector | Literal["found"] | None = None
    """Where the target sits on the tool, tool frame; at the tool's centre where nothing is said. `"found"`: a study
    finds it.
    """


class PoseConfig(PointConfig):
    """A frame on the tool whose pose an instrument sees in its own frame."""

    target_deg: Vector | Literal["found"] = Field(default=[0.0, 0.0, 0.0])
    """Rotation vector that turns the tool's axes to those of the frame that is seen; `"found"`: a study finds it."""


class DistanceConfig(Section):
    """A distance from a point that does not move to a point on the tool, as a ball bar or a draw-wire reads it."""

    anchor_mm: Vector | None = None
    """The point that does not move, base frame; a study finds it where nothing is said."""
    target_mm: Vector | Literal["found"] | None = None
    """The point on the tool, tool frame; the tool's centre where nothing is said. `"found"`: a study finds it."""
    zero_mm: float | Literal["found"] = 0.0
    """Distance at which it reads zero; `"found"`: a study finds it."""


class PointInstrument(Instrument):
    """A tracked point: x, y and z of a target on the tool, in the instrument's frame."""

    Config = PointConfig

    def __init__(self, config: PointConfig) -> None:
        """Lay out the frame and the target, whose place is a parameter where it is stated."""
        super().__init__(config)
        self.parameters = [
            *_frame("frame", config.frame_mm, config.frame_deg),
            *list_points("target", config.target_mm),
        ]
        self.channels = [Channel(f"[{axis}]", "mm") for axis in "xyz"]

    def see(self, parameters: Parameters, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Return where the target is in the instrument's frame."""
        own = np.swapaxes(rotation_matrix(parameters["frame_r"]), -1, -2)
        return turn(own, find_target(parameters, position, rotation) - parameters["frame"])

    def propose(
        self, stated: Mapping[str, Array], seen: Array, position: Array, rotation: Array
    ) -> Sequence[Mapping[str, Array]]:
        """Return the frame that fits points best, by Kabsch's algorithm; see `Instrument.propose`."""
        frame, _ = fit_point_frame(find_target(stated, position, rotation), seen[:, :3])
        found = [{}, _list_frame("frame", *frame)]
        if "target" in stated:  # one far from the tool's centre moves as it turns: all turns of the frame are tried
            for vector in list_turns(vector_of(frame[1])):
                place, target = fit_places(position, rotation, seen[:, :3], rotation_matrix(vector))
                found.append({"frame": place, "frame_r": vector, "target": target})
        return found

    def find_mirrored(self, seen: Array, position: Array, rotation: Array) -> bool:
        """Return whether positions fit a left-handed frame alone; see `Instrument.find_mirrored`."""
        return fit_point_frame(position, seen[:, :3])[1] or is_mirrored(position, rotation, seen[:, :3], False)


class PoseInstrument(PointInstrument):
    """A tracked pose: position and rotation vector of a frame on the tool, in the instrument's frame."""

    Config = PoseConfig

    def __init__(self, config: PoseConfig) -> None:
        """Lay out the frame and that on the tool."""
        super().__init__(config)
        target = _frame("target", config.target_mm or [0.0, 0.0, 0.0], config.target_deg)
        self.parameters = [*self.parameters[:2], *target]
        self.channels = [*self.channels, *(Channel(f"r[{axis}]", "rad", rotation="r") for axis in "xyz")]

    def see(self, parameters: Parameters, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Return position and rotation vector in the instrument's frame."""
        own = np.swapaxes(rotation_matrix(parameters["frame_r"]), -1, -2)
        turned = rotation_vector(own @ rotation @ rotation_matrix(parameters["target_r"]))
        both = np.broadcast_arrays(super().see(parameters, position, rotation), turned)
        return np.concatenate(both, axis=-1)

    def propose(
        self, stated: Mapping[str, Array], seen: Array, position: Array, rotation: Array
    ) -> Sequence[Mapping[str, Array]]:
        """Return both frames that fit poses best: of the seen axes alone, of points alone, and of A X = Z B."""
        own, points = rotation_matrix(stated["target_r"]), find_target(stated, position, rotation)
        turned = rotation_matrix(seen[:, 3:])
        found: list[Mapping[str, Array]] = [{}]
        for place, axes in (
            fit_point_frame(points, seen[:, :3])[0],
            fit_turned_frame(points, rotation @ own, seen[:, :3], turned),
        ):
            # R_target = mean of Rᵀ R_frame R_seen
            target = vector_of(np.nansum(np.swapaxes(rotation, 1, 2) @ axes @ turned, axis=0))
            found += [_list_frame("frame", place, axes), _list_frame("frame", place, axes) | {"target_r": target}]
        both = fit_hand_eye(position, rotation, seen[:, :3], turned)
        if both is not None:
            found.append(_list_frame("frame", *both[0]) | _list_frame("target", *both[1]))
        return found


class DistanceInstrument(Instrument):
    """A ball bar or a draw-wire: the distance from a fixed point to a point on the tool, less that where it is zero."""

    Config = DistanceConfig

    def __init__(self, config: DistanceConfig) -> None:
        """Lay out both points and the zero."""
        super().__init__(config)
        zero = ParameterBlock("zero", (state(config.zero_mm, UNSTATED[:1])[0],), per_leg=False)
        anchor = list_points("anchor", config.anchor_mm or "found")
        self.parameters = [*anchor, *list_points("target", config.target_mm), zero]
        self.channels = [Channel("", "mm")]

    def see(self, parameters: Parameters, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Return the distance."""
        away = norm(find_target(parameters, position, rotation) - parameters["anchor"])
        return (away - parameters["zero"])[..., None]

    def propose(
        self, stated: Mapping[str, Array], seen: Array, position: Array, rotation: Array
    ) -> Sequence[Mapping[str, Array]]:
        """Return the point and the zero whose distances fit best, by linear least squares of their squares."""
        points, zero = find_target(stated, position, rotation), float(stated["zero"][0])
        found = [{"anchor": anchor} for anchor in fit_anchor(points, seen[:, 0] + zero, False)]
        both = [{"anchor": one[:3], "zero": one[3:]} for one in fit_anchor(points, seen[:, 0], True)]
        return [{}, *found, *both]

    def list_hidden(self, is_flat: bool) -> Mapping[str, str]:
        """Return the anchor beside a plane; see `Instrument.list_hidden`."""
        return {"anchor": "the tool keeps to a plane, and both sides of it fit alike"} if is_flat else {}


def _frame(
    symbol: str, position: list[float] | Literal["found"] | None, degrees: list[float] | Literal["found"] | None
) -> list[ParameterBlock]:
    vector = tuple(float(one) for one in np.radians(state(degrees, UNSTATED)))
    turned = ParameterBlock(f"{symbol}_r", vector, "rad", axes="xyz")
    return [*list_points(symbol, position or "found"), turned]


def _list_frame(symbol: str, position: Array, axes: Array) -> dict[str, Array]:
    """Return a frame at a position (3,) with axes (3, 3) by symbol."""
    return {symbol: position, f"{symbol}_r": vector_of(axes)}
