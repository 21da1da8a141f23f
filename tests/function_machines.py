"""Small machines of one function that the tests share."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings import Channel, Coordinate, FunctionModel, Parameters, ReadingMachine
from bayescal.numerics.analytic import atan2


class PointOnLines(ReadingMachine):
    """A point in the plane on lines from anchors, their lengths read from zeros of their own."""

    member = "line"

    def __init__(self, anchors: np.ndarray, zero: float = 0.0, bearing: bool = False) -> None:
        n = len(anchors)
        self.parameters = [
            ParameterBlock("a_x", tuple(anchors[:, 0])),
            ParameterBlock("a_y", tuple(anchors[:, 1])),
            ParameterBlock("zero", (zero,) * n),
        ]
        self.coordinates = [Coordinate("x", "mm", 0.0, 150.0), Coordinate("y", "mm", 0.0, 150.0)]
        self.channels = [Channel(f"l[{k + 1}]", "mm") for k in range(n)]
        self.bearing = bearing
        if bearing:
            self.channels.append(Channel("bearing", "rad", external=True, period=2.0 * np.pi))

    def read(self, parameters: Parameters, v: Any, given: Any) -> Any:
        x, y = v[..., 0, None] - parameters["a_x"], v[..., 1, None] - parameters["a_y"]
        length = np.sqrt(x**2 + y**2) - parameters["zero"]
        if not self.bearing:
            return length
        return np.concatenate([length, atan2(y[..., :1], x[..., :1])], axis=-1)


def point_on_lines(n: int = 3, radius: float = 400.0, bearing: bool = False) -> FunctionModel:
    """Return a point on n lines from a circle."""
    angle = 2.0 * np.pi * np.arange(n) / n + 0.3
    return FunctionModel("lines", PointOnLines(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), 0.0, bearing))
