"""Machines of one function, simulated: each is declared by its symbols and sensors, and reads by vectors and matrices.

Beside each stands the class that a user writes of it (`classes/NAME.py`), which shares nothing with it. Closures are
solved by Newton's steps here, serial chains are products of matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from benchmarks.truth.simulated import NEWTON, Array, Simulated, rotate

TYPICAL = 200  # poses of the workspace that tell travels and what readings know of actuators
UNIT_MM = 10e-3
"""What an error of an actuator counts, mm at the tool, that is as large as noise leaves it uncertain at one pose."""

THREE = np.radians([90.0, 210.0, 330.0])
CORNERS = np.array([[i, j, k] for k in (-1, 1) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))], float)


class Symbol(NamedTuple):
    """Parameters of one symbol: nominal values, one or one a member, and their tolerance."""

    nominal: float | Sequence[float]
    sd: float
    unit: str = "mm"


class Sensor(NamedTuple):
    """Channels of one name: unit, noise, how many members have one, whether it stands beside the machine."""

    unit: str
    noise: float
    members: int = 0
    external: bool = False


class Function(Simulated):
    """A machine that is declared.

    Attributes
    ----------
    symbols : dict of str to Symbol
    sensors : dict of str to Sensor
        The machine's own first.
    fixed : tuple of str
        Parameters that define frames: known, and none of the names.
    """

    symbols: ClassVar[dict[str, Symbol]]
    sensors: ClassVar[dict[str, Sensor]]
    centre: ClassVar[Sequence[float]]
    half_widths: ClassVar[Sequence[float]]
    fixed: ClassVar[tuple[str, ...]] = ()

    def __init__(self) -> None:
        every = [name for symbol, one in self.symbols.items() for name in list_members(symbol, np.size(one.nominal))]
        self.whole = np.concatenate([np.ravel(one.nominal) for one in self.symbols.values()]).astype(float)
        self.free = ~np.isin(every, self.fixed)
        self.names = [name for name, free in zip(every, self.free, strict=True) if free]
        self.nominal = self.whole[self.free]
        self.sd = np.concatenate([np.full(np.size(one.nominal), one.sd) for one in self.symbols.values()])[self.free]
        members = [(one, name) for name, one in self.sensors.items() for _ in range(max(1, one.members))]
        self.noise = np.array([one.noise for one, _ in members])
        self.n_actuators = sum(not one.external for one, _ in members)
        self.seen = [k for k, (one, _) in enumerate(members) if one.external and one.unit == "mm"]
        self.home, self.size = np.array(self.centre, float), np.array(self.half_widths, float)
        self.lever = self.find_levers()

    @property
    def columns(self) -> list[str]:
        """Columns of a table of readings."""
        every = [(list_members(name, one.members), one.unit) for name, one in self.sensors.items()]
        return [f"{name.replace('[', '_').rstrip(']')}_{unit}" for names, unit in every for name in names]

    def take(self, theta: Array) -> dict[str, Array]:
        """Return parameters by symbol, (n,) or () each; those that are fixed, too."""
        values, found, k = self.whole.copy(), {}, 0
        values[self.free] = theta
        for symbol, one in self.symbols.items():
            n = np.size(one.nominal)
            found[symbol] = values[k] if np.ndim(one.nominal) == 0 else values[k : k + n]
            k += n
        return found

    def find_levers(self) -> Array:
        """Return by how much actuators' units count: `UNIT_MM` is what one pose leaves uncertain of each, (N,).

        Of an actuator's error alone readings know Σ (Qᵀ σ⁻¹)², Q what no pose explains; the mean over the workspace.
        """
        v = self.draw_poses(self.nominal, TYPICAL, np.random.default_rng(2026))
        across, _ = self.reduce(self.nominal, v)
        information = np.mean(np.sum(across[:, : self.n_actuators] ** 2, axis=2), axis=0)
        return UNIT_MM * np.sqrt(information) / self.noise[: self.n_actuators]

    @property
    def reach(self) -> Array:
        """Travel of the actuators to either side, (N,)."""
        v = self.draw_poses(self.nominal, TYPICAL, np.random.default_rng(2026))
        return 0.5 * np.ptp(self.read(self.nominal, v)[:, : self.n_actuators], axis=0)

    def draw_poses(self, theta: Array, n: int, rng: np.random.Generator) -> Array:
        """Return poses of the workspace."""
        return self.home + self.size * rng.uniform(-1.0, 1.0, (n, len(self.home)))


def list_members(name: str, n: int) -> list[str]:
    """Return the names of n members; the name itself where there are none."""
    return [name] if n in (0, 1) else [f"{name}[{k}]" for k in range(1, n + 1)]


def turn(angle: Array | float, axis: str) -> Array:
    """Return matrices (..., 3, 3) that turn about an axis."""
    vector = np.zeros((*np.shape(angle), 3))
    vector[..., "xyz".index(axis)] = angle
    return np.swapaxes(rotate(vector.reshape(-1, 3), np.eye(3)), 1, 2).reshape(*np.shape(angle), 3, 3)


def close(across: Array, crank: Array, coupler: Array, side: Array | float) -> Array:
    """Return angles θ with |across - crank (cos θ, sin θ)| = coupler, beside the straight line: Newton's steps.

    ``across`` is (..., 2); a coupler may leave the plane, whatever is across it counted in ``coupler``.
    """
    wanted = (np.sum(across**2, axis=-1) + crank**2 - coupler**2) / (2.0 * crank)
    theta = np.arctan2(across[..., 1], across[..., 0]) + side * np.pi / 2
    for _ in range(NEWTON):
        cos, sin = np.cos(theta), np.sin(theta)
        miss = across[..., 0] * cos + across[..., 1] * sin - wanted
        theta = theta - miss / (across[..., 1] * cos - across[..., 0] * sin)
    return theta


# --- cells -----------------------------------------------------------------------------------------------------------


class Cell(Function):
    """Three bridges g = K f under known loads; in mV, N."""

    symbols: ClassVar = {f"k_{axis}": Symbol(np.eye(3)[k], 0.05, "1") for k, axis in enumerate("xyz")}
    sensors: ClassVar = {
        "g": Sensor("mV", 0.03, 3),
        **{f"f{axis}": Sensor("N", 0.01, external=True) for axis in "xyz"},
    }
    centre, half_widths = (0.0,) * 3, (25.0,) * 3
    rows = ("none", "joint", "wave", "thermal")

    def read(self, theta: Array, v: Array) -> Array:
        """Return bridges and loads."""
        return np.hstack([v @ theta.reshape(3, 3), v])


class Cell6(Function):
    """Six outputs g = K f + z."""

    symbols: ClassVar = {
        **{f"k_f{axis}": Symbol(np.eye(6)[k], 0.05, "1") for k, axis in enumerate("xyz")},
        **{f"k_m{axis}": Symbol(10.0 * np.eye(6)[k + 3], 0.5, "1") for k, axis in enumerate("xyz")},
        "zero": Symbol((0.0,) * 6, 0.5, "1"),
    }
    sensors: ClassVar = {
        "g": Sensor("mV", 0.03, 6),
        **{f"f{axis}": Sensor("N", 0.01, external=True) for axis in "xyz"},
        **{f"m{axis}": Sensor("Nm", 1e-3, external=True) for axis in "xyz"},
    }
    centre, half_widths = (0.0,) * 6, (50.0,) * 3 + (3.0,) * 3
    counts = 50, 0

    def read(self, theta: Array, v: Array) -> Array:
        """Return outputs and loads."""
        return np.hstack([v @ theta[:36].reshape(6, 6) + theta[36:], v])


# --- serial chains ---------------------------------------------------------------------------------------------------


class Chain(Function):
    """Joints whose angles are the coordinates, and encoders that read them but for their zeros."""

    zeros: ClassVar[str] = "zero"

    def read(self, theta: Array, v: Array) -> Array:
        """Return encoders and what the instrument sees."""
        return np.hstack([v - self.take(theta)[self.zeros], self.see(theta, v)])

    def see(self, theta: Array, v: Array) -> Array:
        """Return what the instrument sees: the tool."""
        return self.tool(theta, v)

    def travel(self, v: Array) -> Array:
        """Return joints' angles about home."""
        return self.place(v)


