"""The stiffness model: the platform stands where the legs' forces on it balance (RR-8096 section 5).

Each leg is a chain flexure, leg, flexure of beams that is free of stress at the home pose and clamped to actuator and
platform. With the elongation e, the chord's turn ψ since home and the platform's turn φ = Log(R R^0ᵀ), the platform has
to pull with F and M of `equilibrium` at the leg's upper joint centre b*: eqs. (20) to (29) with the chain's stiffness
there, moved from the chain's end nodes to the joint centres. Equilibrium is eq. (33).

The report keeps the legs' directions of the home pose in F and M (eq. 28); then the model is linear and misses how a
leg that leans shortens, some 30 µm at the ends of the telescope's workspace. `Stiffness` takes the directions as they
are, e = |g| - l and z = g / |g|, and with soft flexures becomes the 6-PUS; `FixedStiffness` is the report's.

The closure is f = s Q W in mm, with Q fixed at the nominal home and s the nominal over the actual axial stiffness of a
nominal leg, so that f is the elongation that would restore equilibrium, whatever the legs are made of. Six equations
for six actuators: the model takes six legs.

Batches of machines have the loads of all legs in sums of few products. With z the direction of a leg, a its lever arm R
b*, k_s = (k_n + k_f) / l and c = z · z^0, these loads are, as z x ψ = z^0 - c z,

    F = (k_a e + 2 k_s c) z + k_s z x φ - 2 k_s z^0,
    M + a x F = (k_a e + 2 k_s c) a x z + ((k_t - k_n) z · φ + k_s a · φ) z + (k_n - k_s a · z) φ
                + k_s z^0 x (2 a - l z).
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.deformations import DeformationBasis
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models.base import BoundClosure, Closure
from bayescal.machines.models.beam import require_flexures
from bayescal.machines.models.equilibrium import (
    SYMBOLS,
    AxialReference,
    ChainStiffness,
    Changes,
    Equilibrium,
    LegState,
    compute_chain_stiffness,
)
from bayescal.machines.models.home import BatchHome, BatchTurns, HomeModel, home_solver, solve_home
from bayescal.machines.models.legs import LegVectors, cross, cross_first_axis, dot
from bayescal.machines.models.six_pus import SixPus, SixPusClosure
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, skew_matrix


class EquilibriumClosure(SixPusClosure):
    """Q W for batches; its pose derivative is that of elastic axial loads alone."""

    def __init__(
        self,
        layout: ParameterLayout,
        position: Array,
        rotation: Array,
        basis: DeformationBasis,
        to_elongation: Array,
        reference: AxialReference,
        external: Array,
    ) -> None:
        super().__init__(layout, position, rotation, basis)
        self._homes, self._turns = home_solver(layout), BatchTurns(rotation)
        self._to_elongation, self._reference = to_elongation, reference
        self._external = external.T[..., None] if external.any() else None

    def evaluate(self, theta: Array) -> Array:
        """Return f, shape (N, P, B)."""
        arm = self._measure(theta)
        parameters = np.ascontiguousarray(theta.T)
        values = {symbol: parameters[self._layout.index[symbol]] for symbol in SYMBOLS}
        length, scale = values["l"], self._reference.scale(values["k2_d"], values["k2_l"])
        chain = compute_chain_stiffness(*values.values()).times(scale)
        home = self._homes.solve(theta)
        phi = self._turns.evaluate(home.rotation)
        balance = self._scratch.take("balance", 6, *phi.shape[1:])
        self._axial = self._balance_loads(balance, arm, chain, length, home, phi)
        if self._external is not None:
            balance += self._external * scale
        return self._elongate(balance, "closure")

    @abstractmethod
    def _balance_loads(
        self, balance: Array, arm: Array, chain: ChainStiffness, length: Array, home: BatchHome, phi: Array
    ) -> Array:
        """Find minus the sum of all legs' loads (6, P, B); return -k_a per square of the slope, (N, P or 1, B).

        Stiffnesses and lengths have the shape (N, B), φ has (3, P, B); lever arms (3, N, P, B) may be overwritten.
        """

    def _elongate(self, wrench: Array, name: str) -> Array:
        """Return Q times wrenches (6, P, B), shape (N, P, B)."""
        result = self._take(name)
        np.matmul(self._to_elongation, wrench.reshape(len(wrench), -1), out=result.reshape(len(result), -1))
        return result

    def along(self, pose_error: Array) -> Array:
        """Return the pose derivative of the axial loads times e, shape (N, P, B)."""
        load = np.einsum("kipb,kpb->ipb", self._slope, pose_error, out=self._take("scale"))
        load *= self._axial
        wrench = self._scratch.take("wrench", *pose_error.shape)
        np.einsum("kipb,ipb->kpb", self._slope, load, out=wrench)
        return self._elongate(wrench, "work")


class StiffnessClosure(EquilibriumClosure):
    """Loads along the legs as they stand; the slope holds -g = -|g| z and -a x g."""

    def _balance_loads(
        self, balance: Array, arm: Array, chain: ChainStiffness, length: Array, home: BatchHome, phi: Array
    ) -> Array:
        vector, slim = self._slope[:3], (chain.near + chain.far) / length
        across = home.vector * (2.0 * slim / home.length)  # 2 k_s z^0
        inverse = np.reciprocal(self._length, out=self._length)  # lengths are not needed any more
        scale, work = self._take("scale"), self._take("work")
        # along z: (k_a e + 2 k_s c) / |g| = k_a - (k_a l + 2 k_s z^0 · (-g) / |g|) / |g|
        np.einsum("kipb,kib->ipb", vector, across, out=scale)
        scale *= inverse
        scale += (chain.axial * length)[:, None]
        scale *= inverse
        np.subtract(chain.axial[:, None], scale, out=scale)
        np.einsum("kipb,ipb->kpb", self._slope, scale, out=balance)
        # along z once more: its moment by the platform's turn
        np.einsum("kipb,kpb->ipb", vector, phi, out=scale)
        scale *= inverse
        scale *= (chain.torsional - chain.near)[:, None]
        np.einsum("kipb,kpb->ipb", arm, phi, out=work)
        work *= slim[:, None]
        scale -= work
        scale *= inverse
        balance[3:] -= np.einsum("kipb,ipb->kpb", vector, scale)
        # along φ and across it
        np.multiply(inverse, slim[:, None], out=scale)
        balance[:3] += cross_first_axis(np.einsum("kipb,ipb->kpb", vector, scale), phi)
        np.einsum("kipb,kipb->ipb", arm, vector, out=work)
        balance[3:] -= phi * (np.einsum("ipb,ipb->pb", work, scale) + chain.near.sum(axis=0))
        # along z^0 and across it
        balance[:3] += across.sum(axis=1)[:, None]
        np.multiply(inverse, (0.5 * length)[:, None], out=work)
        for k in range(3):
            arm[k] += np.multiply(vector[k], work, out=scale)
        _subtract_moments(balance[3:], across, arm)
        inverse *= inverse
        inverse *= -chain.axial[:, None]
        return inverse


class FixedStiffnessClosure(EquilibriumClosure):
    """Loads along the legs' directions at home, where ψ = z^0 x g / l and e = z^0 · g - l.

    Then F = (k_a e - 2 k_s z^0 · g / l) z^0 + k_s z^0 x φ + 2 k_s g / l. The slope is left with -z^0 and -a x z^0.
    """

    def _balance_loads(
        self, balance: Array, arm: Array, chain: ChainStiffness, length: Array, home: BatchHome, phi: Array
    ) -> Array:
        vector, slim = self._slope[:3], (chain.near + chain.far) / length
        start, lean = home.vector / home.length, 2.0 * slim / length
        scale, force, moment = self._take("scale"), self._take("force", 3), self._slope[3:]
        np.einsum("kipb,kib->ipb", vector, start, out=scale)
        scale *= (lean - chain.axial)[:, None]
        scale -= (chain.axial * length)[:, None]
        np.multiply(vector, -lean[:, None], out=force)
        force += scale * start[:, :, None]
        force += cross_first_axis((slim * start)[:, :, None], phi[:, None])
        np.negative(force.sum(axis=1), out=balance[:3])
        np.negative(cross_first_axis(arm, force, out=moment).sum(axis=1), out=balance[3:])
        balance[3:] -= phi * chain.near.sum(axis=0)
        twist = np.einsum("ib,jib,kib->jkb", chain.torsional - chain.near, start, start)
        balance[3:] -= np.einsum("jkb,kpb->jpb", twist, phi)
        _subtract_moments(balance[3:], slim * start, vector)
        vector[:] = -start[:, :, None]
        cross_first_axis(arm, vector, out=moment)
        return -chain.axial[:, None]


def _subtract_moments(balance: Array, force: Array, arm: Array) -> None:
    """Subtract the sum over legs of w x a from (3, P, B), for covectors w (3, N, B) and arms a (3, N, P, B)."""
    for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
        balance[k] -= np.einsum("ib,ipb->pb", force[m], arm[n])
        balance[k] += np.einsum("ib,ipb->pb", force[n], arm[m])


METRE = 1e-3  # m per mm: in the report's sum of squares moments count in N m


@dataclass(frozen=True, eq=False)
class StandingLegs(LegState):
    """Elongation, direction and turn of the legs as they stand."""

    @cached_property
    def elongation(self) -> Array:
        """|g| - l."""
        return self.legs.length - self.length

    @property
    def axis(self) -> Array:
        """The leg's direction."""
        return self.legs.axis

    @cached_property
    def turn(self) -> Array:
        """z^0 x z."""
        return cross(self.home.axis, self.axis)

    def by_vector(self) -> Changes:
        """Return the derivatives by g."""
        by_axis = _differentiate_direction(self.legs)
        return self.axis, by_axis, cross(self.home.axis[..., None, :], by_axis)

    def by_home(self) -> Changes:
        """Return the derivatives by g⁰."""
        by_turn = cross(_differentiate_direction(self.home), self.axis[..., None, :])
        return np.zeros_like(self.axis), np.zeros_like(by_turn), by_turn

    def turn_by_length(self) -> Array:
        """Return zeros."""
        return np.zeros_like(self.axis)


