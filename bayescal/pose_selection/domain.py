"""Where poses may be measured: a box of pose displacements or of actuator displacements, the other one as constraint.

A pose is a point of the unit box [-1, 1]^d. In a `WorkspaceBox` its coordinates are the displacement and the rotation
vector about home, in shares of the half widths, and the actuators' range is the constraint; in an `ActuatorBox` they
are the actuators' displacements in shares of their range, and the constraint is a workspace, where there is one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from bayescal.errors import InputError
from bayescal.identifiability.design import SLACK, Knowledge, describe_move
from bayescal.identifiability.sensitivity import Sensitivity, linearise_at
from bayescal.machines.kinematics import (
    ForwardKinematics,
    check_home_pose,
    solve_forward_kinematics,
    solve_inverse_kinematics,
)
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector, rotation_vector_from_matrix


@dataclass(frozen=True, eq=False)
class PlacedPoses:
    """Poses with the actuator positions that hold them.

    Attributes
    ----------
    moves : ndarray, shape (P, 6)
        Displacement in mm and rotation vector in rad from home, base frame.
    position, rotation : ndarray, shapes (P, 3) and (P, 3, 3)
        Platform frame in the base frame, mm.
    actuators : ndarray, shape (P, N)
        mm.
    found : ndarray of bool, shape (P,)
        Whether the machine can stand there at all.
    """

    moves: Array
    position: Array
    rotation: Array
    actuators: Array
    found: np.ndarray

    def select(self, chosen: slice) -> PlacedPoses:
        """Return some of the poses."""
        return PlacedPoses(*(getattr(self, field.name)[chosen] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class PoseDomain(ABC):
    """The poses that may be measured with a machine.

    Attributes
    ----------
    knowledge : Knowledge
        The machine as expected beforehand, and its free parameters.
    """

    knowledge: Knowledge

    @property
    @abstractmethod
    def n_coordinates(self) -> int:
        """Number of coordinates d."""

    @abstractmethod
    def place(self, shares: Array) -> PlacedPoses:
        """Return the poses at points (P, d) of the unit box."""

    @abstractmethod
    def margins(self, placed: PlacedPoses) -> Array:
        """Return what is left of each constraint, shape (P, m), in shares of its limit; negative where it is broken."""

    @cached_property
    def theta(self) -> Array:
        """The machine's parameters, shape (D,)."""
        return self.knowledge.machine_centre

    @cached_property
    def home(self) -> ForwardKinematics:
        """The expected machine's pose at the initial actuator positions."""
        check_home_pose(self.knowledge.machine)
        start = self.knowledge.machine.mechanism.initial_actuator_positions
        return solve_forward_kinematics(self.knowledge.machine, self.theta, start)

    def allows(self, placed: PlacedPoses) -> np.ndarray:
        """Return which poses exist and keep the constraints, shape (P,)."""
        margins = self.margins(placed)
        kept: np.ndarray = placed.found & np.all(margins >= -SLACK, axis=1)
        return kept

    def at_moves(self, moves: Array) -> PlacedPoses:
        """Return poses at displacements (P, 6) from home, mm and rad."""
        position = self.home.position + moves[:, :3]
        rotation = matrix_from_rotation_vector(moves[:, 3:]) @ self.home.rotation
        inverse = solve_inverse_kinematics(self.knowledge.machine, self.theta, position, rotation, check=False)
        return PlacedPoses(moves, position, rotation, inverse.actuators, inverse.converged)

    def at_actuators(self, actuators: Array) -> PlacedPoses:
        """Return poses at actuator positions (P, N), mm."""
        pose = solve_forward_kinematics(self.knowledge.machine, self.theta, actuators, check=False)
        turned = pose.rotation @ self.home.rotation.T
        moves = np.concatenate([pose.position - self.home.position, rotation_vector_from_matrix(turned)], axis=-1)
        return PlacedPoses(moves, pose.position, pose.rotation, actuators, pose.converged)

    def linearise(self, placed: PlacedPoses, name: str = "candidate", first: int = 1) -> Sensitivity:
        """Return the derivatives at poses, whose numbers begin with ``first``.

        InputError names the first at which J_1, the pose Jacobian, is singular.
        """
        poses = ForwardKinematics(placed.position, placed.rotation, placed.found, 0)
        return linearise_at(
            self.knowledge,
            self.theta,
            poses,
            placed.actuators,
            lambda index: f"{name} {index + first} ({describe_move(placed.moves[index])})",
        )


@dataclass(frozen=True, eq=False)
class WorkspaceBox(PoseDomain):
    """A box of displacements and rotation vectors about home.

    Attributes
    ----------
    half : ndarray, shape (6,)
        Half widths, mm and rad; zero where an axis stays.
    """

    half: Array

    def __post_init__(self) -> None:
        """Check the half widths."""
        _check_half(self.half)

    @cached_property
    def _used(self) -> np.ndarray:
        return np.flatnonzero(self.half > 0.0)

    @property
    def n_coordinates(self) -> int:
        """Number of axes that move."""
        return len(self._used)

    def place(self, shares: Array) -> PlacedPoses:
        """Return the poses at points (P, d) of the unit box."""
        moves = np.zeros((len(shares), 6))
        moves[:, self._used] = shares * self.half[self._used]
        return self.at_moves(moves)

    def margins(self, placed: PlacedPoses) -> Array:
        """Return what is left of the actuators' range on both sides, shape (P, 2 N)."""
        mechanism = self.knowledge.machine.mechanism
        moved = (placed.actuators - mechanism.initial_actuator_positions) / mechanism.actuator_range
        return np.concatenate([1.0 - moved, 1.0 + moved], axis=1)


@dataclass(frozen=True, eq=False)
class ActuatorBox(PoseDomain):
    """A box of actuator displacements about the initial positions, for machines of six legs.

    Attributes
    ----------
    half : ndarray, shape (6,), optional
        Half widths of a workspace that poses must not leave, mm and rad.
    """

    half: Array | None = None

    def __post_init__(self) -> None:
        """Check that actuators alone determine a pose, and the half widths."""
        if self.n_coordinates != 6:
            raise InputError(
                f"poses by actuators: found {self.n_coordinates} legs, expected 6: more do not move freely"
            )
        if self.half is not None:
            _check_half(self.half)

    @property
    def n_coordinates(self) -> int:
        """Number of actuators."""
        return self.knowledge.machine.mechanism.n_legs

    def place(self, shares: Array) -> PlacedPoses:
        """Return the poses at points (P, N) of the unit box."""
        mechanism = self.knowledge.machine.mechanism
        return self.at_actuators(mechanism.initial_actuator_positions + mechanism.actuator_range * shares)

    def margins(self, placed: PlacedPoses) -> Array:
        """Return what is left of the workspace on both sides, shape (P, 12), or (P, 0) without one."""
        if self.half is None:
            return np.zeros((len(placed.moves), 0))
        shares = placed.moves / np.where(self.half > 0.0, self.half, 1.0)
        return np.concatenate([1.0 - shares, 1.0 + shares], axis=1)


def _check_half(half: Array) -> None:
    if half.shape != (6,) or not np.all(np.isfinite(half)) or np.any(half < 0.0) or not np.any(half > 0.0):
        listed = ", ".join(f"{value:g}" for value in half)
        raise InputError(
            f"workspace: found half widths {listed}, expected six that are finite, not negative, not all 0"
        )
