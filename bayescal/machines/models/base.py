"""What a kinematic model has to supply, and what it gets from the frame in return.

A model writes its closure as a residual ``f(pose, actuators; theta)`` with one entry per leg, in mm, that vanishes
where the machine can stand. It supplies that residual and its first derivatives; forward kinematics, likelihood,
posterior, prediction and report come from the frame.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from bayescal.config.sections import Section
from bayescal.errors import NumericalError
from bayescal.machines.deformations import DeformationBasis
from bayescal.machines.mechanism import Drive, Mechanism
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.numerics.geometry import Array


@dataclass(frozen=True)
class Linearisation:
    """Closure residual and its derivatives at given poses; leading axes are those of the poses."""

    residual: Array  # (..., N): f, mm
    # (..., N, 6): derivative with respect to the pose, position in mm and rotation vector in radians, base frame
    pose: Array
    actuators: Array  # (..., N, N): derivative with respect to the actuator positions
    # (..., N, D): derivative with respect to the parameter vector; empty where it was not asked for
    parameters: Array = field(default_factory=lambda: np.empty(0))


class Closure(Protocol):
    """The closure of given machines: what depends on their parameters alone is found once."""

    def __call__(
        self, position: Array, rotation: Array, basis: DeformationBasis, with_parameters: bool = True
    ) -> Linearisation:
        """Return the closure and its derivatives, those by the parameters where asked for.

        Parameters
        ----------
        position, rotation : ndarray, shapes (..., 3) and (..., 3, 3)
            Poses of the platform frame in the base frame, mm.
        basis : DeformationBasis
            Displacements of the actuators with the deformation they cause, leading axes those of the poses.
        with_parameters : bool
            Whether the derivative by the parameters is needed, which costs more than all else.
        """


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
        """Return the pose derivative times pose errors (6, P, B), as an array (N, P, B), for the last ``evaluate``.

        Parts of the derivative that hardly depend on the parameters may be left out: the likelihood adds the
        difference from the exact derivative of the nominal machine.
        """


class KinematicModel(ABC):
    """A kinematic model: a name, the drive of the machines it takes, its parameters and its closure.

    One of somebody else's is named in a config, ``model = "own_model.py:OwnModel"``; its ``Config`` checks its options,
    and `__init__(self, config, mechanism)` makes it.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    drive: ClassVar[Drive] = "base"
    has_perfect_joints: ClassVar[bool] = False
    """Whether distances of joints are all that its closure knows of its legs."""
    Config: ClassVar[type[Section]] = Section

    @classmethod
    def from_config(cls, config: Any, mechanism: Mechanism) -> Self:
        """Return a built-in model of a mechanism."""
        del config
        return cls.from_mechanism(mechanism)

    @classmethod
    def from_mechanism(cls, mechanism: Mechanism) -> Self:
        """Return the model of a mechanism; one that needs more than parameters takes it from there.

        InputError where the mechanism lacks what the model needs.
        """
        del mechanism
        return cls()

    @abstractmethod
    def blocks(self, mechanism: Mechanism) -> tuple[ParameterBlock, ...]:
        """Return the model's parameters with their nominal values."""

    @abstractmethod
    def prepare(self, layout: ParameterLayout, theta: Array) -> Closure:
        """Return the closure of given machines.

        Parameters
        ----------
        layout : ParameterLayout
            Where the model's and the deformation's parameters stand in ``theta``.
        theta : ndarray, shape (D,) or (..., D)
            Parameter vectors, broadcast against the leading axes of the poses.
        """

    def linearise(
        self, layout: ParameterLayout, theta: Array, position: Array, rotation: Array, basis: DeformationBasis
    ) -> Linearisation:
        """Return the closure and its derivatives, arguments as in `prepare` and `Closure`."""
        return self.prepare(layout, theta)(position, rotation, basis)

    def close(self, closure: Closure, position: Array, rotation: Array, basis: DeformationBasis) -> Array | None:
        """Return f alone, shape (..., N), of a closure that `prepare` returned; arguments as in `Closure`.

        None where derivatives by pose and actuators cost next to nothing beside.
        """
        del closure, position, rotation, basis
        return None

    @abstractmethod
    def bind(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> BoundClosure:
        """Return the closure bound to poses (P, 3), (P, 3, 3) for repeated evaluation over batches of parameters."""

    def objective(self, mechanism: Mechanism) -> Array:
        """Return W, shape (N, N), such that W f is what least squares minimises in RR-8096 (table 2)."""
        return np.eye(mechanism.n_legs)


def newton_step(linearisation: Linearisation) -> Array:
    """Return the pose step (..., 6) that makes the linearised closure vanish, the least-squares one for N > 6.

    It is NaN where the closure is; NumericalError where the pose Jacobian is singular.
    """
    jacobian, residual = linearisation.pose, linearisation.residual
    good = np.isfinite(residual).all(axis=-1) & np.isfinite(jacobian).all(axis=(-1, -2))
    jacobian = np.where(good[..., None, None], jacobian, np.eye(*jacobian.shape[-2:]))
    normal = np.swapaxes(jacobian, -1, -2)
    square = jacobian if jacobian.shape[-2] == jacobian.shape[-1] else normal @ jacobian
    right = residual if square is jacobian else np.einsum("...ij,...j->...i", normal, residual)
    try:
        step = -np.linalg.solve(square, right[..., None])[..., 0]
    except np.linalg.LinAlgError as error:
        raise NumericalError("forward kinematics: singular pose Jacobian") from error
    return np.where(good[..., None], np.clip(step, -100.0, 100.0), np.nan)
