"""A rotary delta: three upper arms that turn about shoulders, lower arms to a tool that does not turn.

Shoulder i stands at r (cos α_i, sin α_i) and height h, the tool's joint already off the radius r; its upper arm of
length L_i is turned by θ_i from the horizontal, positive upwards, its lower arm has length l_i. Seen from shoulder i
the point p = (x, y, z) is a = x cos α_i + y sin α_i - r outwards, c = y cos α_i - x sin α_i aside and w = z - h up, and
the elbow at (L_i cos θ_i, 0, L_i sin θ_i) is l_i away:

    a cos θ_i + w sin θ_i = k,   k = (L_i² + a² + w² + c² - l_i²) / (2 L_i),

    θ_i = atan2(w, a) + atan2(sqrt(a² + w² - k²), k),

the elbow outwards. Encoders read θ_i - o_i, o their zeros. All lengths scale together while only angles and the heights
of a flat bed are read and h is unknown: a distance, or h, tells their size. The directions of x and y are a convention:
one angle stays as stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from bayescal.config.sections import Length, Number
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import Given
from bayescal.machines.readings.delta import (
    ARMS,
    TOWERS,
    EachTower,
    RoundWorkspace,
    ToolOverBed,
    spread_over_towers,
    stack_points,
)
from bayescal.machines.readings.function import Parameters
from bayescal.numerics.analytic import atan2, sqrt


class RotaryDeltaConfig(RoundWorkspace):
    """A rotary delta; lengths of arms are one for all or one each."""

    radius_mm: Length
    """From the centre to the shoulders' axes, less what the tool takes of it."""
    height_mm: Number
    """Height of the shoulders over the bed."""
    upper_arm_mm: EachTower[Length]
    """Lengths of the upper arms from shoulder to elbow."""
    lower_arm_mm: EachTower[Length]
    """Lengths of the lower arms from elbow to tool."""
    angle_deg: Annotated[list[Number], Field(min_length=TOWERS, max_length=TOWERS)] = Field(
        default=[30.0, 150.0, 270.0]
    )
    """Directions of the shoulders from the centre, counted from x to y."""


class RotaryDelta(ToolOverBed):
    """Encoders of the upper arms, and the height that a probe on the tool reads of the bed.

    Parameters: ``r``, ``h``, ``L`` and ``l``, mm; ``angle`` and ``o``, rad. Coordinates: x, y, z of the tool, mm.
    Channels: ``q``, of each arm, rad, and ``height``, mm.
    """

    Config = RotaryDeltaConfig
    member = "arm"

    def __init__(self, config: RotaryDeltaConfig) -> None:
        """Lay out parameters, coordinates and channels."""
        super().__init__(config, "q", "rad")
        self.parameters = [
            ParameterBlock("r", (config.radius_mm,), per_leg=False, lower=0.0),
            ParameterBlock("h", (config.height_mm,), per_leg=False),
            ParameterBlock("angle", tuple(np.radians(config.angle_deg).tolist()), "rad"),
            ParameterBlock("L", spread_over_towers(config.upper_arm_mm), lower=0.0),
            ParameterBlock("l", spread_over_towers(config.lower_arm_mm), lower=0.0),
            ParameterBlock("o", (0.0,) * TOWERS, "rad"),
        ]

    def read(self, parameters: Parameters, v: np.ndarray, given: Given) -> np.ndarray:
        """Return what encoders read, and the height."""
        del given
        encoders = [turned - parameters["o"][..., k] for k, turned in enumerate(self._turn_arms(parameters, v))]
        return np.stack(np.broadcast_arrays(*encoders, v[..., 2]), axis=-1)

    def _turn_arms(self, parameters: Parameters, v: np.ndarray) -> list[np.ndarray]:
        """Return by how much each upper arm is turned from the horizontal, arrays (...)."""
        x, y = v[..., 0], v[..., 1]
        up, arms = v[..., 2] - parameters["h"], []
        for k in range(TOWERS):
            cosine, sine = np.cos(parameters["angle"][..., k]), np.sin(parameters["angle"][..., k])
            upper, lower = parameters["L"][..., k], parameters["l"][..., k]
            out, aside = x * cosine + y * sine - parameters["r"], y * cosine - x * sine
            square = out * out + up * up
            share = (upper * upper + square + aside * aside - lower * lower) / (2.0 * upper)
            arms.append(atan2(up, out) + atan2(sqrt(square - share * share), share))
        return arms

    def outline(self, parameters: Parameters, v: np.ndarray) -> tuple[np.ndarray, Sequence[tuple[int, int]]]:
        """Return the tool, the elbows and the shoulders."""
        radius, height, elbows, shoulders = parameters["r"], parameters["h"], [], []
        for k, turned in enumerate(self._turn_arms(parameters, v)):
            angle, upper = parameters["angle"][..., k], parameters["L"][..., k]
            out = radius + upper * np.cos(turned)
            elbows.append([out * np.cos(angle), out * np.sin(angle), height + upper * np.sin(turned)])
            shoulders.append([radius * np.cos(angle), radius * np.sin(angle), height])
        return stack_points([[v[..., 0], v[..., 1], v[..., 2]], *elbows, *shoulders]), ARMS
