"""The stiffness model: the platform stands where the legs' forces on it balance (RR-8096 section 5).

Each leg is a chain flexure, leg, flexure of beams that is free of stress at the home pose and clamped to actuator and
platform. With the elongation e, the chord's turn ψ since home and the platform's turn φ = Log(R R^0ᵀ), the platform has
to pull with

    F = k_a e z + (k_n + k_f) / l · z x (φ - 2 ψ),    M = k_n φ + (k_t - k_n) (φ · z) z - (k_n + k_f) ψ

at the leg's upper joint centre b*: eqs. (20) to (29) with the chain's stiffness of `beam_elements`, moved from the
chain's end nodes to the joint centres. Equilibrium is eq. (33), W = P_E - Σ [F; M + R b* x F] = 0.

The report keeps the legs' directions of the home pose in F and M (eq. 28); then the model is linear and misses how a
leg that leans shortens, some 30 µm at the ends of the telescope's workspace. `Stiffness` takes the directions as they
are, e = |g| - l and z = g / |g|, and with soft flexures becomes the 6-PUS; `FixedStiffness` is the report's.

The closure is f = s Q W in mm, with Q fixed at the nominal home and s the nominal over the actual axial stiffness of a
nominal leg, so that f is the elongation that would restore equilibrium, whatever the legs are made of. Six equations
for six actuators: the model takes six legs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.deformations.base import DeformationBasis
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models.base import BoundClosure, Closure, KinematicModel
from bayescal.machines.models.beam import require_flexures
from bayescal.machines.models.beam_elements import SYMBOLS, AxialReference, compute_chain_stiffness
from bayescal.machines.models.equilibrium import Changes, Equilibrium, LegState
from bayescal.machines.models.home import BatchHome, solve_home
from bayescal.machines.models.legs import LegVectors, cross, dot
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.models.stiffness_batch import FixedStiffnessClosure, StiffnessClosure
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, skew_matrix

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
class Stiffness(KinematicModel):
    """Static equilibrium on legs that are chains of beams, taken along the legs as they stand."""

    mechanism: Mechanism
    name: ClassVar[str] = "stiffness"
    title: ClassVar[str] = "stiffness"
    state: ClassVar[type[LegState]] = StandingLegs

    @classmethod
    def from_mechanism(cls, mechanism: Mechanism) -> Self:
        """Return the model of a mechanism with six legs and flexures of known stiffness."""
        flexures = require_flexures(mechanism, cls.name)
        if flexures.section is None or flexures.leg_section is None:
            raise InputError(
                f"mechanism {mechanism.name!r}: found no [stiffness], expected it for the {cls.name} model"
            )
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
        """Return s Q W; home poses and the stiffness of the legs are found once."""
        return self.prepare_known(layout, theta, None)

    def prepare_known(self, layout: ParameterLayout, theta: Array, home: BatchHome | None) -> Closure:
        """Return s Q W of machines whose home poses may be known."""
        return Equilibrium(layout, theta, self.to_elongation, self._reference, self.state, self._external, home)

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
        return StiffnessClosure(layout, position, rotation, basis, *equilibrium)


class FixedStiffness(Stiffness):
    """The report's own: K of every leg stays as it is at the home pose (eq. 28)."""

    name: ClassVar[str] = "stiffness_fixed"
    title: ClassVar[str] = "stiffness (fixed)"
    state: ClassVar[type[LegState]] = HomeLegs

    def bind(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> BoundClosure:
        """Return the closure for batches."""
        equilibrium = (self.to_elongation, self._reference, self._external(rotation)[0])
        return FixedStiffnessClosure(layout, position, rotation, basis, *equilibrium)


def _unit(symbol: str) -> str:
    return "N" if symbol == "k2" else "N mm2"


def _differentiate_direction(legs: LegVectors) -> Array:
    """Return dz/dg = (1 - z zᵀ) / |g|, shape (..., N, 3, 3)."""
    return (np.eye(3) - legs.axis[..., :, None] * legs.axis[..., None, :]) / legs.length[..., None, None]
