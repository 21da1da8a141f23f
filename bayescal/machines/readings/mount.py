"""A mount of two axes: a telescope, an antenna, a gimbal, by the usual terms of pointing.

Its encoders read the direction on the sky less a correction, which is linear in a few small angles (Wallace, "A
rigorous algorithm for telescope pointing", Proc. SPIE 4848, 2002, in the first-order form and with the signs of his
program TPOINT). Of a mount of azimuth A, from north through east, and elevation E it is

    dA = -IA - (AN sin A + AW cos A + NPAE) tan E - CA / cos E,
    dE =  IE - AN cos A + AW sin A - TF cos E - TX cot E:

zeros of both encoders, the tilt of the azimuth axis to the north and to the west, axes that are not square, a tube that
is not square to the elevation axis, flexure of the tube as its sine and as its cotangent. Azimuths that are counted
from south through east go into the formula as they are, which is how the MMT's own program has them: IA, AN, CA and
NPAE are then of the other sign than from north. Of an equatorial mount at
latitude φ, with the hour angle h, to the west, and the declination δ, it is

    dh = IH + (NP + ME sin h - MA cos h) tan δ + CH / cos δ + TF cos φ sin h / cos δ - DAF (cos φ cos h + sin φ tan δ),
    dδ = ID + ME cos h + MA sin h + TF (cos φ cos h sin δ - sin φ cos δ) + FO cos h:

zeros, axes that are not square, a tube that is not, a pole of the mount that lies ME below the true one and MA to the
right of it (at northern latitudes), flexure of the tube towards the ground, of a fork, and the fall of a declination
axis that is held at one end. Stars, or targets that a survey gives, are external readings of the direction.

Terms that look alike: IA, NPAE and CA (in azimuth 1, tan E and 1 / cos E), IE, TF and TX (in elevation 1, cos E and
cot E); IH, NP and CH the same, NP and DAF by tan δ, ME and FO by cos h, TF and ID where h varies little. Where a mount
is measured over few elevations or declinations, their sums are known, and they hardly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Final, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from bayescal.config.sections import Number, Section
from bayescal.errors import say_reversed
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import Channel, Coordinate, Given
from bayescal.machines.readings.function import Parameters, ReadingMachine

ALTAZIMUTH: Final = "altazimuth"
TERMS: Final = {
    ALTAZIMUTH: ("IA", "IE", "AN", "AW", "CA", "NPAE", "TF", "TX"),
    "equatorial": ("IH", "ID", "NP", "CH", "ME", "MA", "TF", "FO", "DAF"),
}
"""Terms by the mount's axes, as TPOINT calls them."""
DIRECTIONS: Final = {ALTAZIMUTH: ("azimuth", "elevation"), "equatorial": ("hour_angle", "declination")}
"""Angles of a direction on the sky by the mount's axes."""
MIRRORED: Final = ("IA", "AN", "CA", "NPAE")
"""Terms that are of the other sign where azimuth is counted from south instead of north."""

SKY: Final = {"elevation": (0.0, np.pi / 2), "declination": (-np.pi / 2, np.pi / 2)}
"""From the horizon to the zenith, from pole to pole."""

PIER, ACROSS, ALONG = 1000.0, 0.3, 0.5
"""How long a drawing has the pier, mm, as the tube; half the second axis and the first one in its units."""

type Ends = Annotated[list[Number], Field(min_length=2, max_length=2)]


class MountConfig(Section):
    """A mount: its axes, where it points, and from where its azimuth is counted."""

    axes: Literal["altazimuth", "equatorial"] = ALTAZIMUTH
    """Whether it turns in azimuth and elevation (`altazimuth`) or in hour angle and declination (`equatorial`)."""
    azimuth_deg: Ends = Field(default=[0.0, 360.0])
    """Smallest and largest azimuth where accuracy counts."""
    elevation_deg: Ends = Field(default=[15.0, 85.0])
    """Smallest and largest elevation where accuracy counts, both between 0 and 90."""
    azimuth_from: Literal["south", "north"] = "north"
    """Where azimuth is zero; it grows through east. Azimuths from south go into the formula of the terms as they are:
    IA, AN, CA and NPAE are of the other sign then.
    """
    hour_angle_deg: Ends = Field(default=[-75.0, 75.0])
    """Smallest and largest hour angle where accuracy counts, growing to the west; of an equatorial mount."""
    declination_deg: Ends = Field(default=[-30.0, 80.0])
    """Smallest and largest declination where accuracy counts, both between -90 and 90; of an equatorial mount."""
    latitude_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None
    """Latitude where an equatorial mount stands, north positive; its flexures depend on it."""

    @model_validator(mode="after")
    def _check_axes(self) -> Self:
        own = {"azimuth_deg", "elevation_deg", "azimuth_from"}
        others = {"hour_angle_deg", "declination_deg", "latitude_deg"}
        for key in sorted(self.model_fields_set & (others if self.axes == ALTAZIMUTH else own)):
            raise ValueError(f"{key}: found with axes {self.axes!r}, expected none")
        if self.axes != ALTAZIMUTH and self.latitude_deg is None:
            raise ValueError("latitude_deg: missing, expected that of the equatorial mount")
        for name in DIRECTIONS[self.axes]:
            low, high = getattr(self, f"{name}_deg")
            if not low < high:
                raise ValueError(say_reversed(f"{name}_deg", low, high))
        floor = 0.0 if self.axes == ALTAZIMUTH else -90.0
        if not floor < low < high < 90.0:
            raise ValueError(f"{name}_deg: found {low:g} to {high:g}, expected ends between {floor:g} and 90")
        return self


