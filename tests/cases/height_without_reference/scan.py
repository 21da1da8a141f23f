"""A laser triangulation scanner that a stage moves up over a gauge: pixel and stage scale; gauge blocks of known height."""
import numpy as np
from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine


class Scanner(ReadingMachine):
    """Laser straight down, camera beside it, tilted."""

    def __init__(self, config):
        self.parameters = [
            ParameterBlock("base", (80.0,), per_leg=False),
            ParameterBlock("tilt", (np.radians(40.0),), "rad", per_leg=False),
            ParameterBlock("f", (2400.0,), "px", per_leg=False),
            ParameterBlock("lead", (1.0,), "1", per_leg=False),
            ParameterBlock("zero", (0.0,), per_leg=False),
        ]
        self.coordinates = [Coordinate("z", "mm", 95.0, 20.0)]  # stand-off of the surface
        self.given = ("block_mm",)
        self.channels = [Channel("stage", "mm"), Channel("row", "px")]

    def read(self, p, v, given):
        z = v[..., 0]
        stage = (z + given["block_mm"] - p["zero"]) / p["lead"]
        angle = np.arctan(p["base"] / z) - p["tilt"]
        return np.stack(np.broadcast_arrays(stage, p["f"] * np.tan(angle)), axis=-1)
