"""Three linear axes as a user writes them: scales, and angles that are not right; a tracker sees the tool."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine


class Axes(ReadingMachine):
    """Axis y leans towards x, axis z towards x and y."""

    member = "axis"
    parameters = [
        ParameterBlock("scale", (1.0,) * 3, "1"),
        ParameterBlock("zero", (0.0,) * 3),
        *(ParameterBlock(name, (0.0,), "rad", per_leg=False) for name in ("xy", "xz", "yz")),
    ]
    coordinates = [Coordinate(f"q{k}", "mm", 0.0, 200.0) for k in (1, 2, 3)]
    tool_channels = [Channel(axis, "mm") for axis in "xyz"]
    channels = [
        *(Channel(f"q[{k}]", "mm") for k in (1, 2, 3)),
        *(Channel(f"tracker_{axis}", "mm", external=True) for axis in "xyz"),
    ]

    def read(self, p, v, given):
        """Return axes and what the tracker sees."""
        place = self.tool(p, v)
        return np.concatenate([np.broadcast_to(v, place.shape), place], axis=-1)

    def tool(self, p, v):
        """Return where the tool is."""
        along = p["scale"] * v
        x = along[..., 0] + along[..., 1] * np.sin(p["xy"]) + along[..., 2] * np.sin(p["xz"])
        y = along[..., 1] * np.cos(p["xy"]) + along[..., 2] * np.sin(p["yz"])
        z = along[..., 2] * np.sqrt(1.0 - np.sin(p["xz"]) ** 2 - np.sin(p["yz"]) ** 2)
        return np.stack([x, y, z], axis=-1) + p["zero"]
