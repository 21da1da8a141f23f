"""Ridges in words: how far one can go along a direction that the measurements do not see, and what that does.

What legs do is computed with the machine itself, not with its derivatives: the poses of the moved machine against those
of the expected one, at the planned measurements and over the workspace.

Some ridges theory knows. A law is an invariant of one leg's parameters, what stays the same when they change without
any pose telling. On the ridge that it explains the invariant is constant; its level lines are the ridge's curve,
however far it goes. Whether a law explains a ridge that was found is decided by its slope alone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.sensitivity import compute_measured_poses, compute_sensitivity
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.machines.models.legs import compute_leg_vectors
from bayescal.machines.parameters import Rows
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, compute_pose_error
from bayescal.numerics.units import Units

MAIN = 0.2  # of the largest loading in tolerances, from which on a parameter is said to move, and not to follow
NICE = (1.0, 2.0, 5.0)
WORKSPACE_POSES = 40
MANY = 6  # names in a row
BENDS = 3
NOTHING = {"mm": 1e-9, "rad": 5e-12}  # rounding
SMALLEST_SAID = {"mm": 1e-6, "rad": 5e-9}
WRITTEN = {"N mm2": "N mm²", "um": "µm"}
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
class Ridge:
    """A direction with what a round step along it does.

    Attributes
    ----------
    direction : Direction
    step : float
        Of the pivot, in its inner unit.
    position_change, rotation_change : float
        Largest change of a measured pose at the planned measurements, mm and rad.
    workspace_position, workspace_rotation : float
        The same over the workspace.
    loadings : dict of name to float
        Moves of all parameters concerned for that step, inner units.
    sentence : str
    """

    direction: Direction
    step: float
    position_change: float
    rotation_change: float
    workspace_position: float
    workspace_rotation: float
    loadings: dict[str, float]
    sentence: str


def describe_ridges(
    knowledge: Knowledge, plan: Plan, workspace_actuators: Array, directions: Sequence[Direction], units: Units
) -> list[Ridge]:
    """Return the ridges among the directions, described.

    Parameters
    ----------
    knowledge : Knowledge
    plan : Plan
    workspace_actuators : ndarray, shape (W, N)
    directions : sequence of Direction
    units : Units
        Those of the sentences.
    """
    ridges = [d for d in directions if d.pivot is not None]
    if not ridges:
        return []
    scaled = [round_step(one, knowledge.sd, knowledge.units, units) for one in ridges]
    steps = [step for step, _ in scaled]
    moves = _bend(knowledge, plan, ridges, np.stack([move for _, move in scaled]))
    some = workspace_actuators[np.linspace(0, len(workspace_actuators) - 1, WORKSPACE_POSES).astype(int)]
    planned = _changes(knowledge, moves, plan.actuators)
    elsewhere = _changes(knowledge, moves, some)
    found = []
    for k, direction in enumerate(ridges):
        loadings = {knowledge.names[i]: float(moves[k, i]) for i in np.flatnonzero(moves[k])}
        text = describe_move(knowledge.names, knowledge.units, direction, moves[k], units)
        seen, there = planned[k].tolist(), elsewhere[k].tolist()
        most = [_say_most(value, unit, units) for value, unit in zip(seen, NOTHING, strict=True)]
        none = all(value < least for value, least in zip(seen, NOTHING.values(), strict=True))
        said = "at all" if none else f"by more than {most[0]} and {most[1]}"
        sentence = f"{text} changes no measured pose {said}."
        found.append(Ridge(direction, steps[k], seen[0], seen[1], there[0], there[1], loadings, sentence))
    return found


def describe_reading_ridges(
    directions: Sequence[Direction],
    rows: Array,
    names: Sequence[str],
    kinds: Sequence[str],
    sd: Array,
    units: Units,
    member: str,
) -> Iterator[tuple[Direction, float, Array, str]]:
    """Yield the ridges among directions with a round step of each pivot, the move (n,) in inner units, and a sentence.

    Parameters
    ----------
    directions : sequence of Direction
        Of n parameters.
    rows : ndarray, shape (P, K, n)
        White derivatives of the readings in units of the tolerances, poses eliminated.
    names, kinds : sequence of str
        What the parameters are called, and their inner units.
    sd : ndarray, shape (n,)
        Tolerances.
    units : Units
        Those of the sentences.
    member : str
        What one of many is called.
    """
    for direction in directions:
        if direction.pivot is not None:
            step, move = round_step(direction, sd, kinds, units)
            most = float(np.abs(rows @ (move / sd)).max())
            text = describe_move(names, kinds, direction, move, units, member)
            yield direction, step, move, f"{text} changes no reading by more than {most:.2g} of its noise."


def round_step(direction: Direction, sd: Array, kinds: Sequence[str], units: Units) -> tuple[float, Array]:
    """Return a round step of a ridge's pivot, at most a tolerance, and the move (n,) for it, in inner units."""
    pivot = direction.pivot
    assert pivot is not None
    factor = units.factor(kinds[pivot])
    largest = sd[pivot] * min(1.0, np.abs(direction.vector[pivot]) / np.abs(direction.vector).max())
    step = float(factor * round_below(largest / factor))
    natural = direction.vector * sd
    return step, natural / natural[pivot] * step


