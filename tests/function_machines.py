"""Machines of one function that the tests share: Sliding Star written as one, and small ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from sliding_platforms import sliding_star

from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings import Channel, Coordinate, FunctionModel, Parameters, ReadingMachine, SlidingPlatform
from bayescal.numerics.analytic import atan2


class StarMachine(ReadingMachine):
    """Sliding Star by its geometry alone, all derivatives left to the complex step."""

    def __init__(self, whole: SlidingPlatform) -> None:
        self.parameters = whole.layout.blocks
        self.coordinates, self.channels = whole.coordinates, whole.channels
        self.commanded, self.tool_channels = ["s"], whole.tool_channels
        self.sign = np.where(whole.forward, 1.0, -1.0)

    def read(self, parameters: Parameters, v: Any, given: Any) -> Any:
        p, phi = parameters, v[..., 2, None]
        cosine, sine = np.cos(phi), np.sin(phi)
        w_x = v[..., 0, None] + cosine * p["xi_B"] - sine * p["eta_B"] - p["x_P"]
        w_y = v[..., 1, None] + sine * p["xi_B"] + cosine * p["eta_B"] - p["y_P"]
        e_x, e_y = np.cos(p["beta"]), np.sin(p["beta"])
        across = e_x * w_y - e_y * w_x
        along = np.sqrt(p["l"] ** 2 - across**2)
        alpha = atan2(across, along)
        alpha = np.where(self.sign < 0.0, np.pi - alpha, alpha)
        legs = (e_x * w_x + e_y * w_y - self.sign * along, alpha - p["phi0"], alpha + p["beta"] - phi - p["psi0"])
        tool = np.broadcast_arrays(*self._place(p, v), v[..., 2])
        return np.concatenate([*legs, np.stack(tool, axis=-1)], axis=-1)

    def tool(self, parameters: Parameters, v: Any) -> Any:
        return np.stack(np.broadcast_arrays(*self._place(parameters, v)), axis=-1)

    def _place(self, p: Parameters, v: Any) -> tuple[Any, Any]:
        cosine, sine = np.cos(v[..., 2]), np.sin(v[..., 2])
        x, y = cosine * p["xi_V"] - sine * p["eta_V"], sine * p["xi_V"] + cosine * p["eta_V"]
        return v[..., 0] + x, v[..., 1] + y


def star_function(whole: SlidingPlatform | None = None) -> FunctionModel:
    """Return Sliding Star, or another star, as a machine of one function."""
    return FunctionModel("star", StarMachine(whole or sliding_star()))


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
