"""What a kinematic model has to supply, and what it gets from the frame in return.

A model writes its closure as a residual ``f(pose, actuators; theta)`` with one entry per leg, in mm, that vanishes
where the machine can stand. It supplies that residual and its first derivatives; forward kinematics, likelihood,
posterior, prediction and report come from the frame.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayescal.deformations.base import DeformationBasis
from bayescal.geometry import Array
from bayescal.mechanism import Mechanism
from bayescal.parameters import ParameterBlock, ParameterLayout


@dataclass(frozen=True)
class Linearisation:
    """Closure residual and its derivatives at given poses; leading axes are those of the poses.

    Attributes
    ----------
    residual : ndarray, shape (..., N)
        f, mm.
    pose : ndarray, shape (..., N, 6)
        Derivative with respect to the pose, position in mm and rotation vector in radians, base frame.
    actuators : ndarray, shape (..., N, N)
        Derivative with respect to the actuator positions.
    parameters : ndarray, shape (..., N, D)
        Derivative with respect to the parameter vector.
    """

    residual: Array
    pose: Array
    actuators: Array
    parameters: Array


class BoundClosure(ABC):
    """A closure bound to measured poses, for batches of parameter vectors: the hot path of the likelihood.

    Arrays run over (leg, pose, batch), the batch last: there every operation is a long contiguous loop. What a method
    returns is scratch, valid until the method is called again.
    """

    @abstractmethod
    def evaluate(self, theta: Array) -> Array:
        """Return f for parameter vectors of shape (B, D), as an array (N, P, B); keeps what ``along`` needs."""

    @abstractmethod
    def along(self, pose_error: Array) -> Array:
        """Return the pose derivative times pose errors (6, P, B), as an array (N, P, B), for the last ``evaluate``."""


class KinematicModel(ABC):
    """A kinematic model: a name, its parameters and its closure."""

    name: ClassVar[str]
    title: ClassVar[str]

    @abstractmethod
    def blocks(self, mechanism: Mechanism) -> tuple[ParameterBlock, ...]:
        """Return the model's parameters with their nominal values."""

    @abstractmethod
    def linearise(
        self, layout: ParameterLayout, theta: Array, position: Array, rotation: Array, basis: DeformationBasis
    ) -> Linearisation:
        """Return the closure and its derivatives.

        Parameters
        ----------
        layout : ParameterLayout
            Where the model's and the deformation's parameters stand in ``theta``.
        theta : ndarray, shape (D,) or (..., D)
            Parameter vectors, broadcast against the leading axes of the poses.
        position, rotation : ndarray, shapes (..., 3) and (..., 3, 3)
            Poses of the platform frame in the base frame, mm.
        basis : DeformationBasis
            Displacements of the actuators with the deformation they cause, leading axes those of the poses.
        """

    @abstractmethod
    def bind(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> BoundClosure:
        """Return the closure bound to poses (P, 3), (P, 3, 3) for repeated evaluation over batches of parameters."""

    @abstractmethod
    def inverse_kinematics(
        self, layout: ParameterLayout, theta: Array, position: Array, rotation: Array, deflection: Array
    ) -> Array:
        """Return the actuator positions (..., N) in mm of given poses and platform deflections (..., N) in mm."""


def broadcast_leading(theta: Array, position: Array) -> tuple[int, ...]:
    """Return the common leading shape of parameter vectors (..., D) and positions (..., 3)."""
    return np.broadcast_shapes(theta.shape[:-1], position.shape[:-1])
