"""A telescope's mount of two axes as a user writes it: encoders, and stars whose azimuth and altitude are known."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine
from bayescal.numerics.analytic import atan2


class Mount(ReadingMachine):
    """Zeros of both axes, tilt of the azimuth axis, axes not square, tube not square to the altitude axis."""

    member = "axis"
    parameters = [
        ParameterBlock("zero", (0.0, 0.0), "rad"),
        *(ParameterBlock(name, (0.0,), "rad", per_leg=False) for name in ("tilt_x", "tilt_y", "axes", "tube")),
    ]
    coordinates = [Coordinate("a", "rad", 0.0, 1.8), Coordinate("e", "rad", 0.75, 0.45)]
    tool_channels = [Channel("azimuth", "rad"), Channel("altitude", "rad")]
    channels = [
        *(Channel(f"encoder[{k}]", "rad") for k in (1, 2)),
        *(Channel(name, "rad", external=True) for name in ("azimuth", "altitude")),
    ]

    def read(self, p, v, given):
        """Return encoders and where the tube points."""
        points = self.tool(p, v)
        return np.concatenate([np.broadcast_to(v - p["zero"], points.shape), points], axis=-1)

    def tool(self, p, v):
        """Return azimuth and altitude of the tube."""
        x, y, z = np.cos(p["tube"]) * np.cos(v[..., 1]), np.sin(p["tube"]), np.cos(p["tube"]) * np.sin(v[..., 1])
        y, z = turn(y, z, p["axes"])
        x, y = turn(x, y, v[..., 0])
        y, z = turn(y, z, p["tilt_x"])
        z, x = turn(z, x, p["tilt_y"])
        return np.stack([atan2(y, x), atan2(z, np.sqrt(x**2 + y**2))], axis=-1)


def turn(a, b, angle):
    """Return two components turned by an angle from the first to the second."""
    return np.cos(angle) * a - np.sin(angle) * b, np.sin(angle) * a + np.cos(angle) * b