class Mount(Chain):
    """A telescope's mount: stars seen in azimuth and altitude."""

    symbols: ClassVar = {
        "zero": Symbol((0.0, 0.0), np.radians(0.1), "rad"),
        **{name: Symbol(0.0, np.radians(0.1), "rad") for name in ("tilt_x", "tilt_y", "axes", "tube")},
    }
    sensors: ClassVar = {
        "encoder": Sensor("rad", 1e-5, 2),
        **{name: Sensor("rad", 2e-5, external=True) for name in ("azimuth", "altitude")},
    }
    centre, half_widths = (0.0, 0.75), (1.8, 0.45)
    rows = ("none", "lead", "wave", "thermal")

    def tool(self, theta: Array, v: Array) -> Array:
        """Return where the tube points."""
        p = self.take(theta)
        tilted = turn(p["tilt_y"], "y") @ turn(p["tilt_x"], "x")
        matrix = tilted @ turn(v[:, 0], "z") @ turn(p["axes"], "x") @ turn(-v[:, 1], "y") @ turn(p["tube"], "z")
        along = matrix[:, :, 0]
        return np.column_stack([np.arctan2(along[:, 1], along[:, 0]), np.arcsin(along[:, 2])])


class Scara(Chain):
    """Three turning joints; a camera above sees a mark and its angle."""

    zeros = "o"
    fixed = ("o[1]",)
    symbols: ClassVar = {
        "l": Symbol((300.0, 250.0), 0.5),
        "o": Symbol((0.0,) * 3, np.radians(0.2), "rad"),
        "m_x": Symbol(20.0, 0.5),
        "m_y": Symbol(0.0, 0.5),
        "c_x": Symbol(350.0, 2.0),
        "c_y": Symbol(0.0, 2.0),
        "c_phi": Symbol(0.0, np.radians(0.5), "rad"),
    }
    sensors: ClassVar = {
        "encoder": Sensor("rad", 2e-5, 3),
        "camera_x": Sensor("mm", 20e-3, external=True),
        "camera_y": Sensor("mm", 20e-3, external=True),
        "camera_phi": Sensor("rad", 1e-4, external=True),
    }
    centre, half_widths = (0.0, 1.1, 0.0), (1.2, 0.7, 1.5)
    rows = ("none", "lead", "cross", "thermal")

    def tool(self, theta: Array, v: Array) -> Array:
        """Return where the mark is, and the tool's angle."""
        p, angle = self.take(theta), np.cumsum(v, axis=1)
        way = np.exp(1j * angle) @ np.array([*p["l"], p["m_x"] + 1j * p["m_y"]])
        return np.column_stack([way.real, way.imag, angle[:, 2]])

    def see(self, theta: Array, v: Array) -> Array:
        """Return the same in the camera's frame."""
        p, tool = self.take(theta), self.tool(theta, v)
        seen = (tool[:, 0] - p["c_x"] + 1j * (tool[:, 1] - p["c_y"])) * np.exp(-1j * p["c_phi"])
        return np.column_stack([seen.real, seen.imag, tool[:, 2] - p["c_phi"]])


