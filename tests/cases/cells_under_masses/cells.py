"""A platform on four load cells: known masses are set on known places, and nothing moves."""

import numpy as np

from bayescal import Channel, ParameterBlock, ReadingMachine

SIDES = ((-1, -1), (1, -1), (1, 1), (-1, 1))


class Platform(ReadingMachine):
    """Cells share a load as a rigid plate on four equal springs does."""

    parameters = [ParameterBlock("gain", (2.0,) * 4, "mV/kg"), ParameterBlock("zero", (0.0,) * 4, "mV")]
    coordinates = []
    given = ("mass_kg", "at_x_mm", "at_y_mm")
    channels = [Channel(f"u[{k}]", "mV") for k in (1, 2, 3, 4)]

    def read(self, p, v, given):
        mass, x, y = (given[name] for name in self.given)
        share = [0.25 * mass * (1 + i * x / 200.0 + j * y / 150.0) for i, j in SIDES]
        return np.stack([p["gain"][..., k] * share[k] + p["zero"][..., k] for k in range(4)], axis=-1)
