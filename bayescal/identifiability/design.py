"""A mechanism on legs whose poses are chosen: what is known of it, a plan of measurement, where accuracy counts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from bayescal.errors import InputError
from bayescal.machines.frames import FRAME_BLOCKS
from bayescal.machines.kinematics import ForwardKinematics, Machine, solve_forward_kinematics, solve_inverse_kinematics
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.sensors import Sensor
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector

AXES = ("x", "y", "z", "rotation x", "rotation y", "rotation z")
SLACK = 1e-9  # of the actuators' range


@dataclass(frozen=True, eq=False)
class Knowledge:
    """A machine with what is known of its parameters before it is measured.

    Attributes
    ----------
    machine : Machine
    priors : mapping of parameter name to float
        Standard deviations of the free parameters, those of free frames too, in mm, rad, or the parameter's unit.
    fixed : mapping of parameter name to float
        Values of fixed parameters that are not nominal; of free ones where they are expected elsewhere.
    """

    machine: Machine
    priors: Mapping[str, float]
    fixed: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the names and that every standard deviation is positive and finite."""
        for name in (*self.priors, *self.fixed):
            if name not in self.layout.names:
                raise InputError(f"parameter {name!r}: unknown here, expected one of {', '.join(self.layout.symbols)}")
        for name, sd in self.priors.items():
            if not 0.0 < sd < np.inf:
                raise InputError(f"parameter {name}: found a tolerance of {sd:g}, expected one above zero")
        if not self.priors:
            raise InputError("found no free parameter, expected at least one")

    @cached_property
    def layout(self) -> ParameterLayout:
        """The machine's parameters, then those of the measurement's frames."""
        return self.machine.layout.extend(FRAME_BLOCKS)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the n free parameters, in the layout's order."""
        return tuple(name for name in self.layout.names if name in self.priors)

    @cached_property
    def free(self) -> np.ndarray:
        """Where the free parameters stand in the layout, shape (n,)."""
        return np.array([k for k, name in enumerate(self.layout.names) if name in self.priors])

    @cached_property
    def sd(self) -> Array:
        """Standard deviations beforehand, shape (n,)."""
        return np.array([self.priors[name] for name in self.names])

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of the free parameters."""
        return tuple(self.layout.units[k] for k in self.free)

    @cached_property
    def symbols(self) -> tuple[str, ...]:
        """Symbols of the free parameters."""
        return tuple(name.partition("[")[0] for name in self.names)

    @cached_property
    def centre(self) -> Array:
        """Machine and frames as expected beforehand, shape (D,)."""
        theta = self.layout.nominal.copy()
        for name, value in self.fixed.items():
            theta[self.layout.names.index(name)] = value
        return theta

    @property
    def machine_centre(self) -> Array:
        """The machine as expected beforehand, without the frames."""
        return self.centre[: self.machine.layout.size]


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan of measurement.

    Attributes
    ----------
    actuators : ndarray, shape (P, N)
        Actuator positions ρ of the poses to measure, mm.
    sensors : tuple of Sensor
        All of them measure every pose.
    actuator_noise, model_error : float
        σ_ρ and τ, mm.
    noise_factor : float
        On the sensors' noise.
    """

    actuators: Array
    sensors: tuple[Sensor, ...]
    actuator_noise: float
    model_error: float = 0.0
    noise_factor: float = 1.0

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return len(self.actuators)

    def information(self, found: ForwardKinematics) -> Array:
        """Return what all sensors together tell of each pose, shape (P, 6, 6)."""
        total = np.zeros((len(found.position), 6, 6))
        for sensor in self.sensors:
            total += sensor.information(found.position, found.rotation)
        return total / self.noise_factor**2


def predict_poses(machine: Machine, theta: Array, actuators: Array) -> ForwardKinematics:
    """Return the poses at actuator positions (P, N); InputError names the first that the machine cannot take."""
    found = solve_forward_kinematics(machine, theta, actuators, check=False)
    if not found.converged.all():
        index = int(np.argmin(found.converged))
        moved = actuators[index] - machine.mechanism.initial_actuator_positions
        listed = ", ".join(f"{x:g}" for x in moved)
        raise InputError(
            f"pose {index + 1}: found no pose at displacements {listed} mm, expected one the machine can take"
        )
    return found