class Positioner(Chain):
    """A cradle that tilts, a table on it that turns, a tracker's target on the table."""

    symbols: ClassVar = {
        "zero": Symbol((0.0, 0.0), np.radians(0.2), "rad"),
        **{name: Symbol(0.0, np.radians(0.1), "rad") for name in ("w_y", "w_z", "c_y")},
        **{name: Symbol(0.0, 1.0) for name in ("b_y", "b_z", "e_y")},
        "p_x": Symbol(150.0, 1.0),
        "p_z": Symbol(80.0, 1.0),
    }
    sensors: ClassVar = {
        "encoder": Sensor("rad", 2e-5, 2),
        **{f"tracker_{axis}": Sensor("mm", 20e-3, external=True) for axis in "xyz"},
    }
    centre, half_widths = (0.0, 0.0), (1.2, 2.5)
    rows = ("none", "lead", "joint", "thermal")

    def tool(self, theta: Array, v: Array) -> Array:
        """Return where the target is."""
        p = self.take(theta)
        table = turn(p["c_y"], "y") @ turn(v[:, 1], "z") @ np.array([p["p_x"], 0.0, p["p_z"]])
        cradle = turn(p["w_z"], "z") @ turn(p["w_y"], "y") @ turn(v[:, 0], "x")
        place = (cradle @ (table + np.array([0.0, p["e_y"], 0.0]))[..., None])[..., 0]
        return place + np.array([0.0, p["b_y"], p["b_z"]])


