"""Machines of `bayescal init` and of RR-8096, simulated once more, and a list of all.

Those of one function are in `functions.py`.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from benchmarks.truth.functions import FUNCTIONS
from benchmarks.truth.simulated import ARCSEC, NEWTON, Array, Simulated, rotate

# --- platforms on six legs -------------------------------------------------------------------------------------------


def on_circle(radius: float, azimuth_deg: list[float]) -> Array:
    """Return points (N, 3) on a circle about z."""
    angle = np.radians(azimuth_deg)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(len(angle))], axis=-1)


class Platform(Simulated):
    """Six legs between a + (what drives them) and p + R b; actuators, then the pose that an instrument hands out.

    Attributes
    ----------
    tolerances : dict of str to float
        By symbol.
    initial, range_mm : float
        What actuators read at home, and how far they go.
    """

    symbols = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l")

    def __init__(
        self,
        geometry: dict[str, Array],
        tolerances: dict[str, float],
        home_height: float,
        actuators: tuple[float, float],
        noise: tuple[float, float, float],
        size: tuple[float, float],
    ) -> None:
        self.geometry, self.tolerances = geometry, tolerances
        self.initial, self.range_mm = actuators
        self.names = [f"{symbol}[{leg}]" for symbol in tolerances for leg in range(1, 7)]
        self.nominal = np.concatenate([geometry[symbol] for symbol in tolerances])
        self.sd = np.repeat(list(tolerances.values()), 6)
        self.noise = np.repeat(noise, [6, 3, 3])
        self.home = np.array([0.0, 0.0, home_height, 0.0, 0.0, 0.0])
        self.size = np.repeat(size, 3)
        self.lever, self.n_actuators, self.seen = np.ones(6), 6, [6, 7, 8]

    def take(self, theta: Array) -> dict[str, Array]:
        """Return parameters by symbol, those that are known too."""
        return self.geometry | dict(zip(self.tolerances, theta.reshape(-1, 6), strict=True))

    @abstractmethod
    def drive(self, known: dict[str, Array], v: Array, lower: Array, upper: Array) -> Array:
        """Return what actuators read (P, N) at poses where joints are at a (N, 3) and p + R b (P, N, 3)."""

    def read(self, theta: Array, v: Array) -> Array:
        """Return actuators and pose."""
        known = self.take(theta)
        lower = np.stack([known["a_x"], known["a_y"], known["a_z"]], axis=-1)
        upper = v[:, None, :3] + rotate(v[:, 3:], np.stack([known["b_x"], known["b_y"], known["b_z"]], axis=-1))
        return np.concatenate([self.drive(known, v, lower, upper), v], axis=1)

    @property
    def reach(self) -> float:
        """Travel of the actuators to either side."""
        return self.range_mm

    def tilt(self, v: Array) -> Array:
        """Return the rotation about x and y."""
        return self.place(v)[:, 3:5]

    def draw_poses(self, theta: Array, n: int, rng: np.random.Generator) -> Array:
        """Return poses of actuators drawn evenly from their travel: by Newton's steps."""
        return self.solve(theta, self.initial + self.range_mm * self.share * rng.uniform(-1.0, 1.0, (n, 6)))

    share = 0.6  # of the actuators' travel, as `bayescal init` has it


class Struts(Platform):
    """Actuators change the legs' lengths: ρ = ρ0 + |p + R b - a| - l."""

    def drive(self, known: dict[str, Array], v: Array, lower: Array, upper: Array) -> Array:
        """Return the struts' readings."""
        return self.initial + np.linalg.norm(upper - lower, axis=-1) - known["l"]


class Carriages(Platform):
    """Actuators move lower joints along u, legs keep their lengths: |p + R b - a - ρ u| = l, the root below.

    ``matrix`` is K of RR-8096 eq. 4: joints b move along the platform's z by K (ρ - ρ0), in mm per mm.
    """

    matrix: Array | None = None

    def drive(self, known: dict[str, Array], v: Array, lower: Array, upper: Array) -> Array:
        """Return the carriages' readings."""
        flat = np.stack([known["u_x"], known["u_y"]], axis=-1)
        along = np.concatenate([flat, np.sqrt(1.0 - (flat**2).sum(axis=-1, keepdims=True))], axis=-1)
        found = solve_carriages(upper - lower, along, known["l"])
        if self.matrix is not None:
            z = rotate(v[:, 3:], np.array([[0.0, 0.0, 1.0]]))
            for _ in range(NEWTON):  # K is some hundredths, so this closes in fast
                moved = ((found - self.initial) @ self.matrix.T)[..., None] * z
                found = solve_carriages(upper + moved - lower, along, known["l"])
        return found


def solve_carriages(across: Array, along: Array, length: Array) -> Array:
    """Return ρ with |g - ρ u| = l below the platform, for g (P, N, 3), u (N, 3) and l (N,), shape (P, N)."""
    ahead = (across * along).sum(axis=-1)
    return ahead - np.sqrt(length**2 - (across**2).sum(axis=-1) + ahead**2)


def lay_out(
    base: tuple[float, list[float]], platform: tuple[float, list[float]], height: float, travel: float = 0.0
) -> dict[str, Array]:
    """Return the drawing of six legs by symbol: joints on circles, actuators vertical, ``travel`` at home."""
    lower, upper = on_circle(*base), on_circle(*platform)
    length = np.linalg.norm(upper + np.array([0.0, 0.0, height - travel]) - lower, axis=-1)
    found = {f"a_{axis}": lower[:, k] for k, axis in enumerate("xyz")}
    found |= {f"b_{axis}": upper[:, k] for k, axis in enumerate("xyz")}
    return found | {"u_x": np.zeros(6), "u_y": np.zeros(6), "l": length}


