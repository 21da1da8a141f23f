"""The 6-PUS model: flexures as perfect spherical joints, legs of fixed length (RR-8096 section 4.1).

Closure of leg i (eq. 30): f = l - |g| with g = p + R (b + Δb_z e_z) - a - ρ u. The model holds for any number of legs.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from bayescal.deformations.base import DeformationBasis
from bayescal.errors import NumericalError
from bayescal.geometry import Array
from bayescal.mechanism import Mechanism
from bayescal.models.base import BoundClosure, KinematicModel, Linearisation
from bayescal.parameters import ParameterBlock, ParameterLayout


def actuator_directions(layout: ParameterLayout, theta: Array) -> Array:
    """Return the unit vectors u, shape (..., N, 3), with u_z = sqrt(1 - u_x² - u_y²); NaN where that is not real."""
    u_x, u_y = layout.take(theta, "u_x"), layout.take(theta, "u_y")
    with np.errstate(invalid="ignore"):
        u_z = np.sqrt(1.0 - u_x * u_x - u_y * u_y)
    return np.stack([u_x, u_y, u_z], axis=-1)


class SixPus(KinematicModel):
    """P-U-S legs with perfect joints."""

    name: ClassVar[str] = "six_pus"
    title: ClassVar[str] = "6-PUS"

    def blocks(self, mechanism: Mechanism) -> tuple[ParameterBlock, ...]:
        """Return a, b, u (its x and y), l and ρ^0 of each leg."""
        columns = [
            *((f"a_{axis}", mechanism.base_points[:, k], "mm") for k, axis in enumerate("xyz")),
            *((f"b_{axis}", mechanism.platform_points[:, k], "mm") for k, axis in enumerate("xyz")),
            *((f"u_{axis}", mechanism.directions[:, k], "1") for k, axis in enumerate("xy")),
            ("l", mechanism.leg_lengths, "mm"),
            ("rho0", mechanism.initial_actuator_positions, "mm"),
        ]
        return tuple(ParameterBlock(symbol, tuple(values.tolist()), unit) for symbol, values, unit in columns)

    def linearise(
        self, layout: ParameterLayout, theta: Array, position: Array, rotation: Array, basis: DeformationBasis
    ) -> Linearisation:
        """Return eq. (30) and its exact derivatives; see `KinematicModel.linearise` for shapes and frames."""
        direction = actuator_directions(layout, theta)
        travel = layout.take(theta, "rho0") + basis.displacement
        joint = layout.take_vector(theta, "b").copy()
        joint = np.broadcast_to(joint, np.broadcast_shapes(joint.shape, (*basis.displacement.shape, 3))).copy()
        joint[..., 2] += basis.deflection(layout, theta)
        arm = np.einsum("...jk,...ik->...ij", rotation, joint)
        vector = position[..., None, :] + arm - layout.take_vector(theta, "a") - travel[..., None] * direction
        length = np.linalg.norm(vector, axis=-1)
        axis = vector / length[..., None]
        local_axis = np.einsum("...kj,...ik->...ij", rotation, axis)  # leg direction seen from the platform
        along_actuator = np.sum(axis * direction, axis=-1)
        pose = -np.concatenate([axis, np.cross(arm, axis)], axis=-1)
        eye = np.eye(axis.shape[-2])
        actuators = eye * along_actuator[..., None] - local_axis[..., 2, None] * basis.actuator_gain
        slope = direction[..., :2] / direction[..., 2:]
        columns = {f"a_{name}": axis[..., k] for k, name in enumerate("xyz")}
        columns |= {f"b_{name}": -local_axis[..., k] for k, name in enumerate("xyz")}
        columns |= {f"u_{name}": travel * (axis[..., k] - axis[..., 2] * slope[..., k]) for k, name in enumerate("xy")}
        columns |= {"l": np.ones_like(length), "rho0": along_actuator}
        columns |= {symbol: -local_axis[..., 2] * c for symbol, c in basis.coefficients.items()}
        parameters = np.zeros((*length.shape, layout.size))
        legs = np.arange(length.shape[-1])
        for symbol, column in columns.items():
            parameters[..., legs, layout.index[symbol]] = column
        return Linearisation(layout.take(theta, "l") - length, pose, actuators, parameters)

    def bind(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> BoundClosure:
        """Return the closure as one matrix product per leg."""
        return SixPusClosure(layout, position, rotation, basis)

    def inverse_kinematics(
        self, layout: ParameterLayout, theta: Array, position: Array, rotation: Array, deflection: Array
    ) -> Array:
        """Return ρ of eq. (7), the lower of its two roots; NumericalError where a leg cannot reach."""
        direction = actuator_directions(layout, theta)
        joint = np.zeros((*deflection.shape, 3)) + layout.take_vector(theta, "b")
        joint[..., 2] += deflection
        h = position[..., None, :] + np.einsum("...jk,...ik->...ij", rotation, joint) - layout.take_vector(theta, "a")
        h_u = np.sum(h * direction, axis=-1)
        square = h_u**2 - np.sum(h * h, axis=-1) + layout.take(theta, "l") ** 2
        if np.any(square < 0):
            leg = int(np.argwhere(square < 0)[0, -1]) + 1
            raise NumericalError(f"inverse kinematics: leg {leg} cannot reach the pose, its length is too short")
        return h_u - np.sqrt(square)


def _cross(left: Array, right: Array) -> tuple[Array, Array, Array]:
    """Return the components of a cross product of arrays whose first axis is xyz."""
    return tuple(left[m] * right[n] - left[n] * right[m] for m, n in ((1, 2), (2, 0), (0, 1)))


class SixPusClosure(BoundClosure):
    """Leg vectors of all poses as one product of a fixed design and the parameters of a leg.

    With c = a + ρ^0 u, g = q + R b + κ φ R e_z - c - Δρ u is linear in (b, κ, c, u): the design of a leg is an array
    (3 P, F), the parameters (F, B), F = 9 + number of deformation parameters.
    """

    def __init__(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> None:
        self._layout, self._symbols = layout, tuple(basis.coefficients)
        n_poses, n_legs = basis.displacement.shape
        n_features = 9 + len(self._symbols)
        z_axis = rotation[:, :, 2]
        design = np.zeros((n_legs, 3, n_poses, n_features))
        design[..., 0:3] = np.moveaxis(rotation, 1, 0)
        design[:, range(3), :, range(3, 6)] = -1.0
        displacement = basis.displacement.T
        design[:, range(3), :, range(6, 9)] = -displacement[None]
        for k, symbol in enumerate(self._symbols):
            design[..., 9 + k] = basis.coefficients[symbol].T[:, None, :] * z_axis.T[None]
        offset = position.T[None] + basis.constant.T[:, None, :] * z_axis.T[None]
        self._design = design.reshape(n_legs, 3 * n_poses, n_features)
        self._offset = offset.reshape(n_legs, 3 * n_poses, 1)
        self._displacement = displacement[:, None, :, None]
        self._position = position.T[:, :, None]
        self._shape = (n_legs, 3, n_poses)

    def evaluate(self, theta: Array) -> Array:
        """Return f = l - |g|, shape (N, P, B)."""
        take = self._layout.take
        direction = actuator_directions(self._layout, theta)
        joint = self._layout.take_vector(theta, "a") + take(theta, "rho0")[..., None] * direction
        parts = [self._layout.take_vector(theta, "b"), joint, direction]
        parts += [take(theta, symbol)[..., None] for symbol in self._symbols]
        features = np.ascontiguousarray(np.concatenate(parts, axis=-1).transpose(1, 2, 0))
        vector = self._design @ features
        vector += self._offset
        self._vector = vector.reshape(*self._shape, -1)
        self._joint, self._direction = features[:, 3:6, None, :], features[:, 6:9, None, :]
        self._length = np.sqrt(np.einsum("ikpb,ikpb->ipb", self._vector, self._vector))
        return take(theta, "l").T[:, None, :] - self._length

    def along(self, pose_error: Array) -> Array:
        """Return -(z · e_p + z · (e_w x (c - p))); the lever arm c - p serves as well as R b*, since z x g = 0."""
        e_p, e_w = pose_error[:3], pose_error[3:]
        level = e_p - np.stack(_cross(e_w, self._position))
        arm = self._displacement * self._direction
        arm += self._joint
        work = np.empty_like(self._length)
        total = np.zeros_like(self._length)
        for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
            turned = e_w[m] * arm[:, n]
            turned -= np.multiply(e_w[n], arm[:, m], out=work)
            turned += level[k]
            turned *= self._vector[:, k]
            total += turned
        total /= self._length
        return np.negative(total, out=total)