class ArmCamera(Chain):
    """Four joints; a camera above sees a mark, in pixels."""

    zeros = "o"
    fixed = ("o[1]",)
    symbols: ClassVar = {
        "a": Symbol((300.0, 250.0, 120.0), 0.5),
        "o": Symbol((0.0,) * 4, np.radians(0.2), "rad"),
        "c_x": Symbol(450.0, 5.0),
        "c_y": Symbol(0.0, 5.0),
        "c_z": Symbol(1600.0, 5.0),
        **{f"r_{axis}": Symbol(0.0, np.radians(0.5), "rad") for axis in "xyz"},
    }
    sensors: ClassVar = {
        "encoder": Sensor("rad", 1e-4, 4),
        **{f"image_{axis}": Sensor("px", 0.3, external=True) for axis in "xy"},
    }
    centre, half_widths = (0.0, 0.8, -1.2, -0.8), (0.9, 0.35, 0.4, 0.5)
    rows = ("none", "lead", "gravity", "thermal")

    def tool(self, theta: Array, v: Array) -> Array:
        """Return where the mark is: from the base, joint by joint."""
        matrix, place = turn(v[:, 0], "z"), np.tile([0.0, 0.0, 400.0], (len(v), 1))
        for k, length in enumerate(self.take(theta)["a"], start=1):
            matrix = matrix @ turn(-v[:, k], "y")
            place = place + length * matrix[:, :, 0]
        return place

    def see(self, theta: Array, v: Array) -> Array:
        """Return the image."""
        p = self.take(theta)
        down = turn(p["r_z"], "z") @ turn(p["r_y"], "y") @ turn(p["r_x"], "x") @ np.diag([1.0, -1.0, -1.0])
        seen = (self.tool(theta, v) - np.array([p["c_x"], p["c_y"], p["c_z"]])) @ down.T
        return 1500.0 * seen[:, :2] / seen[:, 2:]


class Arm(Function):
    """Six turning joints by Denavit and Hartenberg's numbers; encoders, and a tracker that sees the tool's place."""

    symbols: ClassVar = {
        "a": Symbol((150.0, 600.0, 120.0, 0.0, 0.0, 40.0), 0.3),
        "d": Symbol((450.0, 0.0, 0.0, 640.0, 0.0, 150.0), 0.3),
        "alpha": Symbol(np.pi / 2 * np.array([1.0, 0.0, 1.0, -1.0, 1.0, 0.0]), np.radians(0.03), "rad"),
        "o": Symbol((0.0,) * 6, np.radians(0.03), "rad"),
    }
    sensors: ClassVar = {
        "encoder": Sensor("rad", 5e-6, 6),
        **{f"tracker_{axis}": Sensor("mm", 20e-3, external=True) for axis in "xyz"},
    }
    centre, half_widths = (0.0, 1.2, -0.4, 0.0, 0.6, 0.0), (1.2, 0.5, 0.6, 1.2, 0.8, 1.2)

    def find_levers(self) -> Array:
        """Return by how many mm a radian of each joint moves the tool."""
        return np.array([1000.0, 1100.0, 800.0, 200.0, 200.0, 40.0])

    def read(self, theta: Array, v: Array) -> Array:
        """Return encoders and the tool's place."""
        return np.hstack([v - self.take(theta)["o"], self.tool(theta, v)])

    def tool(self, theta: Array, v: Array) -> Array:
        """Return where the tool is."""
        along, up, twist, _ = theta.reshape(4, 6)
        axes, place = np.broadcast_to(np.eye(3), (len(v), 3, 3)), np.zeros((len(v), 3))
        for k in range(6):
            cos, sin = np.cos(v[:, k]), np.sin(v[:, k])
            x = axes[:, :, 0] * cos[:, None] + axes[:, :, 1] * sin[:, None]
            y = axes[:, :, 1] * cos[:, None] - axes[:, :, 0] * sin[:, None]
            z = axes[:, :, 2]
            place = place + up[k] * z + along[k] * x
            turned = y * np.cos(twist[k]) + z * np.sin(twist[k]), z * np.cos(twist[k]) - y * np.sin(twist[k])
            axes = np.stack([x, *turned], axis=-1)
        return place

    def travel(self, v: Array) -> Array:
        """Return joints' angles about home."""
        return self.place(v)

    def tilt(self, v: Array) -> Array:
        """Return shoulder and elbow."""
        return self.place(v)[:, 1:3]


class Axes(Function):
    """Three linear axes that are not square, of other scales; a tracker sees the tool."""

    symbols: ClassVar = {
        "scale": Symbol((1.0,) * 3, 1e-3, "1"),
        "zero": Symbol((0.0,) * 3, 0.5),
        **{name: Symbol(0.0, np.radians(0.1), "rad") for name in ("xy", "xz", "yz")},
    }
    sensors: ClassVar = {
        "q": Sensor("mm", 2e-3, 3),
        **{f"tracker_{axis}": Sensor("mm", 10e-3, external=True) for axis in "xyz"},
    }
    centre, half_widths = (0.0,) * 3, (200.0,) * 3
    rows = ("none", "wave", "cubic", "thermal")

    def tool(self, theta: Array, v: Array) -> Array:
        """Return where the tool is."""
        p = self.take(theta)
        lean = np.array([[0.0, p["xy"], p["xz"]], [0.0, 0.0, p["yz"]], [0.0, 0.0, 0.0]])
        unit = np.sin(lean)
        np.fill_diagonal(unit, np.sqrt(1.0 - np.sum(unit**2, axis=0)))
        return (v * p["scale"]) @ unit.T + p["zero"]

    def read(self, theta: Array, v: Array) -> Array:
        """Return axes and tool."""
        return np.hstack([v, self.tool(theta, v)])


