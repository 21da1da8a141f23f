"""Ridges in words: how far one can go along a direction that the measurements do not see, and what that does."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.identifiability.directions import Direction
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units

MAIN = 0.2  # of the largest loading in tolerances, from which on a parameter is said to move, and not to follow
NICE = (1.0, 2.0, 5.0)
MAX_LISTED_NAMES = 6  # names in a row
WRITTEN = {"N mm2": "N mm²", "um": "µm"}


@dataclass(frozen=True)
class Ridge:
    """A direction with what a round step along it does."""

    direction: Direction
    # largest change of the tool's lengths and of its other numbers over the workspace, mm and rad
    workspace_position: float
    workspace_rotation: float
    loadings: dict[str, float]  # by name: moves of all parameters concerned for that step, inner units
    sentence: str


def describe_ridges(
    directions: Sequence[Direction],
    rows: Array,
    names: Sequence[str],
    kinds: Sequence[str],
    sd: Array,
    units: Units,
    member: str,
) -> Iterator[tuple[Direction, Array, str]]:
    """Yield the ridges among directions with the move (n,) for a round step of each pivot, and a sentence.

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
            move = round_step(direction, sd, kinds, units)
            most = float(np.abs(rows @ (move / sd)).max())
            text = describe_move(names, kinds, direction, move, units, member)
            yield direction, move, f"{text} changes no reading by more than {most:.2g} of its noise."


def round_step(direction: Direction, sd: Array, kinds: Sequence[str], units: Units) -> Array:
    """Return the move (n,), inner units, for a round step of a ridge's pivot, at most a tolerance."""
    pivot = direction.pivot
    assert pivot is not None
    factor = units.factor(kinds[pivot])
    largest = sd[pivot] * min(1.0, np.abs(direction.vector[pivot]) / np.abs(direction.vector).max()) / factor
    power = 10.0 ** np.floor(np.log10(largest))
    step = float(max(nice for nice in NICE if nice * power <= largest * (1 + 1e-9)) * power)
    natural = direction.vector * sd
    return np.asarray(natural / natural[pivot] * factor * step)


# --- words -------------------------------------------------------------------------------------------------------


def describe_move(
    names: Sequence[str],
    kinds: Sequence[str],
    direction: Direction,
    move: Array,
    units: Units,
    member: str = "leg",
) -> str:
    """Return a ridge's move (n,), inner units, in words, as the beginning of a sentence in some units.

    The n free parameters are of inner units ``kinds``; ``member`` is what one of many is called.
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
        text += f" (and {_join([name(k) for k in minor])} by at most {share} % of tolerance)"
    return text


def _amount(unit: str, move: float, units: Units) -> str:
    text, name = f"{move / units.factor(unit):+.3g}".replace("-", "\u2212"), units.name(unit)
    return text if unit == "1" else f"{text} {WRITTEN.get(name, name)}"


def _join(parts: list[str]) -> str:
    if len(parts) > MAX_LISTED_NAMES:
        parts = [*parts[: MAX_LISTED_NAMES - 1], f"{len(parts) - MAX_LISTED_NAMES + 1} more"]
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