def _bend(knowledge: Knowledge, plan: Plan, ridges: Sequence[Direction], moves: Array) -> Array:
    """Return moves that follow the ridges where these are curved: what follows does so until the poses agree best.

    Gauss-Newton steps with the derivatives of the expected machine, the priors holding back as they do there.
    """
    rows = compute_sensitivity(knowledge, plan.actuators)
    scale = rows.rows(plan)[:, :DEGREES_OF_FREEDOM] * knowledge.sd
    bent = moves.copy()
    for _ in range(BENDS):
        change = _pose_changes(knowledge, bent, plan.actuators)
        seen = np.einsum("pij,kpj->kpi", rows.root(plan), change)
        for k, direction in enumerate(ridges):
            follow = np.setdiff1d(np.flatnonzero(direction.vector), [direction.pivot])
            if not len(follow):
                continue
            design = scale[..., follow].reshape(-1, len(follow))
            target = np.concatenate([-seen[k].ravel(), -(bent[k, follow] - moves[k, follow]) / knowledge.sd[follow]])
            full = np.concatenate([design, np.eye(len(follow))])
            bent[k, follow] += np.linalg.lstsq(full, target, rcond=None)[0] * knowledge.sd[follow]
    return bent


def round_below(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(nice for nice in NICE if nice * power <= value * (1 + 1e-9)) * power)


def _pose_changes(knowledge: Knowledge, moves: Array, actuators: Array) -> Array:
    """Return how poses change with moves of the free parameters (k, n), mm and rad, shape (k, P, 6)."""
    theta = np.broadcast_to(knowledge.centre, (len(moves) + 1, knowledge.layout.size)).copy()
    theta[1:, knowledge.free] += moves
    position, rotation = compute_measured_poses(knowledge, theta, actuators)
    return compute_pose_error(position[1:], rotation[1:], position[:1], rotation[:1])


def _changes(knowledge: Knowledge, moves: Array, actuators: Array) -> Array:
    """Return the largest change of position (mm) and of orientation (rad) at some poses for each move, shape (k, 2)."""
    change = _pose_changes(knowledge, moves, actuators)
    result: Array = np.stack([np.linalg.norm(change[..., part], axis=-1) for part in (slice(3), slice(3, 6))], axis=-1)
    return np.asarray(result.max(axis=1))


# --- words -------------------------------------------------------------------------------------------------------


def describe_move(
    names: Sequence[str],
    kinds: Sequence[str],
    direction: Direction,
    move: Array,
    units: Units,
    member: str = "leg",
) -> str:
    """Return a ridge's move in words, as the beginning of a sentence.

    Parameters
    ----------
    names, kinds : sequence of str
        Of the n free parameters: what they are called, and their inner units.
    direction : Direction
    move : ndarray, shape (n,)
        In inner units.
    units : Units
        Those of the sentence.
    member : str
        What one of many is called.
    """
    pivot = direction.pivot
    assert pivot is not None
    order = [k for k in np.argsort(-np.abs(direction.vector)) if direction.vector[k] and k != pivot]
    main = [k for k in order if abs(direction.vector[k]) >= MAIN * np.abs(direction.vector).max()]
    minor = [k for k in order if k not in main]
    legs = {found.group(1) if (found := re.search(r"\[(\d+)\]$", names[k])) else None for k in (pivot, *order)}
    leg = next(iter(legs)) if len(legs) == 1 else None

    def name(k: int) -> str:
        return names[k].partition("[")[0] if leg else names[k]

    where = f"{member.capitalize()} {leg}: " if leg else ""
    text = f"{where}changing {name(pivot)} by {_amount(kinds[pivot], move[pivot], units)}"
    text = text if leg else text[0].upper() + text[1:]
    if main:
        text += " with " + _join([f"{name(k)} by {_amount(kinds[k], move[k], units)}" for k in main])
    if minor:
        share = max(1, round(100 * max(abs(direction.vector[k]) for k in minor)))
        text += f" (and {_join([name(k) for k in minor])} following by at most {share} % of their tolerances)"
    return text


def _amount(unit: str, move: float, units: Units) -> str:
    value = move / units.factor(unit)
    text = f"{value:+.3g}".replace("-", "\u2212")
    return text if unit == "1" else f"{text} {_name(unit, units)}"


