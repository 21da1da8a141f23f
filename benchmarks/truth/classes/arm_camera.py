"""An arm of four joints as a user writes it: encoders, and a camera above that sees a mark on the tool, in pixels."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine

FOCAL = 1500.0  # pixels
SHOULDER = 400.0  # mm above the base
CAMERA = {"c_x": 450.0, "c_y": 0.0, "c_z": 1600.0}


class ArmCamera(ReadingMachine):
    """Links a, zeros o, where the camera is (c) and how it is turned (r) from looking straight down."""

    member = "joint"
    parameters = [
        ParameterBlock("a", (300.0, 250.0, 120.0), lower=0.0),
        ParameterBlock("o", (0.0,) * 4, "rad"),
        *(
            ParameterBlock(f"c_{axis}", (value,), per_leg=False)
            for axis, value in zip("xyz", (450.0, 0.0, 1600.0), strict=True)
        ),
        *(ParameterBlock(f"r_{axis}", (0.0,), "rad", per_leg=False) for axis in "xyz"),
    ]
    coordinates = [
        Coordinate("q1", "rad", 0.0, 0.9),
        Coordinate("q2", "rad", 0.8, 0.35),
        Coordinate("q3", "rad", -1.2, 0.4),
        Coordinate("q4", "rad", -0.8, 0.5),
    ]
    tool_channels = [Channel(axis, "mm") for axis in "xyz"]
    channels = [
        *(Channel(f"encoder[{k}]", "rad") for k in (1, 2, 3, 4)),
        *(Channel(name, "px", external=True) for name in ("image_x", "image_y")),
    ]

    def read(self, p, v, given):
        """Return encoders and what the camera sees."""
        place = self.tool(p, v)
        x, y, z = place[..., 0] - p["c_x"], p["c_y"] - place[..., 1], p["c_z"] - place[..., 2]
        y, z = turn(y, z, p["r_x"])
        z, x = turn(z, x, p["r_y"])
        x, y = turn(x, y, p["r_z"])
        image = np.stack([FOCAL * x / z, FOCAL * y / z], axis=-1)
        encoders = np.broadcast_to(v - p["o"], (*image.shape[:-1], 4))
        return np.concatenate([encoders, image], axis=-1)

    def tool(self, p, v):
        """Return where the mark is."""
        pitch = np.cumsum(v[..., 1:], axis=-1)
        out, up = (np.sum(p["a"] * one(pitch), axis=-1) for one in (np.cos, np.sin))
        return np.stack([out * np.cos(v[..., 0]), out * np.sin(v[..., 0]), SHOULDER + up], axis=-1)


def turn(a, b, angle):
    """Return two components turned by an angle from the first to the second."""
    return np.cos(angle) * a - np.sin(angle) * b, np.sin(angle) * a + np.cos(angle) * b