class Mount(ReadingMachine):
    """Encoders of both axes, and where the mount points on the sky."""

    Config = MountConfig
    member = "axis"
    commanded = ("encoder",)

    def __init__(self, config: MountConfig) -> None:
        """Lay out parameters, coordinates and channels."""
        self.axes, (first, second) = config.axes, DIRECTIONS[config.axes]
        self.from_south, self.latitude = config.azimuth_from == "south", float(np.radians(config.latitude_deg or 0.0))
        ends = {name: getattr(config, f"{name}_deg") for name in (first, second)}
        circle = 2.0 * np.pi
        self.parameters = [ParameterBlock(name, (0.0,), "rad", per_leg=False) for name in TERMS[self.axes]]
        self.tool_channels = [Channel(first, "rad", period=circle), Channel(second, "rad", ends=SKY[second])]
        self.channels = [
            Channel("encoder[1]", "rad", period=circle),
            Channel("encoder[2]", "rad"),
            *(replace(one, external=True) for one in self.tool_channels),
        ]
        self.coordinates = [
            Coordinate(name, "rad", float(np.radians(low + high)) / 2.0, float(np.radians(high - low)) / 2.0)
            for name, (low, high) in ends.items()
        ]

    def read(self, parameters: Parameters, v: np.ndarray, given: Given) -> np.ndarray:
        """Return both encoders, and the direction on the sky."""
        del given
        one, other = v[..., 0], v[..., 1]
        if self.axes != ALTAZIMUTH:
            along, across = correct_equatorial(parameters, one, other, self.latitude)
        else:
            along, across = correct_altazimuth(parameters, one, other)
        return np.stack(np.broadcast_arrays(one - along, other - across, one, other), axis=-1)

    def tool(self, parameters: Parameters, v: np.ndarray) -> np.ndarray:
        """Return where it points, both angles on the sky."""
        del parameters
        return v

    def outline(self, parameters: Parameters, v: np.ndarray) -> tuple[np.ndarray, Sequence[tuple[int, int]]]:
        """Return pier, tube and second axis, and the pole of an equatorial mount; x to the east, y to the north."""
        del parameters
        one, other = v[..., 0, None], v[..., 1, None]
        if self.axes == ALTAZIMUTH:
            pole, meridian, side = np.eye(3)[[2, 1, 0]]
            first = np.pi - one if self.from_south else one
        else:
            level, steep = np.cos(self.latitude), np.sin(self.latitude)
            pole, meridian, side = np.array([[0.0, level, steep], [0.0, -steep, level], [-1.0, 0.0, 0.0]])
            first = one
        ahead, across = np.cos(first) * meridian + np.sin(first) * side, np.sin(first) * meridian - np.cos(first) * side
        tube = np.cos(other) * ahead + np.sin(other) * pole
        foot = np.array([0.0, 0.0, -1.0])
        ends, lines = [foot, 0.0 * foot, tube, ACROSS * across, -ACROSS * across], [(0, 1), (1, 2), (3, 4)]
        if self.axes != ALTAZIMUTH:
            ends, lines = [*ends, ALONG * pole], [*lines, (1, 5)]
        return PIER * np.stack(np.broadcast_arrays(*ends), axis=-2), lines


type Terms = Mapping[str, np.ndarray]
type Correction = tuple[np.ndarray, np.ndarray]


def correct_altazimuth(terms: Terms, azimuth: np.ndarray, elevation: np.ndarray) -> Correction:
    """Return what the sky is beyond encoders of azimuth, from north through east, and of elevation, arrays (...)."""
    sine, cosine = np.sin(azimuth), np.cos(azimuth)
    tilt = terms["AN"] * sine + terms["AW"] * cosine + terms["NPAE"]
    along = -terms["IA"] - tilt * np.tan(elevation) - terms["CA"] / np.cos(elevation)
    across = terms["IE"] - terms["AN"] * cosine + terms["AW"] * sine
    return along, across - terms["TF"] * np.cos(elevation) - terms["TX"] / np.tan(elevation)


def correct_equatorial(terms: Terms, hour: np.ndarray, declination: np.ndarray, latitude: float) -> Correction:
    """Return what the sky is beyond encoders of hour angle, to the west, and of declination, arrays (...)."""
    sine, cosine, tangent = np.sin(hour), np.cos(hour), np.tan(declination)
    level, steep = np.cos(latitude), np.sin(latitude)
    tilt = terms["NP"] + terms["ME"] * sine - terms["MA"] * cosine
    along = terms["IH"] + tilt * tangent - terms["DAF"] * (level * cosine + steep * tangent)
    along = along + (terms["CH"] + terms["TF"] * level * sine) / np.cos(declination)
    across = terms["ID"] + (terms["ME"] + terms["FO"]) * cosine + terms["MA"] * sine
    droop = level * cosine * np.sin(declination) - steep * np.cos(declination)
    return along, across + terms["TF"] * droop
