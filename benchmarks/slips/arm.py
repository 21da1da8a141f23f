"""A serial arm of three turning joints, seen by a tracker: its class as somebody writes it beside a machine."""

from __future__ import annotations

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine


class Arm(ReadingMachine):
    """A column that turns, a shoulder and an elbow; encoders with offsets, a tracker that sees the tool."""

    member = "joint"
    tool_channels = (Channel("x", "mm"), Channel("y", "mm"), Channel("z", "mm"))

    def __init__(self, config: object) -> None:
        super().__init__(config)
        self.parameters = [
            ParameterBlock("a", (400.0, 350.0), lower=0.0),
            ParameterBlock("h", (300.0,), per_leg=False),
            ParameterBlock("o", (0.0, 0.0, 0.0), "rad"),
        ]
        self.coordinates = [
            Coordinate("q1", "rad", 0.0, 1.0),
            Coordinate("q2", "rad", 0.6, 0.4),
            Coordinate("q3", "rad", -1.2, 0.4),
        ]
        self.channels = [
            *(Channel(f"encoder[{k}]", "rad") for k in (1, 2, 3)),
            *(Channel(f"tracker_{axis}", "mm", external=True) for axis in "xyz"),
        ]

    def read(self, parameters, v, given):
        """Return encoders and tracker."""
        seen = self.tool(parameters, v)
        encoders = np.broadcast_to(v - parameters["o"], seen.shape)
        return np.concatenate([encoders, seen], axis=-1)

    def tool(self, parameters, v):
        """Return where the tool is, mm."""
        upper, lower = parameters["a"][..., 0], parameters["a"][..., 1]
        first, second = v[..., 1], v[..., 1] + v[..., 2]
        out = upper * np.cos(first) + lower * np.cos(second)
        up = parameters["h"] + upper * np.sin(first) + lower * np.sin(second)
        return np.stack(np.broadcast_arrays(np.cos(v[..., 0]) * out, np.sin(v[..., 0]) * out, up), axis=-1)
