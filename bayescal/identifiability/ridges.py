"""Ridges in words: how far one can go along a direction that the measurements do not see, and what that does.

Everything said here is computed with the machine itself, not with its derivatives: the poses of the moved machine
against those of the expected one, at the planned measurements and over the workspace.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.sensitivity import compute_measured_poses, compute_sensitivity
from bayescal.identifiability.units import Units
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, compute_pose_error

MAIN = 0.2  # of the largest loading in tolerances, from which on a parameter is said to move, and not to follow
NICE = (1.0, 2.0, 5.0)
WORKSPACE_POSES = 40
MANY = 6  # names in a row
BENDS = 3
NOTHING = {"mm": 1e-9, "rad": 5e-12}  # rounding
SMALLEST_SAID = {"mm": 1e-6, "rad": 5e-9}
WRITTEN = {"N mm2": "N mm²", "um": "µm"}


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
    moves, steps = _moves(knowledge, ridges, units)
    moves = _bend(knowledge, plan, ridges, moves)
    some = workspace_actuators[np.linspace(0, len(workspace_actuators) - 1, WORKSPACE_POSES).astype(int)]
    planned = _changes(knowledge, moves, plan.actuators)
    elsewhere = _changes(knowledge, moves, some)
    found = []
    for k, direction in enumerate(ridges):
        loadings = {knowledge.names[i]: float(moves[k, i]) for i in np.flatnonzero(moves[k])}
        sentence = _phrase(knowledge, direction, moves[k], planned[k], units)
        seen, there = planned[k].tolist(), elsewhere[k].tolist()
        found.append(Ridge(direction, float(steps[k]), seen[0], seen[1], there[0], there[1], loadings, sentence))
    return found


def _moves(knowledge: Knowledge, ridges: Sequence[Direction], units: Units) -> tuple[Array, Array]:
    """Return moves of the free parameters (k, n) for a round step of each pivot, at most a tolerance, and the steps."""
    steps = np.empty(len(ridges))
    moves = np.empty((len(ridges), len(knowledge.sd)))
    for k, direction in enumerate(ridges):
        pivot = direction.pivot
        assert pivot is not None
        natural = direction.vector * knowledge.sd
        factor = units.factor(knowledge.units[pivot])
        largest = knowledge.sd[pivot] * min(1.0, np.abs(direction.vector[pivot]) / np.abs(direction.vector).max())
        steps[k] = factor * round_below(largest / factor)
        moves[k] = natural / natural[pivot] * steps[k]
    return moves, steps


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


def _phrase(knowledge: Knowledge, direction: Direction, move: Array, change: Array, units: Units) -> str:
    text = describe_move(knowledge.names, knowledge.units, direction, move, units)
    if all(value < NOTHING[unit] for value, unit in zip(change, NOTHING, strict=True)):
        return f"{text} changes no measured pose at all."
    most = [_say_most(float(value), unit, units) for value, unit in zip(change, NOTHING, strict=True)]
    return f"{text} changes no measured pose by more than {most[0]} and {most[1]}."


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
    legs = {_leg_of(names[k]) for k in (pivot, *order)}
    leg = next(iter(legs)) if len(legs) == 1 and None not in legs else None
    name = (lambda k: _symbol_of(names[k])) if leg else (lambda k: names[k])
    where = f"{member.capitalize()} {leg}: " if leg else ""
    text = f"{where}changing {name(pivot)} by {_amount(kinds[pivot], move[pivot], units)}"
    text = text if leg else text[0].upper() + text[1:]
    if main:
        text += " with " + _join([f"{name(k)} by {_amount(kinds[k], move[k], units)}" for k in main])
    if minor:
        largest = max(abs(direction.vector[k]) for k in minor)
        text += f" (and {_join([name(k) for k in minor])} following by at most {_percent(largest)} of their tolerances)"
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


def _percent(share: float) -> str:
    return f"{max(1, round(100 * share))} %"


def _join(parts: list[str]) -> str:
    if len(parts) > MANY:
        parts = [*parts[: MANY - 1], f"{len(parts) - MANY + 1} more"]
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _leg_of(name: str) -> str | None:
    found = re.search(r"\[(\d+)\]$", name)
    return found.group(1) if found else None


def _symbol_of(name: str) -> str:
    return name.partition("[")[0]
