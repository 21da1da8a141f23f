"""A positioner of two axes as a user writes it: a cradle that tilts, a table on it that turns, a tracker's target."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine


class Positioner(ReadingMachine):
    """Zeros, the cradle's axis by its tilts w and place b, the table's by tilt c and offset e, the target p."""

    member = "axis"
    parameters = [
        ParameterBlock("zero", (0.0, 0.0), "rad"),
        *(ParameterBlock(name, (0.0,), "rad", per_leg=False) for name in ("w_y", "w_z", "c_y")),
        *(ParameterBlock(name, (0.0,), per_leg=False) for name in ("b_y", "b_z", "e_y")),
        *(ParameterBlock(name, (value,), per_leg=False) for name, value in (("p_x", 150.0), ("p_z", 80.0))),
    ]
    coordinates = [Coordinate("tilt", "rad", 0.0, 1.2), Coordinate("turn", "rad", 0.0, 2.5)]
    tool_channels = [Channel(axis, "mm") for axis in "xyz"]
    channels = [
        *(Channel(f"encoder[{k}]", "rad") for k in (1, 2)),
        *(Channel(f"tracker_{axis}", "mm", external=True) for axis in "xyz"),
    ]

    def read(self, p, v, given):
        """Return encoders and where the target is."""
        place = self.tool(p, v)
        encoders = np.broadcast_to(v - p["zero"], (*place.shape[:-1], 2))
        return np.concatenate([encoders, place], axis=-1)

    def tool(self, p, v):
        """Return where the target is."""
        x, y, z = np.cos(v[..., 1]) * p["p_x"], np.sin(v[..., 1]) * p["p_x"], p["p_z"]
        z, x = turn(z, x, p["c_y"])
        y, z = turn(y + p["e_y"], z, v[..., 0])
        z, x = turn(z, x, p["w_y"])
        x, y = turn(x, y, p["w_z"])
        return np.stack(np.broadcast_arrays(x, y + p["b_y"], z + p["b_z"]), axis=-1)


def turn(a, b, angle):
    """Return two components turned by an angle from the first to the second."""
    return np.cos(angle) * a - np.sin(angle) * b, np.sin(angle) * a + np.cos(angle) * b
