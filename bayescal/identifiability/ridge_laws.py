"""Ridges that theory knows: what stays the same of a leg when its parameters change without any pose telling.

A law is an invariant of one leg's parameters. On the ridge that it explains the invariant is constant; its level lines
are the ridge's curve, however far it goes. Whether a law explains a ridge that was found is decided by its slope alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from bayescal.identifiability.design import Knowledge
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.machines.mechanism import Drive
from bayescal.machines.models.legs import compute_leg_vectors
from bayescal.machines.parameters import DirectionChart, Rows
from bayescal.numerics.geometry import Array

STEP = 0.2  # tolerances, between the points of a curve
REACH = 3.5  # tolerances about its start that a curve goes at most
DIFFERENCE = 1e-5  # tolerances, for slopes
NEWTON = 5
ON_LINE = 1e-6  # tolerances
TELLING = 0.1  # of an invariant's slope by all of a leg's parameters, that two must have for their line to be its own
CLOSED = 0.5  # steps from its start at which a curve has come round

type Values = Mapping[str, float]
type Pair = tuple[str, str]

UPRIGHT = ("u_x", "u_y")
AXES_OF_THE_BASE: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Leg:
    """A leg at home.

    Attributes
    ----------
    base, platform : tuple of 3 floats
        Its direction z in the base frame, and the same in the platform's, zᵀR.
    symbols : tuple of str
        Of the components of its actuator's direction.
    frame : tuple, 3 x 3
        What they are components along, and the pole, base frame (see `machines.directions`).
    """

    base: tuple[float, float, float]
    platform: tuple[float, float, float]
    symbols: tuple[str, ...] = UPRIGHT
    frame: Rows = AXES_OF_THE_BASE


@dataclass(frozen=True)
class Law:
    """What stays the same of a leg.

    Attributes
    ----------
    drives : tuple of str
        Of mechanisms that it holds for.
    pairs : tuple of pairs of symbols
        Between which it is the curve, in any order.
    formula : str
        What is constant, with ``{z_x}``, ``{z_y}`` and ``{z_z}`` for the leg's direction.
    name : str
        What that is, in words.
    invariant : callable
        From the leg and its parameters by symbol; those that a model lacks are left out.
    """

    drives: tuple[Drive, ...]
    pairs: tuple[Pair, ...]
    formula: str
    name: str
    invariant: Callable[[Leg, Values], float]

    def holds_for(self, drive: Drive, pair: Pair) -> bool:
        """Return whether the law ties two symbols of a machine."""
        return drive in self.drives and any(set(pair) == set(own) for own in self.pairs)

    def say(self, leg: Leg) -> str:
        """Return the formula with the leg's numbers."""
        return self.formula.format(z_x=_say(leg.base[0]), z_y=_say(leg.base[1]), z_z=_say(leg.base[2]))


def _say(value: float) -> str:
    return f"{value:.3f}".replace("-", "\u2212")


# --- invariants --------------------------------------------------------------------------------------------------


def _direction(leg: Leg, values: Values) -> tuple[float, float, float]:
    """Return u in the base frame, zero for struts; NaN where its components leave the unit sphere."""
    if leg.symbols[0] not in values:
        return 0.0, 0.0, 0.0
    first, second = (values[symbol] for symbol in leg.symbols)
    rest = 1.0 - first * first - second * second
    parts = (first, second, math.sqrt(rest) if rest >= 0.0 else math.nan)
    if leg.frame == AXES_OF_THE_BASE:
        return parts
    x, y, z = (sum(part * axis[k] for part, axis in zip(parts, leg.frame, strict=True)) for k in range(3))
    return x, y, z


def _length(leg: Leg, values: Values) -> float:
    """Return l + z·(a + ρ^0 u) - z·R b: what is left of the leg's length once its joints are where they are."""
    total, rho0, u = values["l"], values.get("rho0", 0.0), _direction(leg, values)
    for k, axis in enumerate("xyz"):
        total += leg.base[k] * (values[f"a_{axis}"] + rho0 * u[k]) - leg.platform[k] * values[f"b_{axis}"]
    return total


def _gain(leg: Leg, values: Values) -> float:
    """Return z·u - z_z κ: how far the joints move together along the leg when the actuator moves."""
    u = _direction(leg, values)
    return sum(leg.base[k] * u[k] for k in range(3)) - leg.base[2] * values.get("kappa", 0.0)


