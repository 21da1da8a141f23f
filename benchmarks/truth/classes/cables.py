"""A cable robot as a user writes it: eight cables from a frame to a platform, whose pose a tracker sees."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine

AXES = ("x", "y", "z", "rx", "ry", "rz")


class Cables(ReadingMachine):
    """Lengths of cables between points a of the frame and p + R b of the platform, less their zeros."""

    member = "cable"
    tool_channels = tuple(Channel(axis, "mm") for axis in AXES[:3])

    def __init__(self, config):
        super().__init__(config)
        corners = [(i, j, k) for k in (-1, 1) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        points = [("a", (600.0, 500.0, 400.0)), ("b", (80.0, 60.0, -50.0))]
        self.parameters = [
            *(
                ParameterBlock(f"{name}_{axis}", tuple(float(corner[k] * size[k]) for corner in corners))
                for name, size in points
                for k, axis in enumerate("xyz")
            ),
            ParameterBlock("l0", (0.0,) * 8),
        ]
        self.coordinates = [
            *(Coordinate(axis, "mm", 0.0, 200.0) for axis in AXES[:3]),
            *(Coordinate(axis, "rad", 0.0, 0.12) for axis in AXES[3:]),
        ]
        self.channels = [
            *(Channel(f"cable[{k}]", "mm") for k in range(1, 9)),
            *(Channel(f"tracker_{axis}", "mm", external=True) for axis in AXES[:3]),
            *(Channel(f"tracker_{axis}", "rad", external=True, rotation="r") for axis in AXES[3:]),
        ]

    def read(self, parameters, v, given):
        """Return actuators and what the tracker sees."""
        square, axis = 0.0, [v[..., k, None] for k in (3, 4, 5)]
        angle = np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2 + 1e-24)
        sine, cosine = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
        b = [parameters[f"b_{name}"] for name in "xyz"]
        inner = axis[0] * b[0] + axis[1] * b[1] + axis[2] * b[2]
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            turned = np.cos(angle) * b[k] + sine * (axis[i] * b[j] - axis[j] * b[i]) + cosine * inner * axis[k]
            square = square + (v[..., k, None] + turned - parameters[f"a_{'xyz'[k]}"]) ** 2
        lengths = np.sqrt(square) - parameters["l0"]
        seen = np.broadcast_to(v, (*lengths.shape[:-1], 6))
        return np.concatenate([lengths, seen], axis=-1)

    def tool(self, parameters, v):
        """Return where the tool is."""
        return v[..., :3]
