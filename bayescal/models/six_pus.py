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
from bayescal.workspace import Workspace


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
        """Return the closure as matrix products per leg."""
        return SixPusClosure(layout, position, rotation, basis)

    def inverse_kinematics(
        self, layout: ParameterLayout, theta: Array, position: Array, rotation: Array, deflection: Array
    ) -> Array:
        """Return ρ of eq. (7), the lower of its two roots; NumericalError where a leg cannot reach.

        The travel of eq. (7) starts from the true ρ^0, actuator positions are read from the nominal one.
        """
        direction = actuator_directions(layout, theta)
        joint = np.zeros((*deflection.shape, 3)) + layout.take_vector(theta, "b")
        joint[..., 2] += deflection
        h = position[..., None, :] + np.einsum("...jk,...ik->...ij", rotation, joint) - layout.take_vector(theta, "a")
        h_u = np.sum(h * direction, axis=-1)
        square = h_u**2 - np.sum(h * h, axis=-1) + layout.take(theta, "l") ** 2
        if np.any(square < 0):
            leg = int(np.argwhere(square < 0)[0, -1]) + 1
            raise NumericalError(f"inverse kinematics: leg {leg} cannot reach the pose, its length is too short")
        travel = h_u - np.sqrt(square)
        return travel - layout.take(theta, "rho0") + layout.take(layout.nominal, "rho0")


class SixPusClosure(BoundClosure):
    """Leg vectors and lever arms of all poses as products of a fixed design and the parameters of a leg.

    With c = a + ρ^0 u the leg vector g = q + R b* - c - Δρ u and its lever arm R b* = R b + (constant + κ φ) R e_z are
    linear in the features (1, b, κ, c, u) of a leg: a design (P, F) for each component times the features (F, B), with
    F = 10 + number of deformation parameters; the lever arm needs only the first of them. The pose derivative of f is
    (-g, R b* x -g) / |g|, of which the numerator is kept.
    """

    def __init__(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> None:
        self._layout, self._symbols = layout, tuple(basis.coefficients)
        n_poses, n_legs = basis.displacement.shape
        z_axis = rotation[:, :, 2].T[:, None]
        arm = [basis.constant.T * z_axis]
        arm += [np.broadcast_to(rotation[:, :, k].T[:, None], (3, n_legs, n_poses)) for k in range(3)]
        arm += [basis.coefficients[symbol].T * z_axis for symbol in self._symbols]
        self._arm_design = np.stack(arm, axis=-1)
        self._design = np.concatenate([-self._arm_design, np.zeros((3, n_legs, n_poses, 6))], axis=-1)
        self._design[..., 0] -= position.T[:, None]
        for k in range(3):
            self._design[k, :, :, len(arm) + k] = 1.0
            self._design[k, :, :, len(arm) + 3 + k] = basis.displacement.T
        self._workspace = Workspace()

    def _features(self, theta: Array) -> Array:
        """Return the features of each leg, shape (N, F, B)."""
        index, parameters = self._layout.index, np.ascontiguousarray(theta.T)
        direction = actuator_directions(self._layout, theta).T
        rho0 = parameters[index["rho0"]]
        rows = [np.ones_like(rho0), *(parameters[index[s]] for s in ("b_x", "b_y", "b_z", *self._symbols))]
        rows += [parameters[index[f"a_{axis}"]] + rho0 * u for axis, u in zip("xyz", direction, strict=True)]
        return np.stack([*rows, *direction], axis=1)

    def evaluate(self, theta: Array) -> Array:
        """Return f = l - |g|, shape (N, P, B)."""
        features, take = self._features(theta), self._workspace.take
        _, n_legs, n_poses, n_arm = self._arm_design.shape
        shape = (n_legs, n_poses, len(theta))
        self._slope = take("slope", 6, *shape)
        vector, moment = self._slope[:3], self._slope[3:]
        arm, work = take("arm", 3, *shape), take("work", *shape)
        np.matmul(self._design, features, out=vector)
        np.matmul(self._arm_design, features[:, :n_arm], out=arm)
        for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
            np.multiply(arm[m], vector[n], out=moment[k])
            moment[k] -= np.multiply(arm[n], vector[m], out=work)
        self._length = np.einsum("kipb,kipb->ipb", vector, vector, out=take("length", *shape))
        np.sqrt(self._length, out=self._length)
        return np.subtract(self._layout.take(theta, "l").T[:, None], self._length, out=work)

    def along(self, pose_error: Array) -> Array:
        """Return the pose derivative times e, shape (N, P, B)."""
        change = self._workspace.take("change", *self._length.shape)
        np.einsum("kipb,kpb->ipb", self._slope, pose_error, out=change)
        change /= self._length
        return change
