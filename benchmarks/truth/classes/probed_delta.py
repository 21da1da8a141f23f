"""A delta printer as a user writes it: three carriages below their endstops, and a probe that feels the bed."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine


class ProbedDelta(ReadingMachine):
    """Towers on a circle, arms, endstops."""

    member = "tower"
    parameters = [
        ParameterBlock("r", (172.0,), per_leg=False, lower=0.0),
        ParameterBlock("angle", tuple(np.radians([210.0, 330.0, 90.0])), "rad"),
        ParameterBlock("l", (340.0,) * 3, lower=0.0),
        ParameterBlock("e", (333.0,) * 3),
    ]
    coordinates = [
        Coordinate("x", "mm", 0.0, 140.0),
        Coordinate("y", "mm", 0.0, 140.0),
        Coordinate("z", "mm", 20.0, 25.0),
    ]
    tool_channels = [Channel(axis, "mm") for axis in "xyz"]
    channels = [*(Channel(f"s[{k}]", "mm") for k in (1, 2, 3)), Channel("height", "mm", external=True)]

    def read(self, p, v, given):
        """Return carriages and height."""
        r = p["r"][..., None]
        across = (v[..., :1] - r * np.cos(p["angle"])) ** 2 + (v[..., 1:2] - r * np.sin(p["angle"])) ** 2
        s = p["e"] + np.sqrt(p["l"] ** 2 - r**2) - v[..., 2:] - np.sqrt(p["l"] ** 2 - across)
        return np.concatenate([s, np.broadcast_to(v[..., 2:], (*s.shape[:-1], 1))], axis=-1)
