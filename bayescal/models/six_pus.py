"""The 6-PUS model: flexures as perfect spherical joints, legs of fixed length (RR-8096 section 4.1).

Closure of leg i (eq. 30): f = l - |g| with g = p + R (b + Δb_z e_z) - a - ρ u. The model holds for any number of legs.
"""

from __future__ import annotations

from functools import partial
from typing import ClassVar

import numpy as np

from bayescal.deformations.base import DeformationBasis
from bayescal.geometry import Array
from bayescal.mechanism import Mechanism
from bayescal.models.base import BoundClosure, Closure, KinematicModel, Linearisation
from bayescal.models.legs import compute_leg_vectors, scatter
from bayescal.parameters import ParameterBlock, ParameterLayout
from bayescal.workspace import Workspace


class SixPus(KinematicModel):
    """P-U-S legs with perfect joints."""

    name: ClassVar[str] = "six_pus"
    title: ClassVar[str] = "6-PUS"

    def blocks(self, mechanism: Mechanism) -> tuple[ParameterBlock, ...]:
        """Return a, b, u (its x and y), l and ρ^0 of each leg."""
        points = [
            *((f"a_{axis}", mechanism.base_points[:, k]) for k, axis in enumerate("xyz")),
            *((f"b_{axis}", mechanism.platform_points[:, k]) for k, axis in enumerate("xyz")),
        ]
        directions = [(f"u_{axis}", mechanism.directions[:, k]) for k, axis in enumerate("xy")]
        return (
            *(ParameterBlock(symbol, tuple(values.tolist())) for symbol, values in points),
            *(ParameterBlock(symbol, tuple(v.tolist()), "1", lower=-1.0, upper=1.0) for symbol, v in directions),
            ParameterBlock("l", tuple(mechanism.leg_lengths.tolist()), lower=0.0),
            ParameterBlock("rho0", tuple(mechanism.initial_actuator_positions.tolist())),
        )

    def prepare(self, layout: ParameterLayout, theta: Array) -> Closure:
        """Return eq. (30); see `KinematicModel.prepare` for shapes."""
        return partial(self._close, layout, theta)

    def _close(
        self,
        layout: ParameterLayout,
        theta: Array,
        position: Array,
        rotation: Array,
        basis: DeformationBasis,
        with_parameters: bool = True,
    ) -> Linearisation:
        """Return eq. (30) and its exact derivatives; see `Closure` for shapes and frames."""
        legs = compute_leg_vectors(layout, theta, position, rotation, basis)
        residual = layout.take(theta, "l") - legs.length
        back = legs.pull_back(-legs.axis, with_parameters)
        if not with_parameters:
            return Linearisation(residual, back.pose, back.actuators)
        columns = back.columns | {"l": np.ones_like(legs.length)}
        return Linearisation(residual, back.pose, back.actuators, scatter(layout, columns))

    def bind(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> BoundClosure:
        """Return the closure as matrix products per leg."""
        return SixPusClosure(layout, position, rotation, basis)


class SixPusClosure(BoundClosure):
    """Leg vectors and lever arms of all poses as products of a fixed design and the parameters of a leg.

    With c = a + ρ^0 u the leg vector g = q + R b* - c - Δρ u and its lever arm R b* = R b + (constant + κ φ) R e_z are
    linear in the features (1, b, κ, c, u) of a leg: a design (P, F) for each component times the features (F, B), with
    F = 10 + number of deformation parameters; the lever arm needs only the first of them. The pose derivative of f is
    (-g, R b* x -g) / |g|, of which the numerator is kept.
    """

    def __init__(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> None:
        self._layout, symbols = layout, tuple(basis.coefficients)
        n_poses, n_legs = basis.displacement.shape
        z_axis = rotation[:, :, 2].T[:, None]
        arm = [basis.constant.T * z_axis]
        arm += [np.broadcast_to(rotation[:, :, k].T[:, None], (3, n_legs, n_poses)) for k in range(3)]
        arm += [basis.coefficients[symbol].T * z_axis for symbol in symbols]
        self._arm_design = np.stack(arm, axis=-1)
        self._design = np.concatenate([-self._arm_design, np.zeros((3, n_legs, n_poses, 6))], axis=-1)
        self._design[..., 0] -= position.T[:, None]
        for k in range(3):
            self._design[k, :, :, len(arm) + k] = 1.0
            self._design[k, :, :, len(arm) + 3 + k] = basis.displacement.T
        groups = (("a_x", "a_y", "a_z"), ("b_x", "b_y", "b_z", *symbols), ("u_x", "u_y"))
        self._base, self._linear, self._direction = (
            np.stack([layout.index[symbol] for symbol in group]) for group in groups
        )
        self._workspace = Workspace()

    def _features(self, theta: Array) -> Array:
        """Return the features of each leg, shape (F, N, B)."""
        parameters, (n_linear, n_legs) = np.ascontiguousarray(theta.T), self._linear.shape
        features = np.empty((self._design.shape[-1], n_legs, len(theta)))
        lower, direction = features[-6:-3], features[-3:]
        features[0] = 1.0
        np.take(parameters, self._linear, axis=0, out=features[1 : 1 + n_linear], mode="clip")  # others would buffer
        np.take(parameters, self._direction, axis=0, out=direction[:2], mode="clip")
        with np.errstate(invalid="ignore"):
            np.sqrt(1.0 - direction[0] * direction[0] - direction[1] * direction[1], out=direction[2])
        np.multiply(parameters[self._layout.index["rho0"]], direction, out=lower)
        lower += parameters[self._base]
        return features

    def evaluate(self, theta: Array) -> Array:
        """Return f = l - |g|, shape (N, P, B)."""
        self._measure(theta)
        return np.subtract(self._layout.take(theta, "l").T[:, None], self._length, out=self._take("closure"))

    def _take(self, name: str, *leading: int) -> Array:
        """Return a scratch array (..., N, P, B)."""
        return self._workspace.take(name, *leading, *self._length.shape)

    def _measure(self, theta: Array) -> Array:
        """Find leg vectors, moments and lengths; return the lever arms, shape (3, N, P, B), scratch."""
        features, take = self._features(theta), self._workspace.take
        _, n_legs, n_poses, n_arm = self._arm_design.shape
        shape = (n_legs, n_poses, len(theta))
        self._slope, self._length = take("slope", 6, *shape), take("length", *shape)
        vector, moment, arm, work = self._slope[:3], self._slope[3:], self._take("arm", 3), self._take("work")
        np.matmul(self._design, features.transpose(1, 0, 2), out=vector)
        np.matmul(self._arm_design, features[:n_arm].transpose(1, 0, 2), out=arm)
        for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
            np.multiply(arm[m], vector[n], out=moment[k])
            moment[k] -= np.multiply(arm[n], vector[m], out=work)
        np.einsum("kipb,kipb->ipb", vector, vector, out=self._length)
        np.sqrt(self._length, out=self._length)
        return arm

    def along(self, pose_error: Array) -> Array:
        """Return the pose derivative times e, shape (N, P, B)."""
        change = self._take("change")
        np.einsum("kipb,kpb->ipb", self._slope, pose_error, out=change)
        change /= self._length
        return change
