"""A five-bar: two cranks that motors turn in a plane, and a coupler from the end of each to the tool where they meet.

Motor i stands at (x_i, y_i), its crank of length L_i points to θ_i, counted from x to y; the coupler of length l_i
reaches from the elbow there to the tool p. With the way w = p - (x_i, y_i) to the tool,

    θ_i = atan2(w_y, w_x) ± atan2(sqrt(w² - k²), k),   k = (L_i² + w² - l_i²) / (2 L_i),

plus where the elbow is to the left of that way, minus to the right. Encoders read θ_i - o_i, o_i where a crank points
when its encoder reads zero. Four ways of assembly have the same tool, elbows to either side, which the file states; of
the two tools that the same cranks have it is that on the side of the workspace.

With u = p - elbow and e = ∂elbow/∂θ, u² = l² gives ∂θ/∂p = u / (u·e): it grows without limit where crank and coupler
come into line.

Frame and place of the whole are a convention: one motor, and the other's y, stay as stated. While angles alone are read
all lengths scale together: a distance, or one length, tells the size. Zeros and lengths of one arm look alike over a
small workspace.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from bayescal.config.sections import Length, Number, Section
from bayescal.errors import say_reversed
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import Channel, Coordinate, Given
from bayescal.machines.readings.delta import stack_points
from bayescal.machines.readings.function import Parameters, ReadingMachine
from bayescal.numerics.analytic import atan2, sqrt

LEFT: Final = "left"
type Pair[T] = Annotated[list[T], Field(min_length=2, max_length=2)]


class FiveBarConfig(Section):
    """A five-bar; lists have the first arm, then the second."""

    motors_mm: Pair[Pair[Number]]
    """Where each motor's axis is, x and y."""
    crank_mm: Pair[Length]
    """Lengths from the motors to the elbows."""
    coupler_mm: Pair[Length]
    """Lengths from the elbows to the tool."""
    elbows: Pair[Literal["left", "right"]] = Field(default=["left", "right"])
    """On which side of the way from each motor to the tool its elbow is."""
    zero_deg: Pair[Number] = Field(default=[0.0, 0.0])
    """Where each crank points when its encoder reads zero, counted from x to y."""
    workspace_mm: Pair[Pair[Number]]
    """Smallest and largest x, then y, of the tool where accuracy counts."""

    @model_validator(mode="after")
    def _check_ends(self) -> Self:
        for low, high in self.workspace_mm:
            if low >= high:
                raise ValueError(say_reversed("workspace_mm", low, high))
        if self.motors_mm[0] == self.motors_mm[1]:
            raise ValueError(f"motors_mm: found both at {self.motors_mm[0]}, expected two places")
        return self


class FiveBar(ReadingMachine):
    """Encoders of two cranks; instruments see the tool.

    Parameters: ``x``, ``y``, ``L`` and ``l``, mm; ``o``, rad. Coordinates: x and y of the tool, mm. Channels: ``q``, of
    each crank, rad.
    """

    Config = FiveBarConfig
    member = "arm"
    tool_channels = (Channel("x", "mm"), Channel("y", "mm"))
    channels = (Channel("q[1]", "rad"), Channel("q[2]", "rad"))

    def __init__(self, config: FiveBarConfig) -> None:
        """Lay out parameters and coordinates."""
        super().__init__(config)
        self.sides = [1.0 if one == LEFT else -1.0 for one in config.elbows]
        self.parameters = [
            *(ParameterBlock(one, tuple(place[k] for place in config.motors_mm)) for k, one in enumerate("xy")),
            ParameterBlock("L", tuple(config.crank_mm), lower=0.0),
            ParameterBlock("l", tuple(config.coupler_mm), lower=0.0),
            ParameterBlock("o", tuple(np.radians(config.zero_deg).tolist()), "rad"),
        ]
        ends = zip("xy", config.workspace_mm, strict=True)
        self.coordinates = [Coordinate(one, "mm", (low + high) / 2.0, (high - low) / 2.0) for one, (low, high) in ends]

    def read(self, parameters: Parameters, v: np.ndarray, given: Given) -> np.ndarray:
        """Return what encoders read."""
        del given
        turned = [angle - parameters["o"][..., k] for k, angle in enumerate(self._turn_cranks(parameters, v))]
        return np.stack(np.broadcast_arrays(*turned), axis=-1)

    def _turn_cranks(self, parameters: Parameters, v: np.ndarray) -> list[np.ndarray]:
        """Return where each crank points, arrays (...)."""
        cranks = []
        for k, side in enumerate(self.sides):
            x, y = v[..., 0] - parameters["x"][..., k], v[..., 1] - parameters["y"][..., k]
            crank, coupler, square = parameters["L"][..., k], parameters["l"][..., k], x * x + y * y
            share = (crank * crank + square - coupler * coupler) / (2.0 * crank)
            cranks.append(atan2(y, x) + side * atan2(sqrt(square - share * share), share))
        return cranks

    def slopes(self, parameters: Parameters, v: np.ndarray, given: Given) -> Sequence[Sequence[np.ndarray | float]]:
        """Return ∂θ/∂p in closed form."""
        del given
        rows = []
        for k, angle in enumerate(self._turn_cranks(parameters, v)):
            crank, cosine, sine = parameters["L"][..., k], np.cos(angle), np.sin(angle)
            x = v[..., 0] - parameters["x"][..., k] - crank * cosine
            y = v[..., 1] - parameters["y"][..., k] - crank * sine
            lever = crank * (y * cosine - x * sine)
            rows.append([x / lever, y / lever])
        return rows

    def outline(self, parameters: Parameters, v: np.ndarray) -> tuple[np.ndarray, Sequence[tuple[int, int]]]:
        """Return the tool, both elbows and both motors, in the plane z = 0."""
        motors, elbows = [], []
        for k, angle in enumerate(self._turn_cranks(parameters, v)):
            x, y, crank = (parameters[symbol][..., k] for symbol in ("x", "y", "L"))
            motors.append([x, y, 0.0 * x])
            elbows.append([x + crank * np.cos(angle), y + crank * np.sin(angle), 0.0 * x])
        tool = [v[..., 0], v[..., 1], 0.0 * v[..., 0]]
        return stack_points([tool, *elbows, *motors]), [(0, 1), (0, 2), (1, 3), (2, 4)]
