"""The assembly branch of home: of all poses that close with given actuator positions, those reached without a jump.

Lengths of legs and actuator positions fix a pose up to the branch. Two signs cannot change on the way from home unless
the machine passes a singular pose: that of u · g, on which side of its foot a carriage stands, and for six legs that of
the determinant of their lines, of unit directions and moments. They are those of perfect legs without deformation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.machines.mechanism import Drive
from bayescal.machines.models.legs import actuator_directions, dot
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array

LEAST_SIDE = 1e-9  # of a leg's direction along its actuator, below which it is on no side
LEAST_TURN = 1e-9  # determinant, moments in units of the platform's size, of which nothing can be said


@dataclass(frozen=True, eq=False)
class Branch:
    """Signs at home.

    Attributes
    ----------
    drive : str
    sides : ndarray, shape (N,)
        Of u · g; zero where it says nothing, as for struts.
    turn : float
        Of the determinant of the legs' lines; zero where it says nothing.
    """

    drive: Drive
    sides: Array
    turn: float

    def holds(
        self, layout: ParameterLayout, theta: Array, position: Array, rotation: Array, actuators: Array
    ) -> np.ndarray:
        """Return whether poses (..., 3), (..., 3, 3) of machines (..., D) are on the branch; those unknown are."""
        side, turn = compute_signs(self.drive, layout, theta, position, rotation, actuators)
        with np.errstate(invalid="ignore"):
            lost: np.ndarray = (side * self.sides < 0.0).any(axis=-1) | (turn * self.turn < 0.0)
        return ~lost


def compute_signs(
    drive: Drive, layout: ParameterLayout, theta: Array, position: Array, rotation: Array, actuators: Array
) -> tuple[Array, Array]:
    """Return the signs of u · g, shape (..., N), and of the determinant of the legs' lines, shape (...); zero for none.

    Parameters
    ----------
    drive : str
    layout : ParameterLayout
    theta : ndarray, shape (..., D)
    position, rotation : ndarray, shapes (..., 3) and (..., 3, 3)
        Base frame, mm.
    actuators : ndarray, shape (..., N)
        mm.
    """
    arm = layout.take_vector(theta, "b") @ np.swapaxes(rotation, -1, -2)
    leg = position[..., None, :] + arm - layout.take_vector(theta, "a")
    side = np.zeros(leg.shape[:-1])
    if drive == "base":
        u = actuator_directions(layout, theta)
        leg = leg - actuators[..., None] * u
        side = _sign(dot(u, leg) / np.linalg.norm(leg, axis=-1), LEAST_SIDE)
    if leg.shape[-2] != DEGREES_OF_FREEDOM:
        return side, np.zeros(leg.shape[:-2])
    size = np.linalg.norm(arm, axis=-1).max(axis=-1)[..., None, None]
    line = leg / np.linalg.norm(leg, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        turn = np.linalg.det(np.concatenate([line, np.cross(arm / size, line)], axis=-1))
    return side, _sign(turn, LEAST_TURN)


def _sign(value: Array, least: float) -> Array:
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(value) > least, np.sign(value), 0.0)
