"""The Jacobian-based model: the machine's kinematics linearised once, at its home pose (RR-8096 section 4.2).

Eq. (9), ρ = ρ^0 + J_0⁻¹ (X - X^0) with J_0⁻¹ of eq. (8), leg by leg f = Δρ - (z · v - (l - |g⁰|)) / (u · z), where
v = p - p^0 + φ x R^0 b + Δb_z R^0 e_z is how the joint moved, φ = Log(R R^0ᵀ), and z, g⁰ and u belong to the home
pose. (Eq. (31) has the other sign before J_0⁻¹; the derivation and eq. (9) have this one.) A deflection of the platform
counts by its velocity along the leg, which for u along the platform's z is Δρ → (1 - κ) Δρ as in section 7.2. X^0
follows from ρ^0 and the geometry by forward kinematics of the 6-PUS; l - |g⁰| vanishes there for six legs and is the
closure of the redundant ones for more.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from bayescal.machines.deformations import DeformationBasis
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models.base import BoundClosure, Linearisation
from bayescal.machines.models.home import BatchTurns, Home, HomeModel, compute_turn, home_solver
from bayescal.machines.models.legs import cross, cross_first_axis, dot
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.numerics.geometry import Array, compute_left_inverse_jacobian
from bayescal.numerics.scratch import Scratch


class Jacobian(HomeModel):
    """Kinematics linear in pose and actuators."""

    name: ClassVar[str] = "jacobian"
    title: ClassVar[str] = "Jacobian"

    def blocks(self, mechanism: Mechanism) -> tuple[ParameterBlock, ...]:
        """Return the parameters of the 6-PUS."""
        return SixPus().blocks(mechanism)

    def _close(
        self,
        layout: ParameterLayout,
        theta: Array,
        home: Home,
        position: Array,
        rotation: Array,
        basis: DeformationBasis,
        with_parameters: bool = True,
    ) -> Linearisation:
        """Return the closure and its exact derivatives; see `Closure` for shapes and frames.

        With g, U and T short for g⁰, u · g and g · v - |g| (l - |g|) it is f = Δρ - T / U.
        """
        legs, length = home.legs, layout.take(theta, "l")
        g, arm, z_axis = legs.vector, legs.arm, legs.platform_z
        phi = compute_turn(rotation, home.rotation)[..., None, :]
        deflection = basis.deflection(layout, theta)
        moved = (position - home.position)[..., None, :] + cross(phi, arm) + deflection[..., None] * z_axis
        size = dot(legs.direction, g)
        share = (dot(g, moved) - legs.length * (length - legs.length)) / size
        gain = dot(g, z_axis) / size
        left = compute_left_inverse_jacobian(phi[..., 0, :])
        moment = cross(arm, g)
        turn = moment @ left
        pose = -np.concatenate([np.broadcast_to(g, turn.shape), turn], axis=-1) / size[..., None]
        actuators = np.eye(size.shape[-1]) - gain[..., None] * basis.actuator_gain
        actuators = np.broadcast_to(actuators, np.broadcast_shapes(actuators.shape, (*share.shape, share.shape[-1])))
        residual = basis.displacement - share
        if not with_parameters:
            return Linearisation(residual, pose, actuators)
        # through g⁰, through the home pose, directly
        on_vector = -moved + (length - 2 * legs.length)[..., None] * legs.axis + share[..., None] * legs.direction
        across = cross(g, phi)
        on_turn = moment @ np.swapaxes(left, -1, -2)  # the right inverse is the transposed left one
        on_turn = on_turn - cross(arm, across) - deflection[..., None] * cross(z_axis, g)
        on_home = np.concatenate([np.broadcast_to(g, on_turn.shape), on_turn], axis=-1)
        local = across @ home.rotation
        columns = {f"b_{name}": -local[..., k] / size for k, name in enumerate("xyz")}
        columns |= {symbol: share / size * across for symbol, across in legs.pull_back_direction(g).items()}
        columns["l"] = legs.length / size
        columns |= {symbol: -gain * c for symbol, c in basis.coefficients.items()}
        parameters = home.pull_back(on_vector / size[..., None], on_home / size[..., None], columns)
        return Linearisation(residual, pose, actuators, parameters)

    def bind(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> BoundClosure:
        """Return the closure for batches: one home pose per machine, then products with the poses."""
        return JacobianClosure(layout, position, rotation, basis)


class JacobianClosure(BoundClosure):
    """f for batches, as two products of what the poses are and what the machines are.

    With the row w = g⁰ / (u · g⁰) of a leg, its moment m = R^0 b x w and its gain c = w · R^0 e_z,
    f = Δρ - w · (p - p^0) + |g⁰| (l - |g⁰|) / (u · g⁰) - c Δb_z - m · φ. All but the last term is linear in features
    (1, w · p^0 + …, w, c, c κ) of the machine. φ is |φ| / sin|φ| times half the sum of R^0_j x R_j over the columns j
    of the rotations, so that m · φ is linear in the nine entries of m x R^0_j but for that factor.
    """

    def __init__(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> None:
        self._layout, self._symbols = layout, tuple(basis.coefficients)
        one = np.ones_like(basis.displacement)
        parts = [basis.displacement, one, *(-one * position[:, k, None] for k in range(3)), -basis.constant]
        parts += [-part for part in basis.coefficients.values()]
        self._design = np.stack(parts, axis=-1).transpose(1, 0, 2).copy()
        self._turn_design = -0.5 * rotation.reshape(-1, 9)
        self._homes, self._turns = home_solver(layout), BatchTurns(rotation)
        self._scratch = Scratch()

    def evaluate(self, theta: Array) -> Array:
        """Return f, shape (N, P, B)."""
        home = self._homes.solve(theta)
        take, index = self._scratch.take, self._layout.index
        parameters = np.ascontiguousarray(theta.T)
        n_legs, n_poses, n_batch = len(self._design), len(self._turn_design), len(theta)
        size = np.einsum("kib,kib->ib", home.direction, home.vector)
        self._row = np.empty((6, n_legs, n_batch))
        row, moment = self._row[:3], self._row[3:]
        np.divide(home.vector, size, out=row)
        cross_first_axis(home.arm, row, out=moment)
        stretched = home.length * (parameters[index["l"]] - home.length) / size
        gain = np.einsum("kib,kb->ib", row, home.rotation[:, 2])
        features = [np.ones_like(size), np.einsum("kib,kb->ib", row, home.position) + stretched, *row, gain]
        features += [gain * parameters[index[symbol]] for symbol in self._symbols]
        result, turned = (take(name, n_legs, n_poses, n_batch) for name in ("result", "turned"))
        np.matmul(self._design, np.stack(features, axis=1), out=result)
        self._turns.evaluate(home.rotation)
        levers = cross_first_axis(moment[:, :, None], home.rotation[:, None]).swapaxes(0, 1).reshape(n_legs, 9, n_batch)
        np.matmul(self._turn_design, levers, out=turned)
        turned *= self._turns.stretch
        result += turned
        return result

    def along(self, pose_error: Array) -> Array:
        """Return the pose derivative times e, shape (N, P, B)."""
        moved = self._scratch.take("moved", *pose_error.shape)
        np.negative(pose_error[:3], out=moved[:3])
        np.negative(self._turns.turn_back(pose_error[3:]), out=moved[3:])
        change = self._scratch.take("change", self._row.shape[1], *pose_error.shape[1:])
        return np.einsum("kib,kpb->ipb", self._row, moved, out=change)
