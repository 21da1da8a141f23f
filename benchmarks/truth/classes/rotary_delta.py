"""A rotary delta as a user writes it: three motors that are commanded, and a tracker in the frame of the base."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine
from bayescal.numerics.analytic import atan2


class RotaryDelta(ReadingMachine):
    """Motor angles count downwards from where an arm is horizontal; forearms keep the platform level."""

    member = "arm"
    phi = np.radians([90.0, 210.0, 330.0])
    parameters = [
        ParameterBlock("R", (200.0,) * 3, lower=0.0),
        ParameterBlock("L", (235.0,) * 3, lower=0.0),
        ParameterBlock("l", (800.0,) * 3, lower=0.0),
        ParameterBlock("e", (45.0,) * 3, lower=0.0),
        *(ParameterBlock(name, (0.0,) * 3, "rad") for name in ("zero", "yaw", "roll")),
    ]
    coordinates = [
        Coordinate("x", "mm", 0.0, 250.0),
        Coordinate("y", "mm", 0.0, 250.0),
        Coordinate("z", "mm", -720.0, 100.0),
    ]
    tool_channels = [Channel(axis, "mm") for axis in "xyz"]
    channels = [
        *(Channel(f"theta[{k}]", "rad") for k in (1, 2, 3)),
        *(Channel(f"tracker_{axis}", "mm", external=True) for axis in "xyz"),
    ]

    def read(self, p, v, given):
        """Return motors and what the tracker sees."""
        cos, sin, radius = np.cos(self.phi), np.sin(self.phi), p["e"] - p["R"]
        x, y, z = v[..., 0, None] + radius * cos, v[..., 1, None] + radius * sin, v[..., 2, None]
        along, across = x * cos + y * sin, y * cos - x * sin
        up = np.cos(p["roll"]) * across + np.sin(p["roll"]) * z
        ahead = np.cos(p["yaw"]) * along + np.sin(p["yaw"]) * up
        below = np.sin(p["roll"]) * across - np.cos(p["roll"]) * z
        share = (x**2 + y**2 + z**2 + p["L"] ** 2 - p["l"] ** 2) / (2.0 * p["L"])
        theta = atan2(below, ahead) - atan2(np.sqrt(ahead**2 + below**2 - share**2), share) - p["zero"]
        return np.concatenate([theta, np.broadcast_to(v, theta.shape)], axis=-1)
