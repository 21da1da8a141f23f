"""A mount of two axes, azimuth and elevation: a telescope, an antenna, a gimbal, by the usual terms of pointing.

It points at azimuth A and elevation E on the sky, its encoders read (A, E) less a correction of eight terms (Wallace,
"A rigorous algorithm for telescope pointing", Proc. SPIE 4848, 2002, in the first-order form of pointing programs),

    dA = -IA - (AN sin A + AW cos A + NPAE) tan E - CA / cos E,
    dE =  IE - AN cos A + AW sin A - TF cos E - TX cot E,

with A counted from south through east: zeros of both encoders, the tilt of the azimuth axis to the north and to the
west, axes that are not square, a tube that is not square to the elevation axis, flexure of the tube as its sine and as
its cotangent. Stars, or targets that a survey gives, are external readings of A and E.

IA, NPAE and CA are alike in azimuth but for tan E and 1 / cos E, and IE, TF and TX in elevation but for cos E and
cot E: where a mount is measured over few elevations their sums are known, and they hardly.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from bayescal.config.sections import Number, Section
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import Channel, Coordinate, Given
from bayescal.machines.readings.function import Parameters, ReadingMachine

TERMS: Final = ("IA", "IE", "AN", "AW", "CA", "NPAE", "TF", "TX")

type Ends = Annotated[list[Number], Field(min_length=2, max_length=2)]


class MountConfig(Section):
    """A mount: where it points, and from where its azimuth is counted."""

    azimuth_deg: Ends = Field(default=[0.0, 360.0])
    """Smallest and largest azimuth where accuracy counts."""
    elevation_deg: Ends = Field(default=[15.0, 85.0])
    """Smallest and largest elevation where accuracy counts, both between 0 and 90."""
    azimuth_from: Literal["south", "north"] = "north"
    """Where azimuth is zero; it grows through east."""


class Mount(ReadingMachine):
    """Encoders of azimuth and elevation, and where the mount points on the sky."""

    Config = MountConfig
    member = "axis"
    commanded = ("encoder",)

    def __init__(self, config: MountConfig) -> None:
        """Lay out parameters, coordinates and channels; ValueError for ends in another order, or no elevations."""
        circle = 2.0 * np.pi
        self.parameters = [ParameterBlock(name, (0.0,), "rad", per_leg=False) for name in TERMS]
        self.tool_channels = [Channel("azimuth", "rad", period=circle), Channel("elevation", "rad")]
        self.channels = [
            Channel("encoder[1]", "rad", period=circle),
            Channel("encoder[2]", "rad"),
            *(Channel(one.name, "rad", external=True, period=one.period) for one in self.tool_channels),
        ]
        self.from_south = config.azimuth_from == "south"
        for name, (low, high) in (("azimuth_deg", config.azimuth_deg), ("elevation_deg", config.elevation_deg)):
            if not low < high:
                raise ValueError(f"{name}: found {low:g} to {high:g}, expected the smaller first")
        low, high = config.elevation_deg
        if not 0.0 < low < high < 90.0:
            raise ValueError(f"elevation_deg: found {low:g} to {high:g}, expected ends between 0 and 90")
        ends = {"azimuth": np.radians(config.azimuth_deg), "elevation": np.radians(config.elevation_deg)}
        self.coordinates = [
            Coordinate(name, "rad", float(one.mean()), float(np.ptp(one)) / 2.0) for name, one in ends.items()
        ]

    def read(self, parameters: Parameters, v: np.ndarray, given: Given) -> np.ndarray:
        """Return both encoders, and the direction on the sky."""
        del given
        azimuth, elevation = v[..., 0], v[..., 1]
        south = azimuth if self.from_south else np.pi - azimuth
        sign = 1.0 if self.from_south else -1.0  # of azimuths, which south and north count the other way round
        sine, cosine = np.sin(south), np.cos(south)
        tilt = parameters["AN"] * sine + parameters["AW"] * cosine
        across = -parameters["IA"] - (tilt + parameters["NPAE"]) * np.tan(elevation)
        across = across - parameters["CA"] / np.cos(elevation)
        along = parameters["IE"] - parameters["AN"] * cosine + parameters["AW"] * sine
        along = along - parameters["TF"] * np.cos(elevation) - parameters["TX"] / np.tan(elevation)
        read = (azimuth - sign * across, elevation - along, azimuth, elevation)
        return np.stack(np.broadcast_arrays(*read), axis=-1)

    def tool(self, parameters: Parameters, v: np.ndarray) -> np.ndarray:
        """Return where it points, azimuth and elevation."""
        del parameters
        return v