# --- closed loops ----------------------------------------------------------------------------------------------------


class Cables(Function):
    """Eight cables from the corners of a frame to those of a platform; lengths, and a tracked pose."""

    symbols: ClassVar = {
        **{f"a_{'xyz'[k]}": Symbol(CORNERS[:, k] * size, 0.3) for k, size in enumerate((600.0, 500.0, 400.0))},
        **{f"b_{'xyz'[k]}": Symbol(CORNERS[:, k] * size, 0.2) for k, size in enumerate((80.0, 60.0, -50.0))},
        "l0": Symbol((0.0,) * 8, 0.5),
    }
    sensors: ClassVar = {
        "cable": Sensor("mm", 20e-3, 8),
        **{f"tracker_{axis}": Sensor("mm", 20e-3, external=True) for axis in "xyz"},
        **{f"tracker_r{axis}": Sensor("rad", 50e-6, external=True) for axis in "xyz"},
    }
    centre, half_widths = (0.0,) * 6, (200.0,) * 3 + (0.12,) * 3

    def find_levers(self) -> Array:
        """Return ones."""
        return np.ones(8)

    def read(self, theta: Array, v: Array) -> Array:
        """Return cables and pose."""
        frame, box = theta[:24].reshape(3, 8).T, theta[24:48].reshape(3, 8).T
        ends = v[:, None, :3] + rotate(v[:, 3:], box)
        return np.concatenate([np.linalg.norm(ends - frame, axis=-1) - theta[48:], v], axis=1)

    def tool(self, theta: Array, v: Array) -> Array:
        """Return where the platform is."""
        return v[:, :3]

    @property
    def reach(self) -> float:
        """Travel of the cables to either side."""
        return 300.0

    def tilt(self, v: Array) -> Array:
        """Return the rotation about x and y."""
        return self.place(v)[:, 3:5]


class RotaryDelta(Function):
    """Three motors that are commanded, parallelogram forearms, a tracker in the frame of the base."""

    symbols: ClassVar = {
        "R": Symbol((200.0,) * 3, 0.5),
        "L": Symbol((235.0,) * 3, 0.3),
        "l": Symbol((800.0,) * 3, 0.3),
        "e": Symbol((45.0,) * 3, 0.2),
        "zero": Symbol((0.0,) * 3, np.radians(0.3), "rad"),
        "yaw": Symbol((0.0,) * 3, np.radians(0.1), "rad"),
        "roll": Symbol((0.0,) * 3, np.radians(0.1), "rad"),
    }
    sensors: ClassVar = {
        "theta": Sensor("rad", 5e-5, 3),
        **{f"tracker_{axis}": Sensor("mm", 15e-3, external=True) for axis in "xyz"},
    }
    centre, half_widths = (0.0, 0.0, -720.0), (180.0, 180.0, 80.0)
    rows = ("none", "cross", "joint", "thermal")
    commanded = ("theta",)

    def read(self, theta: Array, v: Array) -> Array:
        """Return motors and tool."""
        p = self.take(theta)
        frame = turn(THREE, "z")
        forearm = v[:, None, :] + (p["e"] - p["R"])[:, None] * frame[:, :, 0]  # from the shoulder
        seen = np.einsum("pni,nij->pnj", forearm, frame @ turn(p["roll"], "x") @ turn(p["yaw"], "z"))
        coupler = np.sqrt(p["l"] ** 2 - seen[..., 1] ** 2)
        return np.hstack([close(seen[..., [0, 2]] * [1.0, -1.0], p["L"], coupler, -1.0) - p["zero"], v])


