"""A five-bar as a user writes it: two motors, cranks and couplers that meet at the tool, which a camera sees."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine
from bayescal.numerics.analytic import atan2


class FiveBar(ReadingMachine):
    """Motors at (x, y), cranks l, couplers m; elbows point outwards."""

    member = "crank"
    parameters = [
        ParameterBlock("x", (-60.0, 60.0)),
        ParameterBlock("y", (0.0, 0.0)),
        ParameterBlock("l", (120.0, 120.0), lower=0.0),
        ParameterBlock("m", (160.0, 160.0), lower=0.0),
        ParameterBlock("zero", (0.0, 0.0), "rad"),
    ]
    coordinates = [Coordinate("x", "mm", 0.0, 60.0), Coordinate("y", "mm", 180.0, 40.0)]
    tool_channels = [Channel("x", "mm"), Channel("y", "mm")]
    channels = [
        *(Channel(f"theta[{k}]", "rad") for k in (1, 2)),
        *(Channel(f"camera_{axis}", "mm", external=True) for axis in "xy"),
    ]

    def read(self, p, v, given):
        """Return motors and what the camera sees."""
        x, y = v[..., :1] - p["x"], v[..., 1:] - p["y"]
        square = x**2 + y**2
        elbow = np.arccos((p["l"] ** 2 + square - p["m"] ** 2) / (2.0 * p["l"] * np.sqrt(square)))
        theta = atan2(y, x) + np.array([1.0, -1.0]) * elbow - p["zero"]
        return np.concatenate([theta, np.broadcast_to(v, theta.shape)], axis=-1)
