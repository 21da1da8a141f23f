"""Static equilibrium of a platform on elastic legs, with its derivatives: what the stiffness models have in common.

The closure is f = Q W in mm, W = s P_E - Σ [F; M + a x F] the wrench that is not balanced (RR-8096 eq. 33), where
a = R b* and the legs' loads are those of s times their stiffness,

    F = k_a e z + (k_n + k_f) / l · z x (φ - 2 ψ),    M = k_n φ + (k_t - k_n) (φ · z) z - (k_n + k_f) ψ.

How e, z and ψ follow from a leg's vectors is the model's. Derivatives have the axis of what is varied before that of
what varies: a leg's loads by its vector are (..., N, 3, 6).

A chain flexure, leg, flexure of round beams (RR-8096 section 5), straight and loaded only at its ends, is described by
four numbers, `ChainStiffness`, for whole batches of machines: what the condensed 12 x 12 matrix (eqs. 20 to 27) says of
the joints' centres, in closed form.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.machines.deformations import DeformationBasis
from bayescal.machines.models.base import Linearisation
from bayescal.machines.models.home import Home, compute_turn, solve_home
from bayescal.machines.models.legs import LegVectors, compute_leg_vectors, cross, dot, scatter_rows
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array, compute_left_inverse_jacobian, skew_matrix

SYMBOLS = ("k1_d", "k2_d", "k3_d", "k1_l", "k2_l", "k3_l", "l", "l_b")
COMPLEX_STEP = 1e-30


@dataclass(frozen=True, eq=False)
class ChainStiffness:
    """A chain of round beams between the centres of its two flexures, l apart."""

    axial: Array  # force per elongation, N/mm; moment per twist, N mm
    torsional: Array
    near: Array  # bending: moment at a centre per rotation there and at the other one, relative to the chord, N mm
    far: Array

    def times(self, factor: Array) -> ChainStiffness:
        """Return the chain with all stiffness multiplied."""
        return ChainStiffness(*(part * factor for part in vars(self).values()))


@dataclass(frozen=True)
class AxialReference:
    """A chain's axial compliance, by which that of others is measured."""

    flexures: float  # length of both flexures together and of the leg between them, mm
    leg: float
    k2_d: float  # their axial stiffness, N
    k2_l: float

    def scale(self, k2_d: Array, k2_l: Array) -> Array:
        """Return s, the reference's axial stiffness over that of a chain as long with other k2."""
        compliance = self.flexures / self.k2_d + self.leg / self.k2_l
        return (self.flexures / k2_d + self.leg / k2_l) / compliance

    def slopes(self, k2_d: Array, k2_l: Array) -> dict[str, Array]:
        """Return d log s by symbol."""
        compliance = self.flexures / k2_d + self.leg / k2_l
        return {"k2_d": -self.flexures / k2_d**2 / compliance, "k2_l": -self.leg / k2_l**2 / compliance}


def compute_chain_stiffness(
    k1_d: Array, k2_d: Array, k3_d: Array, k1_l: Array, k2_l: Array, k3_l: Array, length: Array, l_b: Array
) -> ChainStiffness:
    """Return the condensed chain: flexures of length l_b with centres ``length`` apart, a leg between.

    Axially and in torsion the beams' compliances add. In bending the rotations at the centres follow from the
    moment, which is linear along the chain, by integrals of its shape functions over both flexures and the leg.
    """
    half, rest = 0.5 * l_b, length - l_b
    share = half / length
    overhang = 2 / 3 * half * share * share
    near_leg = rest / 3 * (1.0 - share * (1.0 - share))
    direct = (l_b + 2 * overhang) / k1_d + near_leg / k1_l
    cross = 2 * overhang / k1_d - (0.5 * rest - near_leg) / k1_l
    determinant = (direct - cross) * (direct + cross)
    return ChainStiffness(
        axial=1.0 / (2 * l_b / k2_d + rest / k2_l),
        torsional=1.0 / (2 * l_b / k3_d + rest / k3_l),
        near=direct / determinant,
        far=-cross / determinant,
    )


def differentiate_chain(values: Sequence[Array]) -> Array:
    """Return the derivatives of axial, torsional, near and far stiffness by each of `SYMBOLS`, shape (8, 4, ...).

    By complex steps: exact to rounding.
    """
    known = np.stack(np.broadcast_arrays(*values))
    steps = COMPLEX_STEP * np.abs(known)
    moved = np.repeat(known[:, None].astype(complex), len(SYMBOLS), axis=1)  # what, by what
    np.einsum("kk...->k...", moved).imag += steps
    chain = compute_chain_stiffness(*moved)
    return np.asarray(np.imag(np.stack(list(vars(chain).values()), axis=1)) / steps[:, None])