AZIMUTHS = [350.0, 10.0, 110.0, 130.0, 230.0, 250.0], [310.0, 50.0, 70.0, 170.0, 190.0, 290.0]
JOINTS = dict.fromkeys(("a_x", "a_y", "a_z", "b_x", "b_y", "b_z"), 0.2)


def build_hexapod() -> Simulated:
    """Return the hexapod of `bayescal init`, measured by poses."""
    drawing = lay_out((300.0, AZIMUTHS[0]), (180.0, AZIMUTHS[1]), 380.0)
    noise = 2e-3, 10e-3, 5.0 * ARCSEC
    return Struts(drawing, {**JOINTS, "l": 0.5}, 380.0, (450.0, 40.0), noise, (30.0, 0.08))


def build_carriages() -> Simulated:
    """Return the machine on six carriages of `bayescal init`, measured by poses."""
    drawing = lay_out((250.0, AZIMUTHS[0]), (120.0, AZIMUTHS[1]), 400.0)
    tolerances = {**JOINTS, "l": 0.5, "u_x": 1e-3, "u_y": 1e-3}
    return Carriages(drawing, tolerances, 400.0, (0.0, 40.0), (2e-3, 10e-3, 5.0 * ARCSEC), (40.0, 0.2))


TELESCOPE = (155.0, [220.0, 320.0, 340.0, 80.0, 100.0, 200.0]), (130.0, [265.0, 275.0, 25.0, 35.0, 145.0, 155.0])
TELESCOPE_NOISE = 1e-3, 1e-3, 2.0 * ARCSEC


def build_telescope() -> Simulated:
    """Return the telescope of RR-8096, of which a, b and l are free as in its study."""
    return _build_telescope({"a_x": 2.0, "a_y": 2.0, "b_x": 2.0, "b_y": 2.0, "l": 2.0})


def build_telescope_all() -> Simulated:
    """Return the telescope of which everything is free."""
    free = {"a_x": 2.0, "a_y": 2.0, "a_z": 0.5, "b_x": 2.0, "b_y": 2.0, "b_z": 0.5, "l": 2.0, "u_x": 0.01, "u_y": 0.01}
    return _build_telescope(free)


def _build_telescope(free: dict[str, float]) -> Simulated:
    flat = lay_out(*TELESCOPE, 0.0)["l"]
    height = 10.0 + float(np.sqrt(500.0**2 - np.mean(flat**2)))
    drawing = lay_out(*TELESCOPE, height, 10.0) | {"l": np.full(6, 500.0)}
    machine = Carriages(drawing, free, height, (10.0, 1.3), TELESCOPE_NOISE, (5.0, 0.03))
    machine.share = 0.9
    return machine


# --- the linear delta ------------------------------------------------------------------------------------------------


class Delta(Simulated):
    """The linear delta of `bayescal init --machine own`: three carriages, a camera, a probe on a tilted bed."""

    def __init__(self) -> None:
        angle = np.radians([90.0, 210.0, 330.0])
        by_symbol = {
            **{"x": 150.0 * np.cos(angle), "y": 150.0 * np.sin(angle), "l": np.full(3, 260.0), "s0": np.zeros(3)},
        }
        self.names = [f"{symbol}[{k}]" for symbol in by_symbol for k in (1, 2, 3)] + ["t_x", "t_y"]
        self.nominal = np.concatenate([*by_symbol.values(), np.zeros(2)])
        self.sd = np.concatenate([np.repeat([0.5, 0.5, 0.3, 0.5], 3), np.radians([0.1, 0.1])])
        self.noise = np.array([5e-3, 5e-3, 5e-3, 20e-3, 20e-3, 10e-3])
        self.home, self.size = np.array([0.0, 0.0, 20.0]), np.array([80.0, 80.0, 20.0])
        self.lever, self.n_actuators, self.seen = np.ones(3), 3, [3, 4]

    def read(self, theta: Array, v: Array) -> Array:
        """Return carriages, camera and probe."""
        x, y, rod, zero = theta[:12].reshape(4, 3)
        across = (v[:, :1] - x) ** 2 + (v[:, 1:2] - y) ** 2
        with np.errstate(invalid="ignore"):
            carriages = v[:, 2:] + np.sqrt(rod**2 - across) - zero
        height = v[:, 2] - theta[12] * v[:, 0] - theta[13] * v[:, 1]
        return np.column_stack([carriages, v[:, :2], height])

    @property
    def reach(self) -> float:
        """Travel of the carriages to either side."""
        return 60.0

    def draw_poses(self, theta: Array, n: int, rng: np.random.Generator) -> Array:
        """Return poses of the workspace, whose corners are not all within reach."""
        found = self.home + self.size * rng.uniform(-1.0, 1.0, (n, 3))
        while (beyond := ~np.isfinite(self.read(theta, found)).all(axis=1)).any():
            found[beyond] = self.home + self.size * rng.uniform(-1.0, 1.0, (int(beyond.sum()), 3))
        return found


MACHINES = {
    "hexapod": build_hexapod,
    "carriages": build_carriages,
    "telescope": build_telescope,
    "telescope_all": build_telescope_all,
    "delta": Delta,
    **FUNCTIONS,
}
