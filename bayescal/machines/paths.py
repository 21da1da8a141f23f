"""Ways from home to a pose: those of the actuators, along which poses are found, and those of the platform."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayescal.machines.deformations.base import DeformationBasis
from bayescal.machines.models.base import Closure, newton_step
from bayescal.machines.models.leg_distance import PerfectLegs
from bayescal.machines.models.six_pus import SixPus
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector, rotation_vector_from_matrix

if TYPE_CHECKING:
    from bayescal.machines.kinematics import Machine

STRIDE = 0.25  # of the shortest leg, that actuators move from one pose of a path to the next one
STEPS_ON_THE_WAY = 4  # of Newton's method at each pose of a path
SETTLED = 1e-3  # mm and rad, of the last of them, above which there is no pose on the path
FINER = 8  # times as many poses on a path that was lost
LOOKS = 32  # at poses of a straight way of the platform


def step_pose(
    closure: Closure, position: Array, rotation: Array, basis: DeformationBasis
) -> tuple[Array, Array, Array]:
    """Return the poses after a Newton step, and the step."""
    step = newton_step(closure(position, rotation, basis, with_parameters=False))
    return position + step[..., :3], matrix_from_rotation_vector(step[..., 3:]) @ rotation, step


def follow_path(
    machine: Machine, theta: Array, position: Array, rotation: Array, actuators: Array
) -> tuple[Array, Array, np.ndarray]:
    """Return poses of perfect joints near those of actuators (..., N), from home poses, and whether the path led there.

    Machines whose actuators travel little by design have theirs near enough to home: these poses are returned. Where a
    path leaves the branch of home, a finer one is tried.
    """
    mechanism, shape = machine.mechanism, position.shape[:-1]
    n_strides = int(np.ceil(mechanism.actuator_range / (STRIDE * mechanism.leg_lengths.min())))
    if mechanism.drive == "strut" or n_strides < 2:
        return position, rotation, np.ones(shape, dtype=bool)
    reached, turned, kept = _walk(machine, theta, position, rotation, actuators, n_strides)
    if kept.all():
        return reached, turned, kept
    reached, turned, kept = (np.array(one) for one in (reached, turned, kept))
    lost = ~kept
    some = np.broadcast_to(theta, (*shape, theta.shape[-1]))[lost]
    found = _walk(machine, some, position[lost], rotation[lost], actuators[lost], FINER * n_strides)
    reached[lost], turned[lost], kept[lost] = found
    return reached, turned, kept


def _walk(
    machine: Machine, theta: Array, position: Array, rotation: Array, actuators: Array, n_strides: int
) -> tuple[Array, Array, np.ndarray]:
    """Return poses along the straight path of the actuators, and whether all on the way settled on home's branch."""
    closure, start = SixPus().prepare(machine.layout, theta), machine.mechanism.initial_actuator_positions
    kept = np.ones(position.shape[:-1], dtype=bool)
    for share in np.arange(1, n_strides + 1) / n_strides:
        here = start + share * (actuators - start)
        basis = machine.basis(here)
        for _ in range(STEPS_ON_THE_WAY):
            position, rotation, step = step_pose(closure, position, rotation, basis)
        kept = kept & (np.abs(step) < SETTLED).all(axis=-1) & machine.holds_branch(theta, position, rotation, here)
    return position, rotation, kept


def comes_straight(machine: Machine, theta: Array, position: Array, rotation: Array) -> np.ndarray:
    """Return whether the straight ways of the platform from home to poses (L, 3), (L, 3, 3) keep to home's branch.

    Carriages of perfect legs follow on the side of home; theta is of shape (L, D).
    """
    home, share = machine.nominal_home, (np.arange(1, LOOKS + 1) / LOOKS)[:, None]
    turn = rotation_vector_from_matrix(rotation @ home.rotation.T)
    between = home.position + share * (position - home.position)[:, None]
    turned = matrix_from_rotation_vector(share * turn[:, None]) @ home.rotation
    one = theta[:, None]
    legs = PerfectLegs(machine.layout, one, between, turned, machine.sides)
    actuators = machine.mechanism.initial_actuator_positions + legs.displace()
    kept = np.isfinite(actuators).all(axis=-1) & machine.holds_branch(one, between, turned, actuators)
    return np.asarray(kept.all(axis=1))
