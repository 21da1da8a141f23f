"""A force cell of six axes as a user writes it: six outputs, a full matrix and six zeros."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine

LOADS = {"fx": "N", "fy": "N", "fz": "N", "mx": "Nm", "my": "Nm", "mz": "Nm"}
GAINS = np.diag([1.0, 1.0, 1.0, 10.0, 10.0, 10.0])


class Cell6(ReadingMachine):
    """Outputs g = K f + z."""

    member = "output"
    parameters = [
        *(ParameterBlock(f"k_{load}", tuple(GAINS[k]), "1") for k, load in enumerate(LOADS)),
        ParameterBlock("zero", (0.0,) * 6, "1"),
    ]
    coordinates = [Coordinate(load, unit, 0.0, 50.0 if unit == "N" else 3.0) for load, unit in LOADS.items()]
    tool_channels = [Channel(load, unit) for load, unit in LOADS.items()]
    channels = [
        *(Channel(f"g[{k}]", "mV") for k in range(1, 7)),
        *(Channel(load, unit, external=True) for load, unit in LOADS.items()),
    ]

    def read(self, p, v, given):
        """Return outputs and loads."""
        outputs = p["zero"] + sum(p[f"k_{load}"] * v[..., k, None] for k, load in enumerate(LOADS))
        return np.concatenate([outputs, np.broadcast_to(v, outputs.shape)], axis=-1)
