"""A linear delta: three vertical columns with carriages, three pairs of rods, a platform that stays level."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine, Section


class DeltaConfig(Section):
    """What [machine] in machine.toml says."""

    column_radius_mm: float
    rod_mm: float


class LinearDelta(ReadingMachine):
    """Carriages at heights s above the bed; a probe touches it: tool z is read against the plane of the bed."""

    Config = DeltaConfig
    member = "column"

    def __init__(self, config: DeltaConfig) -> None:
        angle = np.radians([90.0, 210.0, 330.0])
        self.parameters = [
            ParameterBlock("x", tuple(config.column_radius_mm * np.cos(angle))),
            ParameterBlock("y", tuple(config.column_radius_mm * np.sin(angle))),
            ParameterBlock("l", (config.rod_mm,) * 3, lower=0.0),
            ParameterBlock("s0", (0.0,) * 3),  # where a carriage has its zero
            ParameterBlock("t_x", (0.0,), "rad", per_leg=False),  # how the bed is tilted
            ParameterBlock("t_y", (0.0,), "rad", per_leg=False),
        ]
        self.coordinates = [
            Coordinate("x", "mm", 0.0, 80.0),
            Coordinate("y", "mm", 0.0, 80.0),
            Coordinate("z", "mm", 20.0, 20.0),
        ]
        self.tool_channels = [Channel(axis, "mm") for axis in "xyz"]  # what has to be accurate: the coordinates
        self.channels = [
            *(Channel(f"s[{k}]", "mm") for k in (1, 2, 3)),
            *(Channel(name, "mm", external=True) for name in ("cam_x", "cam_y", "height")),
        ]

    def read(self, parameters, v, given):
        x, y, z = v[..., 0, None], v[..., 1, None], v[..., 2, None]
        across = (x - parameters["x"]) ** 2 + (y - parameters["y"]) ** 2
        s = z + np.sqrt(parameters["l"] ** 2 - across) - parameters["s0"]
        bed = parameters["t_x"] * v[..., 0] + parameters["t_y"] * v[..., 1]
        seen = np.broadcast_arrays(v[..., 0], v[..., 1], v[..., 2] - bed)
        return np.concatenate([s, np.broadcast_to(np.stack(seen, axis=-1), s.shape)], axis=-1)
