"""A SCARA as a user writes it: three turning joints, and a camera above that sees a mark on the tool and its angle."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine


class Scara(ReadingMachine):
    """Links, zeros of the joints, where the mark is on the tool, where the camera is."""

    member = "joint"
    parameters = [
        ParameterBlock("l", (300.0, 250.0), lower=0.0),
        ParameterBlock("o", (0.0,) * 3, "rad"),
        *(ParameterBlock(name, (value,), per_leg=False) for name, value in (("m_x", 20.0), ("m_y", 0.0))),
        *(ParameterBlock(name, (value,), per_leg=False) for name, value in (("c_x", 350.0), ("c_y", 0.0))),
        ParameterBlock("c_phi", (0.0,), "rad", per_leg=False),
    ]
    coordinates = [
        Coordinate("q1", "rad", 0.0, 1.2),
        Coordinate("q2", "rad", 1.1, 0.7),
        Coordinate("q3", "rad", 0.0, 1.5),
    ]
    tool_channels = [Channel("x", "mm"), Channel("y", "mm"), Channel("phi", "rad")]
    channels = [
        *(Channel(f"encoder[{k}]", "rad") for k in (1, 2, 3)),
        *(Channel(f"camera_{axis}", "mm", external=True) for axis in "xy"),
        Channel("camera_phi", "rad", external=True),
    ]

    def read(self, p, v, given):
        """Return encoders and what the camera sees."""
        tool = self.tool(p, v)
        x, y, phi = (tool[..., k] - p[name] for k, name in enumerate(("c_x", "c_y", "c_phi")))
        cos, sin = np.cos(p["c_phi"]), np.sin(p["c_phi"])
        seen = np.stack([cos * x + sin * y, cos * y - sin * x, phi], axis=-1)
        return np.concatenate([np.broadcast_to(v - p["o"], seen.shape), seen], axis=-1)

    def tool(self, p, v):
        """Return where the mark is, and the tool's angle."""
        first, second = v[..., 0], v[..., 0] + v[..., 1]
        phi = second + v[..., 2]
        cos, sin, l1, l2 = np.cos(phi), np.sin(phi), p["l"][..., 0], p["l"][..., 1]
        x = l1 * np.cos(first) + l2 * np.cos(second) + cos * p["m_x"] - sin * p["m_y"]
        y = l1 * np.sin(first) + l2 * np.sin(second) + sin * p["m_x"] + cos * p["m_y"]
        return np.stack(np.broadcast_arrays(x, y, phi), axis=-1)