# --- workspace --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PoseVolume:
    """Poses about the home pose.

    Attributes
    ----------
    half : ndarray, shape (6,)
        Half widths, mm and rad.
    shape : str
        ``ellipsoid``, ``box`` or ``axes``.
    n_poses : int
        How many poses stand for it.
    """

    half: Array
    shape: str
    n_poses: int

    def sample(self, n: int, seed: int) -> Array:
        """Return pose displacements, shape (n', 6), mm and rad, the ends of the axes among them; n' is about n."""
        used = np.flatnonzero(self.half > 0)
        ends = np.concatenate([np.eye(6)[used], -np.eye(6)[used], np.zeros((1, 6))])
        inside = np.zeros((max(0, n - len(ends)), 6))
        if len(inside) and len(used):
            inside[:, used] = self._fill(len(inside), len(used), seed)
        return np.concatenate([ends, inside]) * self.half

    def _fill(self, n: int, k: int, seed: int) -> Array:
        """Return points that fill the unit box, ball or cross of k axes evenly, shape (n, k)."""
        from scipy.stats import qmc  # half a second to import

        unit = qmc.Halton(k + 1, rng=np.random.default_rng(seed)).random(n)
        cube = 2.0 * unit - 1.0
        if self.shape == "box":
            return np.asarray(cube[:, :k])
        if self.shape == "axes":
            which = (unit[:, k] * k).astype(int)
            return np.asarray(np.where(np.arange(k) == which[:, None], cube[:, :k], 0.0))
        normal, radius = ndtri(unit[:, :k]), unit[:, k] ** (1.0 / k)
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True) * radius[:, None])


def find_workspace_actuators(machine: Machine, theta: Array, workspace: PoseVolume, n: int, seed: int) -> Array:
    """Return the actuator positions of poses of the workspace, shape (n', N), mm.

    Parameters
    ----------
    machine : Machine
    theta : ndarray, shape (D,)
        The machine's parameters.
    workspace : PoseVolume
    n, seed : int
        How many poses, and the seed of those inside.

    Raises
    ------
    InputError
        Names the first pose that the actuators cannot reach, the actuator and its displacement.
    """
    mechanism = machine.mechanism
    start = mechanism.initial_actuator_positions
    home = solve_forward_kinematics(machine, theta, start[None])
    moves = workspace.sample(n, seed)
    position = home.position[0] + moves[:, :3]
    rotation = matrix_from_rotation_vector(moves[:, 3:]) @ home.rotation[0]
    found = solve_inverse_kinematics(machine, theta, position, rotation, check=False)
    displacement = found.actuators - start
    far = np.where(found.converged[:, None], np.abs(displacement), np.inf)
    limit = mechanism.actuator_range * (1.0 + SLACK)
    if np.any(far > limit):
        pose, leg = np.unravel_index(int(np.argmax(far)), far.shape)
        needed = f"{far[pose, leg]:.3g} mm" if np.isfinite(far[pose, leg]) else "more than it can"
        raise InputError(
            f"workspace: out of reach at {describe_move(moves[pose], 3)}: leg {leg + 1} would have to move {needed}, "
            f"expected at most the actuator range of {mechanism.actuator_range:g} mm"
        )
    return found.actuators


def describe_move(move: Array, digits: int = 4) -> str:
    """Return a displacement (6,) from home, mm and rad, in words."""
    degrees = np.concatenate([move[:3], np.degrees(move[3:])])
    parts = [
        f"{axis} {value:.{digits}g} {'mm' if k < 3 else 'deg'}"
        for k, (axis, value) in enumerate(zip(AXES, degrees, strict=True))
        if abs(value) > 1e-9
    ]
    return ", ".join(parts) or "home"


def draw_displacements(spread: str, count: int, n_legs: int, half: float, rng: np.random.Generator) -> Array:
    """Return random displacements (count, n_legs), mm: ``uniform``, or at the ``extremes``, the ends and the middle."""
    if spread == "extremes":
        return np.asarray(half * rng.integers(-1, 2, (count, n_legs)).astype(np.float64))
    return half * rng.uniform(-1.0, 1.0, (count, n_legs))