N_GLOBAL = 6  # of `SYMBOLS`: those of the machine, not of a leg
NEAR, FAR = 2, 3  # of what a `ChainStiffness` has

type Changes = tuple[Array, Array, Array]
"""Derivatives of e (..., N, m), z and ψ (..., N, m, 3) by m numbers of each leg."""


@dataclass(frozen=True, eq=False)
class LegState(ABC):
    """What a leg's chain feels, with its derivatives."""

    # as the legs stand and at the home pose
    legs: LegVectors
    home: LegVectors
    length: Array  # (..., N): l, mm

    @property
    @abstractmethod
    def elongation(self) -> Array:
        """Elongation e, shape (..., N), mm; it falls by as much as l grows."""

    @property
    @abstractmethod
    def axis(self) -> Array:
        """Direction z along which F is taken, shape (..., N, 3)."""

    @property
    @abstractmethod
    def turn(self) -> Array:
        """The chord's turn ψ in radians, shape (..., N, 3)."""

    @abstractmethod
    def by_vector(self) -> Changes:
        """Return the derivatives by g."""

    @abstractmethod
    def by_home(self) -> Changes:
        """Return the derivatives by g⁰."""

    @abstractmethod
    def turn_by_length(self) -> Array:
        """Return dψ/dl, shape (..., N, 3)."""

    def changes(self) -> Changes:
        """Return the derivatives by g, by g⁰ and by l, one after another: m = 7."""
        turn_by_length = self.turn_by_length()[..., None, :]
        by_length = (-np.ones_like(turn_by_length[..., 0]), np.zeros_like(turn_by_length), turn_by_length)
        parts = zip(self.by_vector(), self.by_home(), by_length, strict=True)
        elongation, axis, turn = (np.concatenate(part, axis=self.axis.ndim - 1) for part in parts)
        return elongation, axis, turn