class ProbedDelta(Function):
    """Three carriages below their endstops, a probe that feels the bed."""

    symbols: ClassVar = {
        "r": Symbol(172.0, 2.0),
        "angle": Symbol(np.radians([210.0, 330.0, 90.0]), np.radians(0.5), "rad"),
        "l": Symbol((340.0,) * 3, 2.0),
        "e": Symbol((333.0,) * 3, 5.0),
    }
    sensors: ClassVar = {"s": Sensor("mm", 5e-3, 3), "height": Sensor("mm", 20e-3, external=True)}
    fixed = ("angle[3]",)
    centre, half_widths = (0.0, 0.0, 0.0), (130.0, 130.0, 0.05)
    rows = ("none", "lead", "cross", "joint")

    def read(self, theta: Array, v: Array) -> Array:
        """Return carriages and height: arms reach from the nozzle's joints, l, up to the towers."""
        p = self.take(theta)
        tower = p["r"] * np.column_stack([np.cos(p["angle"]), np.sin(p["angle"])])
        apart = np.linalg.norm(v[:, None, :2] - tower, axis=-1)
        top = p["e"] + np.sqrt((p["l"] - p["r"]) * (p["l"] + p["r"]))
        return np.hstack([top - (v[:, 2:] + np.sqrt((p["l"] - apart) * (p["l"] + apart))), v[:, 2:]])

    def draw_poses(self, theta: Array, n: int, rng: np.random.Generator) -> Array:
        """Return points of a round bed."""
        angle, radius = 2.0 * np.pi * rng.random(n), self.size[0] * np.sqrt(rng.random(n))
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(n)])


class PlanarRRR(Function):
    """Three motors, cranks, couplers, a platform that a camera sees."""

    symbols: ClassVar = {
        "x": Symbol(250.0 * np.cos(THREE), 0.5),
        "y": Symbol(250.0 * np.sin(THREE), 0.5),
        "l": Symbol((130.0,) * 3, 0.3),
        "m": Symbol((140.0,) * 3, 0.3),
        "xi": Symbol(60.0 * np.cos(THREE), 0.3),
        "eta": Symbol(60.0 * np.sin(THREE), 0.3),
        "zero": Symbol((0.0,) * 3, np.radians(0.3), "rad"),
    }
    sensors: ClassVar = {
        "theta": Sensor("rad", 1e-4, 3),
        "camera_x": Sensor("mm", 20e-3, external=True),
        "camera_y": Sensor("mm", 20e-3, external=True),
        "camera_phi": Sensor("rad", 2e-4, external=True),
    }
    centre, half_widths = (0.0, 0.0, 0.0), (45.0, 45.0, 0.35)
    rows = ("none", "lead", "cross", "joint")

    def read(self, theta: Array, v: Array) -> Array:
        """Return motors and platform, in the complex plane."""
        p = self.take(theta)
        joints = (p["xi"] + 1j * p["eta"]) * np.exp(1j * v[:, 2:]) + v[:, :1] + 1j * v[:, 1:2]
        across = joints - (p["x"] + 1j * p["y"])
        angles = close(np.stack([across.real, across.imag], axis=-1), p["l"], p["m"], 1.0)
        return np.hstack([angles - p["zero"], v])


class FiveBar(Function):
    """Two motors, cranks and couplers that meet at the tool, which a camera sees."""

    symbols: ClassVar = {
        "x": Symbol((-60.0, 60.0), 0.3),
        "y": Symbol((0.0, 0.0), 0.3),
        "l": Symbol((120.0, 120.0), 0.3),
        "m": Symbol((160.0, 160.0), 0.3),
        "zero": Symbol((0.0, 0.0), np.radians(0.2), "rad"),
    }
    sensors: ClassVar = {
        "theta": Sensor("rad", 5e-5, 2),
        **{f"camera_{axis}": Sensor("mm", 20e-3, external=True) for axis in "xy"},
    }
    centre, half_widths = (0.0, 180.0), (60.0, 40.0)
    rows = ("none", "lead", "cross", "wave")

    def read(self, theta: Array, v: Array) -> Array:
        """Return motors and tool."""
        p = self.take(theta)
        across = v[:, None, :] - np.column_stack([p["x"], p["y"]])
        return np.hstack([close(across, p["l"], p["m"], np.array([1.0, -1.0])) - p["zero"], v])


FUNCTIONS = {
    "arm": Arm,
    "cables": Cables,
    "cell": Cell,
    "mount": Mount,
    "scara": Scara,
    "rotary_delta": RotaryDelta,
    "probed_delta": ProbedDelta,
    "positioner": Positioner,
    "planar_rrr": PlanarRRR,
    "arm_camera": ArmCamera,
    "five_bar": FiveBar,
    "axes": Axes,
    "cell6": Cell6,
}
