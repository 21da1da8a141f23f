"""A probe on the tool that touches a plane: one reading a row, its height over the plane, zero where it touches.

With the tool's position p and rotation R, the tip at b on the tool and a plane of unit normal n at the distance d from
the origin of the base,

    height = n · (p + R b) - d,    n = exp([τ]) n₀,

τ across the stated direction n₀, by default up: two numbers turn n₀ to any direction but its opposite. Where a plane
lies nobody has to know: it is found with the machine. The radius of a ball is part of d.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field

from bayescal.config.sections import Number, Section, Vector
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import Channel
from bayescal.machines.readings.closed_forms import fit_plane, fit_plane_and_tip
from bayescal.machines.readings.function import Parameters
from bayescal.machines.readings.instrument import UNSTATED, Instrument, find_target, list_points, turn
from bayescal.numerics.analytic import rotation_matrix
from bayescal.numerics.geometry import Array

TINY = 1e-12


def _check_direction(vector: list[float]) -> list[float]:
    if not any(vector):
        raise ValueError("normal: found no direction, expected one")
    return vector


class PlaneConfig(Section):
    """A plane that a probe on the tool touches."""

    normal: Annotated[Vector, AfterValidator(_check_direction)] = Field(default=[0.0, 0.0, 1.0])
    """Which way the plane faces, roughly, base frame [1]."""
    tilt_deg: Annotated[list[Number], Field(min_length=2, max_length=2)] | None = None
    """Rotation vector across `normal` that turns it to the plane's; about x and y where it is up. A study finds it
    where nothing is said.
    """
    offset_mm: Number | None = None
    """Distance of the plane from the base's origin, along its normal; a study finds it where nothing is said."""
    target_mm: Vector | Literal["found"] | None = None
    """Where the probe's tip is on the tool, tool frame; at the tool's centre where nothing is said. `"found"`: a study
    finds it.
    """


class PlaneInstrument(Instrument):
    """A touch probe on a plane: how high its tip is over it, zero where it touches."""

    Config = PlaneConfig
    touches = True
    wide: ClassVar[Mapping[str, float]] = {"mm": 1e4, "rad": 0.5}
    """Half as wide as of a frame, which is the same after a whole turn: after half of one the plane is, from behind."""

    def __init__(self, config: PlaneConfig) -> None:
        """Lay out the plane and the tip."""
        super().__init__(config)
        self.normal = np.array(config.normal) / np.linalg.norm(config.normal)
        first = np.eye(3)[np.abs(self.normal).argmin()]  # x where it is up
        first = first - (first @ self.normal) * self.normal
        first = first / np.linalg.norm(first)
        self.across = np.stack([first, np.cross(self.normal, first)])
        tilt = UNSTATED[:2] if config.tilt_deg is None else tuple(np.radians(config.tilt_deg).tolist())
        offset = UNSTATED[:1] if config.offset_mm is None else (config.offset_mm,)
        axes = "".join("xyz"[np.abs(one).argmax()] for one in self.across)  # roughly, of an oblique plane
        self.parameters = [
            ParameterBlock("tilt", tilt, "rad", axes=axes),
            ParameterBlock("offset", offset, per_leg=False),
            *list_points("target", config.target_mm),
        ]
        self.channels = [Channel("", "mm")]

    def see(self, parameters: Parameters, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Return the height of the tip."""
        normal = turn(rotation_matrix(parameters["tilt"] @ self.across), self.normal)
        height = (normal * find_target(parameters, position, rotation)).sum(axis=-1) - parameters["offset"]
        return np.asarray(height[..., None])

    def propose(
        self, stated: Mapping[str, Array], seen: Array, position: Array, rotation: Array
    ) -> Sequence[Mapping[str, Array]]:
        """Return the plane through the tip where it touches, with the stated tip and with one that is found."""
        there = np.isfinite(seen[:, 0])
        position, rotation = position[there], rotation[there]
        found = fit_plane(find_target(stated, position, rotation))
        if "target" in stated:
            found += fit_plane_and_tip(position, rotation)
        return [{}, *(self._name(one) for one in found)]

    def list_hidden(self, is_flat: bool) -> Mapping[str, str]:
        """Return the tilt of a plane that another one meets along a line; see `Instrument.list_hidden`."""
        return {"tilt": "the tool keeps to a plane, and touches along a line"} if is_flat else {}

    def _name(self, found: Array) -> dict[str, Array]:
        """Return a plane (4,), with a tip (7,), by symbol; of both its sides the one that faces the stated way."""
        side = 1.0 if found[:3] @ self.normal >= 0.0 else -1.0
        axis = np.cross(self.normal, side * found[:3])
        size = float(np.linalg.norm(axis))
        tilt = np.arctan2(size, side * found[:3] @ self.normal) * axis / max(size, TINY)
        named = {"tilt": self.across @ tilt, "offset": side * found[3:4]}
        return named | ({"target": found[4:]} if len(found) > 4 else {})