def _joint(axis: int) -> Callable[[Leg, Values], float]:
    """Return the invariant c = a + ρ^0 u along an axis: where the lower joint stands at home."""

    def invariant(leg: Leg, values: Values) -> float:
        return values[f"a_{'xyz'[axis]}"] + values["rho0"] * _direction(leg, values)[axis]

    return invariant


_POINTS = tuple(f"{symbol}_{axis}" for symbol in "ab" for axis in "xyz")

LAWS: tuple[Law, ...] = (
    Law(
        ("base",),
        (("a_z", "l"), ("b_z", "l"), ("a_z", "b_z")),
        "λ a_z − λ b_z + l, λ = z·e_z = {z_z}",
        "the distance of the joints along the leg",  # RR-8096 eqs. (34) to (36)
        _length,
    ),
    Law(
        ("base",),
        (("kappa", "u_x"), ("kappa", "u_y")),
        "κ − u_z − (z_x/z_z) u_x − (z_y/z_z) u_y, z = ({z_x}, {z_y}, {z_z})",
        "the gain of the actuator along the leg",  # RR-8096 eqs. (38) to (40)
        _gain,
    ),
    Law(
        ("base",),
        (("u_x", "u_y"),),
        "z·u, what the actuator moves along the leg, z = ({z_x}, {z_y}, {z_z})",
        "the direction of the actuator against the leg",  # RR-8096 eq. (30), ρ u along the leg
        _gain,
    ),
    *(
        Law(
            ("base",),
            (("rho0", f"a_{axis}"), (f"u_{axis}", f"a_{axis}")) if axis != "z" else (("rho0", "a_z"),),
            f"a_{axis} + ρ0 u_{axis}, the lower joint at home",
            "the place of the joint at home",  # RR-8096 eq. (30), a + ρ u at ρ0
            _joint(k),
        )
        for k, axis in enumerate("xyz")
    ),
    Law(
        ("strut",),
        (*((point, "l") for point in _POINTS), *product(_POINTS[:3], _POINTS[3:])),
        "l + z·a − z·b, z = ({z_x}, {z_y}, {z_z})",
        "the length between the joints of the strut",  # Yu, Wu and Wang 2023 eqs. (1) and (3)
        _length,
    ),
)


def list_laws(machine: Machine) -> tuple[Law, ...]:
    """Return the laws of a machine's legs.

    The published ones are those of actuators told by u_x and u_y, which lean little. Where an actuator leans far or
    is level, a shift of either joint along any axis may be taken up by the leg's length.
    """
    chart = machine.layout.directions
    if chart is None or chart.upright:
        return tuple(law for law in LAWS if machine.mechanism.drive in law.drives)
    return _laws_of_any_direction(chart)


def _laws_of_any_direction(chart: DirectionChart) -> tuple[Law, ...]:
    first, second = chart.symbols
    frames = np.array(chart.frames)
    moved = {  # the axes along which some joint moves with a component
        symbol: np.flatnonzero(np.abs(frames[:, k]).max(axis=0) > 0.0) for k, symbol in enumerate(chart.symbols)
    }
    return (
        Law(
            ("base",),
            (*((point, "l") for point in _POINTS), *product(_POINTS[:3], _POINTS[3:])),
            "l + z·(a + ρ0 u) − z·b, z = ({z_x}, {z_y}, {z_z})",
            "the distance of the joints along the leg",
            _length,
        ),
        Law(
            ("base",),
            (("kappa", first), ("kappa", second)),
            "z·u − z_z κ, z = ({z_x}, {z_y}, {z_z})",
            "the gain of the actuator along the leg",
            _gain,
        ),
        Law(
            ("base",),
            ((first, second),),
            "z·u, what the actuator moves along the leg, z = ({z_x}, {z_y}, {z_z})",
            "the direction of the actuator against the leg",
            _gain,
        ),
        *(
            Law(
                ("base",),
                (("rho0", f"a_{axis}"), *((symbol, f"a_{axis}") for symbol, axes in moved.items() if k in axes)),
                f"a_{axis} + ρ0 u_{axis}, the lower joint at home",
                "the place of the joint at home",
                _joint(k),
            )
            for k, axis in enumerate("xyz")
        ),
    )