@dataclass(frozen=True, eq=False)
class LegLoads:
    """The legs' loads on the platform's origin and their derivatives."""

    chain: ChainStiffness  # shapes (..., N)
    state: LegState
    phi: Array  # (..., 1, 3): φ in radians

    @cached_property
    def _lean(self) -> Array:
        return self.phi - 2.0 * self.state.turn

    @cached_property
    def _across(self) -> Array:
        return cross(self.state.axis, self._lean)

    @cached_property
    def _twist(self) -> Array:
        """Component of φ along the leg, shape (..., N, 1)."""
        return dot(self.phi, self.state.axis)[..., None]

    @cached_property
    def _bending(self) -> Array:
        """k_n + k_f, shape (..., N, 1)."""
        return (self.chain.near + self.chain.far)[..., None]

    @cached_property
    def _slim(self) -> Array:
        return self._bending / self.state.length[..., None]

    @cached_property
    def force(self) -> Array:
        """F, shape (..., N, 3), N."""
        return (self.chain.axial * self.state.elongation)[..., None] * self.state.axis + self._slim * self._across

    def wrench(self) -> Array:
        """Return F and M + a x F, shape (..., N, 6), N and N mm."""
        moment = self.chain.near[..., None] * self.phi - self._bending * self.state.turn
        moment = moment + (self.chain.torsional - self.chain.near)[..., None] * self._twist * self.state.axis
        return self._at_origin(self.force, moment)

    def by_chain(self) -> Array:
        """Return the wrench's derivative by k_a, k_t, k_n, k_f and (k_n + k_f) / l, shape (..., N, 5, 6)."""
        state, axis = self.state, self.state.axis
        force, moment = np.zeros((2, *axis.shape[:-1], 5, 3))
        force[..., 0, :] = state.elongation[..., None] * axis
        moment[..., 1, :] = self._twist * axis
        moment[..., 2, :] = self.phi - moment[..., 1, :] - state.turn
        moment[..., 3, :] = -state.turn
        force[..., 4, :] = self._across
        return self._at_origin(force, moment, 1)

    def by_state(self, changes: Changes) -> Array:
        """Return the wrench's derivative through e, z and ψ, shape (..., N, m, 6)."""
        by_elongation, by_axis, by_turn = changes
        chain, axis, phi = self.chain, self.state.axis[..., None, :], self.phi[..., None, :]
        stretch = by_elongation[..., None] * axis + self.state.elongation[..., None, None] * by_axis
        lean = cross(by_axis, self._lean[..., None, :]) - 2.0 * cross(axis, by_turn)
        force = chain.axial[..., None, None] * stretch + self._slim[..., None] * lean
        twist = self._twist[..., None] * by_axis + dot(by_axis, phi)[..., None] * axis
        moment = (chain.torsional - chain.near)[..., None, None] * twist - self._bending[..., None] * by_turn
        return self._at_origin(force, moment, 1)

    def by_phi(self) -> Array:
        """Return the wrench's derivative by φ, shape (..., N, 3, 6)."""
        chain, axis = self.chain, self.state.axis
        along = (chain.torsional - chain.near)[..., None] * axis
        moment = chain.near[..., None, None] * np.eye(3) + along[..., :, None] * axis[..., None, :]
        return self._at_origin(skew_matrix(-self._slim * axis), moment, 1)

    def _at_origin(self, force: Array, moment: Array, n_axes: int = 0) -> Array:
        """Return loads at the joints, with axes between those of the legs and the last, as wrenches at the origin."""
        arm = self.state.legs.arm
        arm = arm.reshape(*arm.shape[:-1], *(1,) * n_axes, 3)
        return np.concatenate([force, moment + cross(arm, force)], axis=-1)


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """The closure of given machines."""

    layout: ParameterLayout
    theta: Array  # (..., D)
    to_elongation: Array  # (6, 6): Q
    reference: AxialReference
    state: type[LegState]
    # from rotations (..., 3, 3) to P_E, shape (..., 6), in N and N mm, and its derivative by them, (..., 3, 6)
    load: Callable[[Array], tuple[Array, Array]]

    @cached_property
    def _home(self) -> Home:
        return solve_home(self.layout, self.theta)

    @cached_property
    def _values(self) -> dict[str, Array]:
        return {symbol: self.layout.take(self.theta, symbol) for symbol in SYMBOLS}

    @cached_property
    def _scale(self) -> Array:
        """Factor s, shape (..., 1)."""
        return self.reference.scale(self._values["k2_d"], self._values["k2_l"])

    @cached_property
    def _scale_slopes(self) -> dict[str, Array]:
        return self.reference.slopes(self._values["k2_d"], self._values["k2_l"])

    @cached_property
    def _chain(self) -> ChainStiffness:
        """Stiffness of the chains times s, shapes (..., N)."""
        return compute_chain_stiffness(*self._values.values()).times(self._scale)

    @cached_property
    def _chain_slopes(self) -> Array:
        """Derivatives of k_a, k_t, k_n, k_f and (k_n + k_f) / l, all times s, by `SYMBOLS`, shape (..., N, 8, 5)."""
        length, whole = self._values["l"], np.stack(np.broadcast_arrays(*vars(self._chain).values()))
        slopes = np.empty((len(SYMBOLS), len(whole) + 1, *whole.shape[1:]))
        own, slim = slopes[:, :-1], slopes[:, -1]
        np.multiply(differentiate_chain(list(self._values.values())), self._scale, out=own)
        for symbol, slope in self._scale_slopes.items():
            own[SYMBOLS.index(symbol)] += slope * whole
        np.add(own[:, NEAR], own[:, FAR], out=slim)
        slim[SYMBOLS.index("l")] -= (whole[NEAR] + whole[FAR]) / length
        slim /= length
        return np.moveaxis(slopes, (0, 1), (-2, -1))

    def __call__(
        self, position: Array, rotation: Array, basis: DeformationBasis, with_parameters: bool = True
    ) -> Linearisation:
        """Return Q W and its exact derivatives; see `Closure` for shapes and frames."""
        loads, phi, external, by_rotation = self._load(position, rotation, basis)
        state, legs, to_rows = loads.state, loads.state.legs, self.to_elongation.T
        residual = (external - loads.wrench().sum(axis=-2)) @ to_rows
        rows = _take_to_rows(loads.by_state(state.changes() if with_parameters else state.by_vector()), -to_rows)
        by_vector = _covectors(rows[..., :3, :])
        by_arm = skew_matrix(loads.force)  # the derivative of a x F by a
        by_joint = by_vector - _covectors(_take_to_rows(by_arm, to_rows[3:]))  # the upper joint moves g and a
        by_phi = np.swapaxes(_take_to_rows(np.einsum("...nkm->...km", loads.by_phi()), -to_rows), -1, -2)
        left = compute_left_inverse_jacobian(phi)
        by_turn = _sum_moments(legs.arm, by_joint) + by_phi @ left
        by_turn = by_turn + np.swapaxes(_take_to_rows(by_rotation, to_rows), -1, -2)
        pose = np.concatenate([np.einsum("...nk->...k", by_vector), by_turn], axis=-1)
        actuators = dot(by_joint, legs.platform_z[..., None, :, :]) @ basis.actuator_gain
        actuators = actuators - dot(by_vector, legs.direction[..., None, :, :])
        if not with_parameters:
            return Linearisation(residual, pose, actuators)
        by_home, home = _covectors(rows[..., 3:6, :]), self._home
        parameters = scatter_rows(
            self.layout,
            legs.with_rows().columns(by_vector, by_joint),
            home.legs.with_rows().columns(by_home, by_home),
            self._stiffness_columns(loads, external, rows[..., 6, :]),
        )
        by_turn = _sum_moments(home.legs.arm, by_home) - by_phi @ np.swapaxes(left, -1, -2)
        parameters += np.concatenate([np.einsum("...nk->...k", by_home), by_turn], axis=-1) @ home.slope
        return Linearisation(residual, pose, actuators, parameters)

    def close(self, position: Array, rotation: Array, basis: DeformationBasis) -> Array:
        """Return Q W alone."""
        loads, _, external, _ = self._load(position, rotation, basis)
        return np.asarray((external - loads.wrench().sum(axis=-2)) @ self.to_elongation.T)

    def _load(self, position: Array, rotation: Array, basis: DeformationBasis) -> tuple[LegLoads, Array, Array, Array]:
        """Return the legs' loads, φ (..., 3), and s P_E (..., 6) with its derivative by rotations (..., 3, 6)."""
        legs = compute_leg_vectors(self.layout, self.theta, position, rotation, basis)
        phi = compute_turn(rotation, self._home.rotation)
        external, by_rotation = self.load(rotation)
        loads = LegLoads(self._chain, self.state(legs, self._home.legs, self._values["l"]), phi[..., None, :])
        return loads, phi, self._scale * external, self._scale[..., None] * by_rotation

    def _stiffness_columns(self, loads: LegLoads, external: Array, by_length: Array) -> dict[str, Array]:
        """Return the derivatives by the chain's parameters, (..., 6, N) per leg or (..., 6, 1) for the machine.

        ``by_length`` are the rows' derivatives by l through the legs' state, shape (..., N, 6).
        """
        to_rows = self.to_elongation.T
        rows = self._chain_slopes @ _take_to_rows(loads.by_chain(), -to_rows)
        rows[..., SYMBOLS.index("l"), :] += by_length
        columns = dict(zip(SYMBOLS, np.moveaxis(rows, (-2, -1), (0, -2)), strict=True))
        of_machine = np.einsum("...nkr->k...r", rows[..., :N_GLOBAL, :])[..., None]
        columns |= zip(SYMBOLS[:N_GLOBAL], of_machine, strict=True)
        for symbol, slope in self._scale_slopes.items():
            columns[symbol] = columns[symbol] + (slope * external @ to_rows)[..., None]
        return columns


def _take_to_rows(wrenches: Array, to_rows: Array) -> Array:
    """Return wrenches (..., k) times Qᵀ, shape (k, 6): one product for all, where NumPy would make one of each leg."""
    flat = wrenches.reshape(-1, wrenches.shape[-1]) @ to_rows
    return np.asarray(flat.reshape(*wrenches.shape[:-1], to_rows.shape[-1]))


def _sum_moments(arm: Array, covector: Array) -> Array:
    """Return the sum over legs of a x w for arms (..., N, 3) and covectors (..., 6, N, 3), shape (..., 6, 3)."""
    shape = covector.shape
    across = skew_matrix(-arm).reshape(*arm.shape[:-2], -1, 3)  # w to a x w, from the left
    return np.asarray(covector.reshape(*shape[:-2], -1) @ across)


def _covectors(derivative: Array) -> Array:
    """Return derivatives (..., N, 3, 6) as covectors of the six rows, (..., 6, N, 3)."""
    return np.moveaxis(derivative, -1, -3)
