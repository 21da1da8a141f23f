"""A carriage on a line, its distance to a fixed point beside the line: the point may lie on either side."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine, Section


class Options(Section):
    a_mm: float
    b_mm: float
    c_mm: float


class Mirror(ReadingMachine):
    Config = Options

    def __init__(self, c):
        self.parameters = [
            ParameterBlock(n, (v,), per_leg=False) for n, v in (("a", c.a_mm), ("b", c.b_mm), ("c", c.c_mm))
        ]
        self.coordinates = [Coordinate("x", "mm", 0.0, 50.0)]
        self.tool_channels = [Channel("x", "mm")]
        self.channels = [Channel("s", "mm"), Channel("d", "mm", external=True), Channel("e", "mm", external=True)]

    def read(self, p, v, given):
        x = v[..., 0]
        d = np.sqrt((x - p["a"]) ** 2 + p["b"] ** 2)
        e = np.sqrt((x + 30.0) ** 2 + (p["c"] - 40.0) ** 2)
        return np.stack(np.broadcast_arrays(x, d, e), axis=-1)