def find_legs(knowledge: Knowledge) -> list[Leg]:
    """Return the legs at the home pose of the expected machine."""
    machine = knowledge.machine
    theta = knowledge.machine_centre
    actuators = machine.mechanism.initial_actuator_positions
    home = solve_forward_kinematics(machine, theta, actuators)
    vectors = compute_leg_vectors(machine.layout, theta, home.position, home.rotation, machine.basis(actuators))
    turned = vectors.axis @ home.rotation
    chart = machine.layout.directions
    legs = [Leg(tuple(z), tuple(own)) for z, own in zip(vectors.axis.tolist(), turned.tolist(), strict=True)]
    if chart is None:
        return legs
    return [replace(leg, symbols=chart.symbols, frame=frame) for leg, frame in zip(legs, chart.frames, strict=True)]


# --- curves ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LevelLine:
    """An invariant in the plane of two parameters, in units of their tolerances about a point of the ridge.

    Attributes
    ----------
    law : Law
    leg : Leg
    start : mapping of symbol to float
        Values of the leg's parameters there.
    moves : mapping of symbol to float
        What the leg's other parameters do for a tolerance of the first one.
    pair : pair of str
    tolerances : pair of float
    """

    law: Law
    leg: Leg
    start: Values
    moves: Values
    pair: Pair
    tolerances: tuple[float, float]

    def __call__(self, x: float, y: float) -> float:
        """Return the invariant."""
        values = {symbol: value + x * self.moves.get(symbol, 0.0) for symbol, value in self.start.items()}
        values[self.pair[0]] = self.start[self.pair[0]] + x * self.tolerances[0]
        values[self.pair[1]] = self.start[self.pair[1]] + y * self.tolerances[1]
        return self.law.invariant(self.leg, values)

    def slope(self, x: float, y: float) -> tuple[float, float]:
        """Return the derivatives by both."""
        h = DIFFERENCE
        return (self(x + h, y) - self(x - h, y)) / (2 * h), (self(x, y + h) - self(x, y - h)) / (2 * h)

    def tangent(self, scale: Values) -> Array | None:
        """Return the direction in which the invariant does not change at the start, shape (2,).

        None where the invariant hardly depends on the two, against the leg's other parameters of given tolerances:
        chance alone then gives the direction.
        """
        by_x, by_y = self.slope(0.0, 0.0)
        squares = 0.0
        for symbol, tolerance in scale.items():
            ends = ({**self.start, symbol: self.start[symbol] + sign * DIFFERENCE * tolerance} for sign in (1, -1))
            high, low = (self.law.invariant(self.leg, values) for values in ends)
            squares += ((high - low) / (2 * DIFFERENCE)) ** 2
        if not math.hypot(by_x, by_y) >= TELLING * math.sqrt(squares):
            return None
        return np.array([by_y, -by_x])

    def trace(self, level: float) -> Array:
        """Return the line on which the invariant has a value, through the start or near it, shape (K, 2)."""
        first = self._correct(0.0, 0.0, level)
        forth = self._walk(first, level, 1.0)
        closed = len(forth) > 1 and math.dist(forth[-1], first) < CLOSED * STEP
        back = [] if closed else self._walk(first, level, -1.0)
        return np.array([*reversed(back), first, *forth])

    def _walk(self, first: tuple[float, float], level: float, sign: float) -> list[tuple[float, float]]:
        points = [first]
        while len(points) < 2 + int(8 * REACH / STEP):
            x, y = points[-1]
            by_x, by_y = self.slope(x, y)
            size = sign * math.hypot(by_x, by_y) / STEP
            x, y = self._correct(x + by_y / size, y - by_x / size, level)
            if not (abs(x) <= REACH and abs(y) <= REACH):  # NaN too
                break
            points.append((x, y))
            if len(points) > 3 and math.dist((x, y), first) < CLOSED * STEP:
                break
        return points[1:]

    def _correct(self, x: float, y: float, level: float) -> tuple[float, float]:
        for _ in range(NEWTON):
            by_x, by_y = self.slope(x, y)
            size = by_x**2 + by_y**2
            excess = (self(x, y) - level) / size if size else math.nan
            x, y = x - excess * by_x, y - excess * by_y
            if excess * excess * size < ON_LINE**2:
                break
        return x, y


def angle_between(first: Array, second: Array) -> float:
    """Return the angle between two directions (2,) without sense, degrees; 90 where one is no direction."""
    across, along = abs(first[0] * second[1] - first[1] * second[0]), abs(float(first @ second))
    return float(np.degrees(np.arctan2(across, along))) if across or along else 90.0
