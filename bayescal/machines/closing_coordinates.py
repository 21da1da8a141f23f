"""Coordinates in which a leg's length follows the rest of its geometry, so that the leg closes at one pose as before.

Measured poses determine the mean closure of a leg to a fraction of a micrometre, its joints perhaps to a millimetre
only: where the model error may be a function of the pose. The length that closes the leg is no linear function of where
the joints are, and a millimetre squared over the leg is micrometres. In place of the length l stands what it is beyond
the length that closes the leg at a reference pose; as a shear along l this has unit Jacobian.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.machines.coordinates import Coordinates
from bayescal.machines.kinematics import Machine
from bayescal.numerics.geometry import Array

LENGTH = "l"


@dataclass(frozen=True, eq=False)
class ClosingCoordinates(Coordinates):
    """Coordinates with free leg lengths counted from what closes the legs at a reference pose.

    Attributes
    ----------
    machine : Machine
    position, rotation, actuators : ndarray, shapes (1, 3), (1, 3, 3), (1, N)
        The reference pose.
    """

    machine: Machine
    position: Array
    rotation: Array
    actuators: Array

    @classmethod
    def around(cls, known: Coordinates, machine: Machine, position: Array, rotation: Array, actuators: Array) -> Self:
        """Return coordinates as they are but for the leg lengths."""
        as_they_are = {field.name: getattr(known, field.name) for field in fields(Coordinates)}
        return cls(**as_they_are, machine=machine, position=position, rotation=rotation, actuators=actuators)

    @cached_property
    def _lengths(self) -> np.ndarray:
        """Legs whose length is free and not bounded."""
        index = self.layout.index.get(LENGTH)
        return np.empty(0, dtype=int) if index is None else np.flatnonzero(self._mask[index])

    @cached_property
    def _slope(self) -> Array:
        """Closure per length of these legs, where the coordinates start."""
        return self._differentiate(self.start)[self._lengths, self.layout.index[LENGTH][self._lengths]]

    @cached_property
    def _gap(self) -> Array:
        """Closure of these legs where the coordinates start."""
        return self._close(self.start[None])[0]

    def _differentiate(self, theta: Array) -> Array:
        """Return the closure's derivative at the reference pose for one parameter vector (D,), shape (N, D)."""
        size, machine = self.machine.layout.size, self.machine
        return machine.linearise(theta[:size], self.position, self.rotation, self.actuators).parameters[0]

    def _close(self, theta: Array) -> Array:
        """Return the closure of these legs at the reference pose, (B, D) to (B, k)."""
        layout, model = self.machine.layout, self.machine.model
        bound = model.bind(layout, self.position, self.rotation, self.machine.basis(self.actuators))
        closure = bound.evaluate(np.asfortranarray(theta[:, : layout.size]))
        return np.asarray(closure[self._lengths, 0].T.copy())

    def _follow(self, theta: Array) -> Array:
        """Return by how much the lengths follow the rest of θ (..., D), shape (..., k)."""
        flat = theta.reshape(-1, theta.shape[-1]).copy()
        index = self.layout.index[LENGTH][self._lengths]
        flat[:, index] = self.start[index]
        moved = (self._close(flat) - self._gap) / -self._slope
        return np.asarray(moved.reshape(*theta.shape[:-1], -1))

    def theta_from_y(self, y: Array) -> Array:
        """Return full parameter vectors (..., D); see `Coordinates.theta_from_y`."""
        theta = super().theta_from_y(y)
        if len(self._lengths):
            theta[..., self.layout.index[LENGTH][self._lengths]] += self._follow(theta)
        return theta

    def y_from_theta(self, theta: Array) -> Array:
        """Return the coordinates (..., n) of full parameter vectors (..., D)."""
        theta = theta.copy()
        if len(self._lengths):
            theta[..., self.layout.index[LENGTH][self._lengths]] -= self._follow(theta)
        return super().y_from_theta(theta)

    def jacobian(self, theta: Array) -> Array:
        """Return dθ/dy, shape (D, n), at one parameter vector (D,)."""
        change = super().jacobian(theta)
        if len(self._lengths):
            index = self.layout.index[LENGTH][self._lengths]
            held = theta.copy()
            held[index] = self.start[index]
            slope = self._differentiate(held)[self._lengths]
            slope[:, index] = 0.0
            change[index] -= (slope @ change[: self.machine.layout.size]) / self._slope[:, None]
        return change


def close_at_mean(
    known: Coordinates, machine: Machine, position: Array, rotation: Array, actuators: Array
) -> ClosingCoordinates:
    """Return coordinates whose lengths close the legs at the mean of poses (P, 3), (P, 3, 3) and actuators (P, N)."""
    where = position.mean(axis=0), average_rotation(rotation), actuators.mean(axis=0)
    return ClosingCoordinates.around(known, machine, *(one[None] for one in where))


def average_rotation(rotations: Array) -> Array:
    """Return the rotation nearest to the mean of rotations (P, 3, 3)."""
    return np.asarray(Rotation.from_matrix(rotations).mean().as_matrix())
