"""A machine on legs by what it reads: the positions of its actuators, and its pose as an instrument sees it.

The pose v is position and rotation vector of the platform frame in the base frame. With the closure f(v, ρ; d) = 0 the
actuators read ρ = h(v, d), whose derivatives are ∂ρ/∂v = -(∂f/∂ρ)⁻¹ ∂f/∂v and ∂ρ/∂d = -(∂f/∂ρ)⁻¹ ∂f/∂d. The platform
frame itself is the tool.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.machines.kinematics import (
    Machine,
    check_home_pose,
    solve_forward_kinematics,
    solve_inverse_kinematics,
)
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.readings.base import NOTHING, SLACK, Channel, Coordinate, Given, ReadingModel, Readings
from bayescal.machines.readings.locate import locate_pose
from bayescal.numerics.geometry import (
    Array,
    compute_left_inverse_jacobian,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
)

POSE = ("x", "y", "z", "rx", "ry", "rz")
POSE_CHANNELS = tuple(
    Channel(name, "mm" if k < 3 else "rad", external=True, rotation="" if k < 3 else "r") for k, name in enumerate(POSE)
)


@dataclass(frozen=True, eq=False)
class LegsModel(ReadingModel):
    """A machine of N legs with its actuators' encoders, and the pose as an instrument sees it: K = N + 6.

    Attributes
    ----------
    machine : Machine
        Mechanism, model and deformation.
    """

    machine: Machine

    @property
    def name(self) -> str:
        """Name of the mechanism."""
        return self.machine.mechanism.name

    @property
    def n_legs(self) -> int:
        """Number of legs N."""
        return self.machine.mechanism.n_legs

    @property
    def layout(self) -> ParameterLayout:
        """The machine's parameters."""
        return self.machine.layout

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Encoders, then the pose seen from beside the machine."""
        return (*(Channel(f"rho[{leg}]", "mm") for leg in range(1, self.n_legs + 1)), *POSE_CHANNELS)

    @cached_property
    def home_pose(self) -> Array:
        """The nominal pose at the initial actuator positions, shape (6,), mm and rad."""
        home = self.machine.nominal_home
        if not home.converged:
            home = check_home_pose(self.machine)  # says why there is none
        return np.concatenate([home.position, rotation_vector_from_matrix(home.rotation)])

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Position and rotation vector of the platform's frame."""
        kinds = zip(POSE_CHANNELS, self.home_pose, strict=True)
        return tuple(Coordinate(one.name, one.unit, float(home), reach=0.0) for one, home in kinds)

    @property
    def pose_channels(self) -> tuple[Channel, ...]:
        """Position, and the rotation vector as a rotation."""
        return POSE_CHANNELS

    @property
    def command_range(self) -> Array:
        """How far the actuators go."""
        mechanism = self.machine.mechanism
        start, reach = mechanism.initial_actuator_positions, mechanism.actuator_range
        return np.stack([start - reach, start + reach], axis=1)

    def frame_parameters(self) -> tuple[str, ...]:
        """Return none: its frames are those of its points."""
        return ()

    def seen_parameters(self, channels: Iterable[str]) -> tuple[str, ...]:
        """Return all parameters where an actuator is read: a deformation takes every leg to the others."""
        seen = any(name.partition("[")[0] == "rho" for name in channels)
        return self.layout.names if seen else ()

    # --- readings ------------------------------------------------------------------------------------------------

    def read(self, theta: Array, pose: Array, given: Given = NOTHING) -> Array:
        """Return the readings; see `ReadingModel.read`."""
        del given
        actuators = self._hold(theta, pose)[2]
        return np.concatenate([actuators, np.broadcast_to(pose, (*actuators.shape[:-1], len(POSE)))], axis=-1)

    def _hold(self, theta: Array, pose: Array) -> tuple[Array, Array, Array]:
        """Return position, rotation and the actuators that hold it, NaN where there are none."""
        position, rotation = pose[..., :3], matrix_from_rotation_vector(np.nan_to_num(pose[..., 3:]))
        with np.errstate(all="ignore"):
            found = solve_inverse_kinematics(self.machine, theta, position, rotation, check=False)
        return position, rotation, np.where(found.converged[..., None], found.actuators, np.nan)

    def linearise(self, theta: Array, pose: Array, with_parameters: bool = True, given: Given = NOTHING) -> Readings:
        """Return the readings with their derivatives; see `ReadingModel.linearise`."""
        del given
        machine, n = self.machine, self.n_legs
        position, rotation, actuators = self._hold(theta, pose)
        with np.errstate(all="ignore"):
            basis = machine.basis_at(theta, actuators)
            closure = machine.model.prepare(machine.layout, theta)(position, rotation, basis, with_parameters)
        values = np.concatenate([actuators, np.broadcast_to(pose, (*actuators.shape[:-1], len(POSE)))], axis=-1)
        inverse = invert_closure(closure.actuators)
        by_pose = np.zeros((*values.shape, len(POSE)))
        by_pose[..., :n, :] = -inverse @ closure.pose
        by_pose[..., :n, 3:] = by_pose[..., :n, 3:] @ turn_by_coordinates(pose)  # by the rotation vector itself
        by_pose[..., n:, :] = np.eye(len(POSE))
        if not with_parameters:
            return Readings(values, by_pose)
        by_parameters = np.zeros((*values.shape, self.layout.size))
        by_parameters[..., :n, :] = -inverse @ closure.parameters
        return Readings(values, by_pose, by_parameters)

    def tool(self, theta: Array, pose: Array) -> tuple[Array, Array, Array]:
        """Return the pose; see `ReadingModel.tool`. No parameter moves it."""
        shape = np.broadcast_shapes(theta.shape[:-1], pose.shape[:-1])
        nothing = np.zeros((*shape, len(POSE), self.layout.size))
        return np.broadcast_to(pose, (*shape, len(POSE))), np.broadcast_to(np.eye(len(POSE)), (*shape, 6, 6)), nothing

    def tool_values(self, theta: Array, pose: Array) -> Array:
        """Return the pose; see `ReadingModel.tool_values`."""
        return np.broadcast_to(pose, (*np.broadcast_shapes(theta.shape[:-1], pose.shape[:-1]), len(POSE)))

    def rotation(self, pose: Array) -> Array:
        """Return the platform's rotation; see `ReadingModel.rotation`."""
        return matrix_from_rotation_vector(pose[..., 3:])

    # --- commands --------------------------------------------------------------------------------------------------

    def locate(
        self,
        theta: Array,
        commands: Array,
        given: Given = NOTHING,
        start: Array | None = None,
        weights: Array | None = None,
    ) -> tuple[Array, np.ndarray]:
        """Return the poses of actuator positions by forward kinematics, which keeps to home's branch.

        Those of redundant legs, which may contradict each other, are then that of least squares in the actuators.
        """
        del start
        found = solve_forward_kinematics(self.machine, theta, commands, check=False)
        good = found.converged
        turned = np.full((*good.shape, 3), np.nan)
        turned[good] = rotation_vector_from_matrix(found.rotation[good])
        pose = np.concatenate([np.where(good[..., None], found.position, np.nan), turned], axis=-1)
        if self.n_legs == len(POSE):
            return pose, good
        near = np.where(good[..., None], pose, self.home_pose)
        pose, arrived = locate_pose(self, theta, commands, given, near, weights)
        return np.where(good[..., None], pose, np.nan), good & arrived

    def respond(self, theta: Array, mean: Array, pose: Array, commands: Array, given: Given = NOTHING) -> Array:
        """Return h - ρ as -(∂f/∂ρ)⁻¹ f, whose slope is the mean machine's: no inverse kinematics for each draw."""
        del given
        machine = self.machine
        position, rotation = pose[:, :3], matrix_from_rotation_vector(np.nan_to_num(pose[:, 3:]))
        with np.errstate(all="ignore"):  # poses that were not found
            basis = machine.basis(commands)
            closure = machine.model.bind(machine.layout, position, rotation, basis)
            residual = closure.evaluate(np.asfortranarray(theta)).transpose(1, 0, 2)
            here = machine.model.prepare(machine.layout, mean)(position, rotation, basis, False)
            return np.asarray(-(invert_closure(here.actuators) @ residual))

    def find_faults(self, theta: Array, pose: Array, commands: Array, given: Given = NOTHING) -> tuple[str, ...]:
        """Return why poses are out of reach: a leg that does not, an actuator beyond its range, another branch."""
        del given
        mechanism = self.machine.mechanism
        moved = commands - mechanism.initial_actuator_positions
        furthest = np.argmax(np.nan_to_num(np.abs(moved)), axis=1)
        position, rotation = pose[:, :3], matrix_from_rotation_vector(pose[:, 3:])
        on_branch = self.machine.holds_branch(theta, position, rotation, commands)
        faults = []
        for k, leg in enumerate(furthest):
            travel = moved[k, leg]
            if not np.isfinite(commands[k]).all():
                faults.append("no actuator positions hold it")
            elif abs(travel) > mechanism.actuator_range + SLACK:
                reach = f"{mechanism.actuator_range:g} mm"
                faults.append(f"leg {leg + 1} would move by {travel:.4g} mm, its range is {reach}")
            else:
                faults.append("" if on_branch[k] else "only on another assembly branch")
        return tuple(faults)


def invert_closure(matrix: Array) -> Array:
    """Return inverses of ∂f/∂ρ (..., N, N), NaN where one is not finite."""
    good = np.isfinite(matrix).all(axis=(-1, -2), keepdims=True)
    return np.where(good, np.linalg.inv(np.where(good, matrix, np.eye(matrix.shape[-1]))), np.nan)


def turn_by_coordinates(pose: Array) -> Array:
    """Return the rotation in the base frame per change of the rotation vector, shape (..., 3, 3)."""
    return np.asarray(np.linalg.inv(compute_left_inverse_jacobian(np.nan_to_num(pose[..., 3:]))))
