"""A force cell as a user writes it: three bridges under known loads."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine


class Cell(ReadingMachine):
    """Bridges g = K f, K near one."""

    member = "bridge"
    parameters = [ParameterBlock(f"k_{axis}", tuple(np.eye(3)[k]), "1") for k, axis in enumerate("xyz")]
    coordinates = [Coordinate(f"f{axis}", "N", 0.0, 25.0) for axis in "xyz"]
    tool_channels = [Channel(f"f{axis}", "N") for axis in "xyz"]
    channels = [
        *(Channel(f"g[{k}]", "mV") for k in (1, 2, 3)),
        *(Channel(f"f{axis}", "N", external=True) for axis in "xyz"),
    ]

    def read(self, p, v, given):
        """Return bridges and loads."""
        bridges = sum(p[f"k_{axis}"] * v[..., k, None] for k, axis in enumerate("xyz"))
        return np.concatenate([bridges, np.broadcast_to(v, bridges.shape)], axis=-1)
