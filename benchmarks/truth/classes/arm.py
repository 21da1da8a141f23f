"""A serial arm of six turning joints as a user writes it: one function of its parameters and joint angles."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine


class Arm(ReadingMachine):
    """Denavit and Hartenberg's numbers of each joint; a tracker sees where the tool is."""

    member = "joint"
    tool_channels = (Channel("x", "mm"), Channel("y", "mm"), Channel("z", "mm"))

    def __init__(self, config):
        super().__init__(config)
        right = np.pi / 2
        self.parameters = [
            ParameterBlock("a", (150.0, 600.0, 120.0, 0.0, 0.0, 40.0)),
            ParameterBlock("d", (450.0, 0.0, 0.0, 640.0, 0.0, 150.0)),
            ParameterBlock("alpha", (right, 0.0, right, -right, right, 0.0), "rad"),
            ParameterBlock("o", (0.0,) * 6, "rad"),
        ]
        home, size = (0.0, 1.2, -0.4, 0.0, 0.6, 0.0), (1.2, 0.5, 0.6, 1.2, 0.8, 1.2)
        self.coordinates = [Coordinate(f"q{k + 1}", "rad", *one) for k, one in enumerate(zip(home, size, strict=True))]
        self.channels = [
            *(Channel(f"encoder[{k}]", "rad") for k in range(1, 7)),
            *(Channel(f"tracker_{axis}", "mm", external=True) for axis in "xyz"),
        ]

    def read(self, parameters, v, given):
        """Return actuators and what the tracker sees."""
        place = self.tool(parameters, v)
        encoders = np.broadcast_to(v - parameters["o"], (*place.shape[:-1], 6))
        return np.concatenate([encoders, place], axis=-1)

    def tool(self, parameters, v):
        """Return where the tool is."""
        place = None
        for k in reversed(range(6)):  # from the tool inwards: place in the frame before joint k
            a, d, alpha = (parameters[name][..., k] for name in ("a", "d", "alpha"))
            x, y, z = (0.0, 0.0, 0.0) if place is None else place
            y, z = np.cos(alpha) * y - np.sin(alpha) * z, np.sin(alpha) * y + np.cos(alpha) * z
            x, z = x + a, z + d
            cos, sin = np.cos(v[..., k]), np.sin(v[..., k])
            place = cos * x - sin * y, sin * x + cos * y, z
        return np.stack(np.broadcast_arrays(*place), axis=-1)