@dataclass(frozen=True, eq=False)
class HomeLegs(LegState):
    """Elongation and turn along and across the legs' directions at home."""

    @cached_property
    def _moved(self) -> Array:
        return self.legs.vector - self.home.vector

    @cached_property
    def elongation(self) -> Array:
        """z^0 · (g - g⁰) + |g⁰| - l."""
        return dot(self.axis, self._moved) + self.home.length - self.length

    @cached_property
    def axis(self) -> Array:
        """The leg's direction at home."""
        return np.broadcast_to(self.home.axis, self.legs.axis.shape)

    @cached_property
    def turn(self) -> Array:
        """z^0 x (g - g⁰) / l."""
        return cross(self.axis, self._moved) / self.length[..., None]

    def by_vector(self) -> Changes:
        """Return the derivatives by g."""
        by_turn = skew_matrix(-self.axis) / self.length[..., None, None]
        return self.axis, np.zeros_like(by_turn), by_turn

    def by_home(self) -> Changes:
        """Return the derivatives by g⁰."""
        by_axis = np.broadcast_to(_differentiate_direction(self.home), (*self.axis.shape, 3))
        by_turn = cross(by_axis, self._moved[..., None, :]) + skew_matrix(self.axis)
        return (by_axis @ self._moved[..., None])[..., 0], by_axis, by_turn / self.length[..., None, None]

    def turn_by_length(self) -> Array:
        """Return -ψ / l."""
        return -self.turn / self.length[..., None]


