"""A planar 3-RRR as a user writes it: three motors, cranks, couplers, a platform that a camera sees."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine
from bayescal.numerics.analytic import atan2

PHI = np.radians([90.0, 210.0, 330.0])


class PlanarRRR(ReadingMachine):
    """Motors at (x, y), cranks l, couplers m, joints (xi, eta) on the platform."""

    parameters = [
        ParameterBlock("x", tuple(250.0 * np.cos(PHI))),
        ParameterBlock("y", tuple(250.0 * np.sin(PHI))),
        ParameterBlock("l", (130.0,) * 3, lower=0.0),
        ParameterBlock("m", (140.0,) * 3, lower=0.0),
        ParameterBlock("xi", tuple(60.0 * np.cos(PHI))),
        ParameterBlock("eta", tuple(60.0 * np.sin(PHI))),
        ParameterBlock("zero", (0.0,) * 3, "rad"),
    ]
    coordinates = [
        Coordinate("x", "mm", 0.0, 45.0),
        Coordinate("y", "mm", 0.0, 45.0),
        Coordinate("phi", "rad", 0.0, 0.35),
    ]
    tool_channels = [Channel("x", "mm"), Channel("y", "mm"), Channel("phi", "rad")]
    channels = [
        *(Channel(f"theta[{k}]", "rad") for k in (1, 2, 3)),
        *(Channel(f"camera_{axis}", "mm", external=True) for axis in "xy"),
        Channel("camera_phi", "rad", external=True),
    ]

    def read(self, p, v, given):
        """Return motors and what the camera sees."""
        cos, sin = np.cos(v[..., 2, None]), np.sin(v[..., 2, None])
        x = v[..., 0, None] + cos * p["xi"] - sin * p["eta"] - p["x"]
        y = v[..., 1, None] + sin * p["xi"] + cos * p["eta"] - p["y"]
        square = x**2 + y**2
        elbow = np.arccos((p["l"] ** 2 + square - p["m"] ** 2) / (2.0 * p["l"] * np.sqrt(square)))
        theta = atan2(y, x) + elbow - p["zero"]
        return np.concatenate([theta, np.broadcast_to(v, theta.shape)], axis=-1)
