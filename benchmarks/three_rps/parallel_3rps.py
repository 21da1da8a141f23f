"""A 3-RPS, as a user would write it: three legs on revolute joints carry a platform on spherical ones.

Two ways to say where it stands: by the height and both tilts that it can be driven to, the way sideways and the turn
about the vertical being solved for; or by all six coordinates, with three readings that are zero by its joints.
"""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine, Section
from bayescal.numerics.analytic import atan2, norm

NEWTON_STEPS = 10


class ThreeRpsConfig(Section):
    """What [machine] in machine.toml says."""

    base_radius_mm: float
    platform_radius_mm: float
    tracked_radius_mm: float
    height_mm: float


class _Platform(ReadingMachine):
    """Parameters and sensors of both: encoders, angles of the joints at the base, three points that a tracker sees."""

    tool_channels = (Channel("x", "mm"), Channel("y", "mm"), Channel("z", "mm"))

    Config = ThreeRpsConfig

    def __init__(self, config: ThreeRpsConfig) -> None:
        angle = np.radians([90.0, 210.0, 330.0])
        cosine, sine = np.cos(angle), np.sin(angle)
        base, platform, tracked = config.base_radius_mm, config.platform_radius_mm, config.tracked_radius_mm
        self.parameters = [
            ParameterBlock("b_x", tuple(base * cosine)),
            ParameterBlock("b_y", tuple(base * sine)),
            ParameterBlock("b_z", (0.0,) * 3),
            ParameterBlock("p_x", tuple(platform * cosine)),
            ParameterBlock("p_y", tuple(platform * sine)),
            ParameterBlock("p_z", (0.0,) * 3),
            ParameterBlock("m_x", tuple(-tracked * cosine)),  # the tracked points
            ParameterBlock("m_y", tuple(-tracked * sine)),
            ParameterBlock("m_z", (30.0,) * 3),
            ParameterBlock("heading", tuple(angle + 0.5 * np.pi), "rad"),  # of a joint's axis
            ParameterBlock("rise", (0.0,) * 3, "rad"),
            ParameterBlock("l0", (0.0,) * 3),
            ParameterBlock("gain", (1.0,) * 3, "1"),
            ParameterBlock("q0", (0.0,) * 3, "rad"),
        ]
        self.channels = [
            *(Channel(f"l[{k}]", "mm") for k in (1, 2, 3)),
            *(Channel(f"q[{k}]", "rad") for k in (1, 2, 3)),
            *(Channel(f"{axis}[{k}]", "mm", external=True) for axis in ("t_x", "t_y", "t_z") for k in (1, 2, 3)),
            *(Channel(f"c[{k}]", "mm") for k in (1, 2, 3)),  # how far a joint is off its plane: zero
        ]

    def see(self, p, origin, rotation):
        """Return all readings of a platform that stands somewhere."""
        base, joints, tracked = (
            np.stack([p[f"{name}_x"], p[f"{name}_y"], p[f"{name}_z"]], axis=-1) for name in ("b", "p", "m")
        )
        leg = origin[..., None, :] + np.einsum("...ij,...kj->...ki", rotation, joints) - base
        axis = self.axes(p)
        inward = np.stack([axis[..., 1], -axis[..., 0], np.zeros_like(axis[..., 0])], axis=-1)
        upward = np.cross(axis, inward)
        swing = atan2((leg * inward).sum(axis=-1), -(leg * upward).sum(axis=-1))
        seen = origin[..., None, :] + np.einsum("...ij,...kj->...ki", rotation, tracked)
        length = (norm(leg) - p["l0"]) / p["gain"]
        off = (axis * leg).sum(axis=-1)
        return np.concatenate([length, swing - p["q0"], seen[..., 0], seen[..., 1], seen[..., 2], off], axis=-1)

    def axes(self, p):
        """Return the directions of the revolute joints, (..., 3, 3)."""
        level = np.cos(p["rise"])
        return np.stack([level * np.cos(p["heading"]), level * np.sin(p["heading"]), np.sin(p["rise"])], axis=-1)