def _name(unit: str, units: Units) -> str:
    name = units.name(unit)
    return WRITTEN.get(name, name)


def _say_most(value: float, unit: str, units: Units) -> str:
    """Return a length or an angle to two digits with its unit, rounded up: what is said to be the most must be."""
    value = max(value, SMALLEST_SAID[unit]) / units.factor(unit)
    power = 10.0 ** (np.floor(np.log10(value)) - 1)
    most = np.ceil(value) if value >= 100 else np.ceil(value / power * (1 - 1e-12)) * power
    digits = np.format_float_positional(most, precision=max(2, len(f"{most:.0f}")), fractional=False, trim="-")
    return f"{digits} {_name(unit, units)}"


def _join(parts: list[str]) -> str:
    if len(parts) > MANY:
        parts = [*parts[: MANY - 1], f"{len(parts) - MANY + 1} more"]
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


# --- ridges that theory knows -----------------------------------------------------------------------------------------


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
    pairs : tuple of pairs of symbols
        Between which it is the curve, in any order.
    formula : str
        What is constant, with ``{z_x}``, ``{z_y}`` and ``{z_z}`` for the leg's direction.
    name : str
        What that is, in words.
    invariant : callable
        From the leg and its parameters by symbol; those that a model lacks are left out.
    """

    pairs: tuple[Pair, ...]
    formula: str
    name: str
    invariant: Callable[[Leg, Values], float]

    def ties(self, pair: Pair) -> bool:
        """Return whether it is a law between two symbols."""
        return any(set(pair) == set(own) for own in self.pairs)

    def say(self, leg: Leg) -> str:
        """Return the formula with the leg's numbers."""
        z = (f"{value:.3f}".replace("-", "\u2212") for value in leg.base)
        return self.formula.format(**dict(zip(("z_x", "z_y", "z_z"), z, strict=True)))


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


def _joint(axis: int, leg: Leg, values: Values) -> float:
    """Return c = a + ρ^0 u along an axis: where the lower joint is at home."""
    return values[f"a_{'xyz'[axis]}"] + values["rho0"] * _direction(leg, values)[axis]


_POINTS = tuple(f"{symbol}_{axis}" for symbol in "ab" for axis in "xyz")


def list_laws(machine: Machine) -> tuple[Law, ...]:
    """Return the laws of a machine's legs.

    The published ones are those of actuators told by u_x and u_y, which lean little. Where an actuator leans far or
    is level, a shift of either joint along any axis may be taken up by the leg's length.
    """
    shifts = (*((point, "l") for point in _POINTS), *product(_POINTS[:3], _POINTS[3:]))
    if machine.mechanism.drive == "strut":  # Yu, Wu and Wang 2023 eqs. (1) and (3)
        formula = "l + z·a − z·b, z = ({z_x}, {z_y}, {z_z})"
        return (Law(shifts, formula, "the length between the joints of the strut", _length),)
    chart = machine.layout.directions
    if chart is None or chart.upright:
        first, second = UPRIGHT
        frames = np.eye(3)[None]
        shifts = (("a_z", "l"), ("b_z", "l"), ("a_z", "b_z"))
        length = "λ a_z − λ b_z + l, λ = z·e_z = {z_z}"  # RR-8096 eqs. (34) to (36)
        gain = "κ − u_z − (z_x/z_z) u_x − (z_y/z_z) u_y, z = ({z_x}, {z_y}, {z_z})"  # RR-8096 eqs. (38) to (40)
    else:
        (first, second), frames = chart.symbols, chart.axes
        length = "l + z·(a + ρ0 u) − z·b, z = ({z_x}, {z_y}, {z_z})"
        gain = "z·u − z_z κ, z = ({z_x}, {z_y}, {z_z})"
    turn = "z·u, what the actuator moves along the leg, z = ({z_x}, {z_y}, {z_z})"  # RR-8096 eq. (30), ρ u along it
    laws = [
        Law(shifts, length, "the distance of the joints along the leg", _length),
        Law((("kappa", first), ("kappa", second)), gain, "the gain of the actuator along the leg", _gain),
        Law(((first, second),), turn, "the direction of the actuator against the leg", _gain),
    ]
    for k, axis in enumerate("xyz"):  # RR-8096 eq. (30), a + ρ u at ρ0
        moving = (symbol for j, symbol in enumerate((first, second)) if frames[:, j, k].any())
        pairs = (("rho0", f"a_{axis}"), *((symbol, f"a_{axis}") for symbol in moving))
        formula = f"a_{axis} + ρ0 u_{axis}, the lower joint at home"
        laws.append(Law(pairs, formula, "the place of the joint at home", partial(_joint, k)))
    return tuple(laws)


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
