"""A carriage on a line and two posts beside it, each of which may be on either side."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine


class Posts(ReadingMachine):
    member = "post"
    commanded = ("s",)

    def __init__(self, config):
        super().__init__(config)
        self.parameters = [
            ParameterBlock("a", (-40.0, 60.0)),
            ParameterBlock("b", (3.0, -2.0)),
            ParameterBlock("s0", (0.0,), per_leg=False),
        ]
        self.coordinates = [Coordinate("x", "mm", 0.0, 80.0)]
        self.tool_channels = [Channel("x", "mm")]
        self.channels = [Channel("s", "mm"), *(Channel(f"d[{k}]", "mm", external=True) for k in (1, 2))]

    def read(self, parameters, v, given):
        x = v[..., 0, None]
        away = np.sqrt((x - parameters["a"]) ** 2 + parameters["b"] ** 2)
        return np.concatenate([np.broadcast_to(x - parameters["s0"][..., None], (*away.shape[:-1], 1)), away], axis=-1)