class SolvedThreeRps(_Platform):
    """It stands at a height and two tilts; the axes of the revolute joints say where it goes sideways and turns."""

    def __init__(self, config: ThreeRpsConfig) -> None:
        super().__init__(config)
        self.coordinates = [
            Coordinate("z", "mm", config.height_mm, 60.0),
            Coordinate("tilt_x", "rad", 0.0, 0.25),
            Coordinate("tilt_y", "rad", 0.0, 0.25),
        ]

    def place(self, p, v):
        """Return where the platform's origin stands, (..., 3), and how it is turned, (..., 3, 3)."""
        base = np.stack([p["b_x"], p["b_y"], p["b_z"]], axis=-1)
        joints = np.stack([p["p_x"], p["p_y"], p["p_z"]], axis=-1)
        axis = self.axes(p)
        z = v[..., 0]
        tilt = tilt_matrix(v[..., 1], v[..., 2])
        tilted = np.einsum("...ij,...kj->...ki", tilt, joints)
        x = np.zeros(np.broadcast_shapes(tilted.shape[:-2], z.shape), dtype=np.result_type(p["b_x"], v))
        y, turn = x.copy(), x.copy()
        for _ in range(NEWTON_STEPS):
            cosine, sine = np.cos(turn)[..., None], np.sin(turn)[..., None]
            along, across = tilted[..., 0], tilted[..., 1]
            moved = np.stack(
                np.broadcast_arrays(
                    x[..., None] + cosine * along - sine * across,
                    y[..., None] + sine * along + cosine * across,
                    z[..., None] + tilted[..., 2],
                ),
                axis=-1,
            )
            error = (axis * (moved - base)).sum(axis=-1)
            by_turn = axis[..., 0] * (-sine * along - cosine * across) + axis[..., 1] * (cosine * along - sine * across)
            slope = np.stack(np.broadcast_arrays(axis[..., 0], axis[..., 1], by_turn), axis=-1)
            step = np.linalg.solve(slope, error[..., None])[..., 0]
            x, y, turn = x - step[..., 0], y - step[..., 1], turn - step[..., 2]
        rotation = turn_matrix(turn) @ tilt
        return np.stack(np.broadcast_arrays(x, y, z), axis=-1), rotation

    def read(self, parameters, v, given):
        """Return the readings; see `_Platform.see`."""
        return self.see(parameters, *self.place(parameters, v))

    def tool(self, parameters, v):
        """Return where the platform's origin is."""
        return self.place(parameters, v)[0]


class FreeThreeRps(_Platform):
    """It stands at six coordinates, which the channels ``c`` hold to the three that its joints leave."""

    def __init__(self, config: ThreeRpsConfig) -> None:
        super().__init__(config)
        self.coordinates = [
            Coordinate("x", "mm", 0.0, 20.0),
            Coordinate("y", "mm", 0.0, 20.0),
            Coordinate("z", "mm", config.height_mm, 60.0),
            Coordinate("tilt_x", "rad", 0.0, 0.25),
            Coordinate("tilt_y", "rad", 0.0, 0.25),
            Coordinate("turn", "rad", 0.0, 0.05),
        ]

    def read(self, parameters, v, given):
        """Return the readings; see `_Platform.see`."""
        return self.see(parameters, v[..., :3], turn_matrix(v[..., 5]) @ tilt_matrix(v[..., 3], v[..., 4]))

    def tool(self, parameters, v):
        """Return where the platform's origin is."""
        return v[..., :3]


def tilt_matrix(a, b):
    """Return turns by b about y after a about x, (..., 3, 3)."""
    ca, sa, cb, sb, zero = np.cos(a), np.sin(a), np.cos(b), np.sin(b), np.zeros_like(a)
    rows = [[cb, sb * sa, sb * ca], [zero, ca, -sa], [-sb, cb * sa, cb * ca]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def turn_matrix(angle):
    """Return turns about z, (..., 3, 3)."""
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    rows = [[c, -s, zero], [s, c, zero], [zero, zero, one]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
