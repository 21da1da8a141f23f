"""Slips of sensors' readings, each tried as if it were so: units, signs, exchanged columns, rows that are shifted.

A pose that no reading states is found from all of them, so that readings are held against each other: what no pose
explains of a machine within the tolerances. The median over the poses does not hang on one that is a blunder besides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from bayescal.errors import BayescalError
from bayescal.experiments.shared.slips import BETTER, SCALES
from bayescal.numerics.geometry import Array

ANGLES = {"in degrees": np.pi / 180.0, "in radians where degrees are stated": 180.0 / np.pi, "of the other sign": -1.0}

type Judge = Callable[[Array], Array]
"""Returns how far readings (Q, K) lie from any pose, in units of their noise, shape (Q,); not finite without a pose."""


@dataclass(frozen=True, eq=False)
class MovedReadings:
    """Readings as they would be without a slip, shape (Q, K), mm and rad, and what the slip would be."""

    text: str
    values: Array


def list_reading_slips(names: Sequence[str], units: Sequence[str], values: Array) -> Iterator[MovedReadings]:
    """Yield what may have happened to readings (P, K), mm and rad, of sensors named ``kind[leg]``."""
    kinds = {name.partition("[")[0] for name in names}
    for kind in sorted(kinds):
        own = np.array([k for k, name in enumerate(names) if name.partition("[")[0] == kind])
        scales = SCALES if units[own[0]] == "mm" else ANGLES
        for words, factor in scales.items():
            moved = values.copy()
            moved[:, own] *= factor
            yield MovedReadings(f"readings of {kind} seem to be {words}", moved)
        for one, other in combinations(own, 2):
            moved = values.copy()
            moved[:, [one, other]] = values[:, [other, one]]
            yield MovedReadings(f"readings of {names[one]} and {names[other]} seem to be exchanged", moved)
        if len(own) > 2:
            moved = values.copy()
            moved[:, own] = values[:, own[::-1]]
            yield MovedReadings(f"legs of {kind} seem to be numbered the other way round", moved)
        yield from _shift(kind, own, values)
    for k, name in enumerate(names):
        yield from _shift(name, np.array([k]), values)


def _shift(name: str, columns: np.ndarray, values: Array) -> Iterator[MovedReadings]:
    """Yield some columns as if they stood a row too early or too late."""
    if len(values) < 3 or len(columns) == values.shape[1]:
        return
    for step, words in ((1, "earlier"), (-1, "later")):
        moved = values.copy()
        moved[:, columns] = np.roll(values[:, columns], step, axis=0)
        there = slice(1, None) if step > 0 else slice(None, -1)
        text = f"rows of {name} seem to be shifted by one: they belong to the readings of the row {words}"
        yield MovedReadings(text, moved[there])


def find_reading_slip(judge: Judge, names: Sequence[str], units: Sequence[str], values: Array) -> str | None:
    """Return in words the slip that explains readings best; None where most poses are explained, or no slip helps.

    Parameters
    ----------
    judge : Judge
    names, units : sequences of str
        Of the K sensors; units ``mm`` or ``rad``.
    values : ndarray, shape (P, K)
    """
    base = _take_median(judge, values)
    if base <= BETTER:
        return None
    found = [(_take_median(judge, moved.values), moved.text) for moved in list_reading_slips(names, units, values)]
    mended, text = min(found, default=(np.inf, ""))
    if not base > BETTER * mended:
        return None
    times = f"{base / max(mended, 1.0):.2g} times better" if np.isfinite(base) else "then, and not as they stand,"
    return f"they fit {times} if one mends: {text}"


def _take_median(judge: Judge, values: Array) -> float:
    try:
        with np.errstate(all="ignore"):
            off = judge(values)
    except (BayescalError, np.linalg.LinAlgError):
        return np.inf
    return float(np.median(np.where(np.isfinite(off), off, np.inf)))
