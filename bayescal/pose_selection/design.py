"""A machine on legs whose poses are chosen: what is known of it, what measures its poses, what these readings say.

What the actuators read are channels of the machine, as in an audit. They locate the platform, which then errs by S with
the parameters and by a covariance C with what actuators and model err by; more than six leave rows R besides, whatever
the pose. Sensors tell M of the pose, so that poses have the information

    Sᵀ M (1 + C M)⁻¹ S + RᵀR,

that of an audit whose sensors are channels of the covariance M⁻¹. In this form actuators may be exact, and sensors see
a part of the pose alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from bayescal.density.priors import Prior
from bayescal.errors import InputError
from bayescal.identifiability.information import root_of
from bayescal.identifiability.pose_volume import describe_move
from bayescal.identifiability.reading_rows import Jacobians, LinearisedPoses, differentiate
from bayescal.machines.kinematics import SINGULAR_CONDITION, Machine
from bayescal.machines.readings import Legs, ReadingModel
from bayescal.machines.sensors import Sensor
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, rotation_vector_from_matrix


@dataclass(frozen=True, eq=False)
class PlacedPoses:
    """Poses with the actuator positions that hold them."""

    moves: Array  # (P, 6): displacement in mm and rotation vector in rad from home, base frame
    # (P, 3) and (P, 3, 3): platform frame in the base frame, mm
    position: Array
    rotation: Array
    actuators: Array  # (P, N), mm
    found: np.ndarray  # (P,), bool: whether the machine can stand there at all

    @property
    def pose(self) -> Array:
        """Coordinates of the machine's poses, shape (P, 6): position in mm and rotation vector in rad, base frame."""
        return np.concatenate([self.position, rotation_vector_from_matrix(self.rotation)], axis=-1)

    def select(self, chosen: slice) -> PlacedPoses:
        """Return some of the poses."""
        return PlacedPoses(*(getattr(self, field.name)[chosen] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class Design:
    """A machine as expected, its n free parameters, and what measures its poses."""

    machine: Machine
    # of the free parameters, in mm, rad, or the parameter's unit; their means and standard deviations count
    priors: Mapping[str, Prior]
    # values of fixed parameters that are not nominal
    fixed: Mapping[str, float] = field(default_factory=dict)
    sensors: tuple[Sensor, ...] = ()  # all of them measure every pose
    # σ_ρ and τ, mm
    actuator_noise: float = 0.0
    model_error: float = 0.0

    def __post_init__(self) -> None:
        """Check that something is free."""
        if not self.priors:
            raise InputError("found no free parameter")

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the n free parameters, in the layout's order."""
        return tuple(name for name in self.machine.layout.names if name in self.priors)

    @cached_property
    def free(self) -> np.ndarray:
        """Where these stand among the machine's parameters, shape (n,)."""
        return np.array([self.machine.layout.names.index(name) for name in self.names])

    @cached_property
    def sd(self) -> Array:
        """Standard deviations of their priors, the tolerances, shape (n,)."""
        return np.array([self.priors[name].sd for name in self.names])

    @cached_property
    def theta(self) -> Array:
        """The machine's parameters as expected, shape (D,)."""
        layout, means = self.machine.layout, {name: one.mean for name, one in self.priors.items()}
        expects = {**self.fixed, **means}
        return np.array([expects.get(name, value) for name, value in zip(layout.names, layout.nominal, strict=True)])

    @cached_property
    def readings(self) -> ReadingModel:
        """What its actuators read, N channels."""
        return Legs(self.machine).pick(np.arange(self.machine.mechanism.n_legs))

    @cached_property
    def moves(self) -> Array:
        """What tolerances of the free parameters make of the machine's parameters, shape (n, D)."""
        moves = np.zeros((len(self.sd), self.machine.layout.size))
        moves[np.arange(len(self.sd)), self.free] = self.sd
        return moves

    @property
    def is_exact(self) -> bool:
        """Whether neither actuators nor the model err."""
        return self.actuator_noise == 0.0 and self.model_error == 0.0

    def inform(self, placed: PlacedPoses) -> Array:
        """Return what all sensors together tell of each pose, M, shape (P, 6, 6)."""
        total = np.zeros((len(placed.position), DEGREES_OF_FREEDOM, DEGREES_OF_FREEDOM))
        for sensor in self.sensors:
            total += sensor.information(placed.position, placed.rotation)
        return total

    def find_noise(self, placed: PlacedPoses) -> Array:
        """Return the covariance of the actuators' readings, shape (P, N, N), mm².

        With B = ∂f/∂ρ of the closure a leg's model error shows in them as B⁻¹ diag(B) τ.
        """
        n_poses, n_legs = placed.actuators.shape
        noise = np.tile(self.actuator_noise**2 * np.eye(n_legs), (n_poses, 1, 1))
        if self.model_error == 0.0:
            return noise
        slope = self.machine.linearise(self.theta, placed.position, placed.rotation, placed.actuators).actuators
        gain = np.linalg.solve(slope, slope * np.eye(n_legs))
        return np.asarray(noise + self.model_error**2 * gain @ np.swapaxes(gain, -1, -2))

    def differentiate(self, theta: Array, pose: Array, noise: Array) -> Jacobians:
        """Return what moves a machine (D,) at poses (P, 6) whose actuators err by covariances (N, N) or (P, N, N)."""
        return differentiate(self.readings, theta, self.moves, noise, self.readings.pose_scale, pose, {})

    def see(self, placed: PlacedPoses, name: str = "pose", first: int = 1) -> SeenPoses:
        """Return what the machine's channels say at poses, to first order, whose numbers begin with ``first``.

        InputError names the first at which J_1, the pose Jacobian, is singular.
        """
        noise = np.eye(placed.actuators.shape[1]) if self.is_exact else self.find_noise(placed)
        here = self.differentiate(self.theta, placed.pose, noise)
        regular = np.zeros(len(placed.actuators), dtype=bool)
        scale = np.linalg.norm(here.by_pose, axis=-2, keepdims=True)  # mm and rad side by side
        scaled = here.by_pose / np.where(scale > 0.0, scale, 1.0)
        regular[here.places] = np.linalg.cond(scaled) < SINGULAR_CONDITION
        for k in np.flatnonzero(~regular)[:1]:
            raise InputError(f"{name} {k + first} ({describe_move(placed.moves[k])}): singular pose Jacobian J_1")
        return SeenPoses(self, placed, here)


@dataclass(frozen=True, eq=False)
class SeenPoses:
    """P poses of a design to first order in its n free parameters."""

    design: Design
    placed: PlacedPoses
    slopes: Jacobians  # of its actuators' readings and of the platform's pose, parameters in units of the tolerances

    @cached_property
    def located(self) -> LinearisedPoses:
        """The poses as the actuators locate them, parameters in units of the tolerances."""
        return self.slopes.select_channels(np.ones(self.placed.actuators.shape[1], dtype=bool))

    @cached_property
    def slope(self) -> Array:
        """J_b: pose by parameters, mm and rad by the parameters' units, shape (P, 6, n)."""
        return self.located.tool / self.design.sd

    @cached_property
    def closure(self) -> Array:
        """J_2: residuals of the closures by parameters, shape (P, N, n)."""
        design, placed = self.design, self.placed
        here = design.machine.linearise(design.theta, placed.position, placed.rotation, placed.actuators)
        return np.asarray(here.parameters[..., design.free])

    @cached_property
    def root(self) -> Array:
        """What takes an error of the located pose (mm, rad) to units of what sensors and actuators err by, (P, 6, 6).

        InputError where legs are redundant and nothing errs.
        """
        information, located = self.design.inform(self.placed), self.located.located
        if self.n_redundant and self.design.is_exact:
            raise InputError("found no actuator noise or model error, expected some for redundant legs")
        noise = (not self.design.is_exact) * located @ np.swapaxes(located, -1, -2)
        return root_of(np.linalg.solve(np.eye(DEGREES_OF_FREEDOM) + information @ noise, information))

    @property
    def n_redundant(self) -> int:
        """Number of legs beyond six."""
        return self.placed.actuators.shape[1] - DEGREES_OF_FREEDOM

    @cached_property
    def rows(self) -> Array:
        """The identification Jacobian in units of noise and tolerances, shape (P, N, n)."""
        rows = self.root @ self.located.tool
        if not self.n_redundant:
            return rows
        _, values, right = np.linalg.svd(self.located.rows, full_matrices=False)
        return np.concatenate([rows, (values[..., None] * right)[:, : self.n_redundant]], axis=1)