@dataclass(frozen=True, eq=False)
class Stiffness(HomeModel):
    """Static equilibrium on legs that are chains of beams, taken along the legs as they stand."""

    mechanism: Mechanism
    name: ClassVar[str] = "stiffness"
    title: ClassVar[str] = "stiffness"
    state: ClassVar[type[LegState]] = StandingLegs
    closure: ClassVar[type[EquilibriumClosure]] = StiffnessClosure

    @classmethod
    def from_mechanism(cls, mechanism: Mechanism) -> Self:
        """Return the model of a mechanism with six legs and flexures of known stiffness."""
        flexures = require_flexures(mechanism, cls.name)
        if flexures.section is None or flexures.leg_section is None:
            raise InputError(f"mechanism {mechanism.name!r}: found no [stiffness], expected it for {cls.name}")
        if mechanism.n_legs != DEGREES_OF_FREEDOM:
            raise InputError(
                f"mechanism {mechanism.name!r}: found {mechanism.n_legs} legs, expected {DEGREES_OF_FREEDOM} "
                f"for the {cls.name} model"
            )
        return cls(mechanism)

    def blocks(self, mechanism: Mechanism) -> tuple[ParameterBlock, ...]:
        """Return the parameters of the 6-PUS, l_b of each leg and the six stiffness parameters of all."""
        flexures = require_flexures(mechanism, self.name)
        sections = {"d": flexures.section, "l": flexures.leg_section}
        return (
            *SixPus().blocks(mechanism),
            ParameterBlock("l_b", tuple(flexures.lengths.tolist()), lower=0.0),
            *(
                ParameterBlock(f"{k}_{part}", (getattr(section, k),), _unit(k), per_leg=False, lower=0.0)
                for part, section in sections.items()
                for k in ("k1", "k2", "k3")
            ),
        )

    @cached_property
    def to_elongation(self) -> Array:
        """Q, shape (6, 6): mm of elongation that restore the equilibrium of a wrench in N and N mm."""
        layout = self.mechanism.lay_out(self.blocks(self.mechanism))
        home = solve_home(layout, layout.nominal)
        spread = np.concatenate([home.legs.axis, cross(home.legs.arm, home.legs.axis)], axis=-1)
        axial = compute_chain_stiffness(*(layout.take(layout.nominal, symbol) for symbol in SYMBOLS)).axial
        return np.asarray(np.linalg.inv(spread.T) / axial[:, None])

    def objective(self, mechanism: Mechanism) -> Array:
        """Return f to wrench: eq. (33) is minimised in newtons and newton metres."""
        del mechanism
        return np.diag([1.0, 1.0, 1.0, METRE, METRE, METRE]) @ np.linalg.inv(self.to_elongation)

    @cached_property
    def _reference(self) -> AxialReference:
        flexures = require_flexures(self.mechanism, self.name)
        assert flexures.section is not None
        assert flexures.leg_section is not None
        length, l_b = self.mechanism.leg_lengths[0], flexures.lengths[0]
        return AxialReference(2 * l_b, length - l_b, flexures.section.k2, flexures.leg_section.k2)

    def prepare(self, layout: ParameterLayout, theta: Array) -> Closure:
        """Return s Q W, with the machines' home poses found."""
        return Equilibrium(layout, theta, self.to_elongation, self._reference, self.state, self._external)

    def close(self, closure: Closure, position: Array, rotation: Array, basis: DeformationBasis) -> Array:
        """Return s Q W alone; see `KinematicModel.close`."""
        assert isinstance(closure, Equilibrium)
        return closure.close(position, rotation, basis)

    def _external(self, rotation: Array) -> tuple[Array, Array]:
        """Return P_E, shape (..., 6), in N and N mm, and its derivative (..., 3, 6) by the rotation."""
        load = self.mechanism.load
        force, moment, weight = (np.array(part) for part in (load.force, load.moment, load.weight))
        external, by_rotation = np.empty((*rotation.shape[:-2], 6)), np.zeros((*rotation.shape[:-1], 6))
        external[..., :3], external[..., 3:] = force + weight, moment
        if weight.any():
            lever = rotation @ np.array(load.centre_of_mass)
            external[..., 3:] += cross(lever, weight)
            by_rotation[..., 3:] = cross(skew_matrix(lever), weight)
        return external, by_rotation

    def bind(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> BoundClosure:
        """Return the closure for batches."""
        equilibrium = (self.to_elongation, self._reference, self._external(rotation)[0])
        return self.closure(layout, position, rotation, basis, *equilibrium)


class FixedStiffness(Stiffness):
    """The report's own: K of every leg stays as it is at the home pose (eq. 28)."""

    name: ClassVar[str] = "stiffness_fixed"
    title: ClassVar[str] = "stiffness (fixed)"
    state: ClassVar[type[LegState]] = HomeLegs
    closure: ClassVar[type[EquilibriumClosure]] = FixedStiffnessClosure


def _unit(symbol: str) -> str:
    return "N" if symbol == "k2" else "N mm2"


def _differentiate_direction(legs: LegVectors) -> Array:
    """Return dz/dg = (1 - z zᵀ) / |g|, shape (..., N, 3, 3)."""
    return (np.eye(3) - legs.axis[..., :, None] * legs.axis[..., None, :]) / legs.length[..., None, None]
