"""A delta printer that probes its bed and measures what it has printed: two places of the nozzle are a row."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine, Section


class PrinterConfig(Section):
    """What [machine] in machine.toml says."""

    radius_mm: float
    angle_deg: list[float]
    arm_mm: float
    endstop_mm: float


class DeltaPrinter(ReadingMachine):
    """Carriages s below their endstops at two places, how high the nozzle is there, and how far one is from the other.

    Parameters as in Klipper: the towers' radius and directions, arms, and the nozzle's height with a carriage at its
    endstop.
    """

    Config = PrinterConfig
    member = "tower"

    def __init__(self, config: PrinterConfig) -> None:
        self.parameters = [
            ParameterBlock("r", (config.radius_mm,), per_leg=False, lower=0.0),
            ParameterBlock("angle", tuple(np.radians(config.angle_deg)), "rad"),
            ParameterBlock("l", (config.arm_mm,) * 3, lower=0.0),
            ParameterBlock("e", (config.endstop_mm,) * 3),
        ]
        self.coordinates = [
            Coordinate(f"{axis}{k}", "mm", 20.0 * sign if axis == "x" else middle, reach)
            for k, sign in ((1, -1.0), (2, 1.0))  # two places, not the same one
            for axis, middle, reach in (("x", 0.0, 100.0), ("y", 0.0, 100.0), ("z", 20.0, 20.0))
        ]
        self.tool_channels = [Channel(axis, "mm") for axis in "xyz"]
        self.channels = [
            *(Channel(f"s[{k}]", "mm") for k in range(1, 7)),
            *(Channel(f"height[{k}]", "mm", external=True) for k in (1, 2)),
            Channel("distance", "mm", external=True),
        ]

    def read(self, parameters, v, given):
        one, other = v[..., :3], v[..., 3:]
        way = other - one
        distance = np.sqrt((way * way).sum(axis=-1, keepdims=True))
        carriages = [self.lower(parameters, place) for place in (one, other)]
        seen = [*carriages, one[..., 2:], other[..., 2:], distance]
        leading = np.broadcast_shapes(*(part.shape[:-1] for part in seen))
        return np.concatenate([np.broadcast_to(part, (*leading, part.shape[-1])) for part in seen], axis=-1)

    def lower(self, parameters, place):
        """Return how far the carriages are below their endstops, (..., 3)."""
        r, arm = parameters["r"][..., None], parameters["l"]
        across = (place[..., :1] - r * np.cos(parameters["angle"])) ** 2
        across = across + (place[..., 1:2] - r * np.sin(parameters["angle"])) ** 2
        return parameters["e"] + np.sqrt(arm**2 - r**2) - place[..., 2:] - np.sqrt(arm**2 - across)

    def tool(self, parameters, v):
        return v[..., :3]
