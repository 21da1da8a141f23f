"""Slips of sensors' readings, each tried as if it were so: units, signs, exchanged columns, rows that are shifted.

A pose that no reading states is found from all of them, so that readings are held against each other: what no pose
explains of a machine within the tolerances. The median over the poses does not hang on one that is a blunder besides.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from bayescal.errors import BayescalError
from bayescal.experiments.shared.slips import BETTER, LEGS, ROWS, SCALES, UNIT
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_significant, join_words

ANGLES = {"in degrees": np.pi / 180.0, "in radians where degrees are stated": 180.0 / np.pi, "of the other sign": -1.0}

ALIKE, MANY = 1.2, 3
"""Factor within which slips explain readings alike, as in a mirrored machine, and how many of them are named."""
EVERY = slice(None)

type Judge = Callable[[Array, slice], Array]
"""Returns how far readings (Q, K) of some of the poses lie from what a machine reads, in units of their noise, (Q,)."""


@dataclass(frozen=True, eq=False)
class MovedReadings:
    """Readings as they would be without a slip.

    Attributes
    ----------
    fault : str
    text : str
        What the slip would be.
    values : ndarray, shape (Q, K)
        mm and rad.
    chosen : slice
        Which of the P poses they belong to.
    """

    fault: str
    text: str
    values: Array
    chosen: slice = EVERY


def list_reading_slips(
    names: Sequence[str], units: Sequence[str], values: Array, given: Sequence[str] = ()
) -> Iterator[MovedReadings]:
    """Yield what may have happened to readings (P, K), mm and rad, of sensors named ``kind[leg]``.

    What is ``given`` of each pose besides are columns that all readings may be shifted against.
    """
    kinds = {name.partition("[")[0] for name in names}
    for kind in sorted(kinds):
        own = np.array([k for k, name in enumerate(names) if name.partition("[")[0] == kind])
        scales = SCALES if units[own[0]] == "mm" else ANGLES
        for words, factor in scales.items():
            moved = values.copy()
            moved[:, own] *= factor
            yield MovedReadings(UNIT, f"readings of {kind} seem to be {words}", moved)
        for one, other in combinations(own, 2):
            moved = values.copy()
            moved[:, [one, other]] = values[:, [other, one]]
            yield MovedReadings(LEGS, f"readings of {names[one]} and {names[other]} seem to be exchanged", moved)
        if len(own) > 2:
            moved = values.copy()
            moved[:, own] = values[:, own[::-1]]
            yield MovedReadings(LEGS, f"legs of {kind} seem to be numbered the other way round", moved)
        for step in range(1, len(own) if len(own) > 2 else 1):
            moved = values.copy()
            moved[:, own] = values[:, np.roll(own, -step)]
            yield MovedReadings(LEGS, f"legs of {kind} seem to be counted from leg {step + 1}", moved)
        yield from _shift(kind, own, values)
    for k, name in enumerate(names):
        yield from _shift(name, np.array([k]), values)
    if given:
        yield from _shift(f"all readings against {join_words(list(given))}", np.arange(values.shape[1]), values, True)


def _shift(name: str, columns: np.ndarray, values: Array, together: bool = False) -> Iterator[MovedReadings]:
    """Yield some columns as if they stood a row too early or too late; all of them only ``together``."""
    if len(values) < 3 or (len(columns) == values.shape[1] and not together):
        return
    for step, words in ((1, "earlier"), (-1, "later")):
        moved = values.copy()
        moved[:, columns] = np.roll(values[:, columns], step, axis=0)
        there = slice(1, None) if step > 0 else slice(None, -1)
        text = f"rows of {name} seem to be shifted by one: they belong to the readings of the row {words}"
        yield MovedReadings(ROWS, text, moved[there], there)


def measure_misfit(judge: Judge, values: Array, chosen: slice = EVERY) -> float:
    """Return how far the median of poses lies from what a machine within its tolerances reads, in their noise."""
    try:
        with np.errstate(all="ignore"):
            off = judge(values, chosen)
    except (BayescalError, np.linalg.LinAlgError):
        return np.inf
    return float(np.median(np.where(np.isfinite(off), off, np.inf)))


def find_reading_slip(
    judge: Judge,
    names: Sequence[str],
    units: Sequence[str],
    values: Array,
    given: Sequence[str] = (),
    denied: Collection[str] = (),
) -> str | None:
    """Return in words the slip that explains readings best; None where most poses are explained, or no slip helps.

    Parameters
    ----------
    judge : Judge
    names, units : sequences of str
        Of the K sensors; units ``mm`` or ``rad``.
    values : ndarray, shape (P, K)
    given : sequence of str, optional
        What is known of each pose besides.
    denied : collection of str, optional
        Faults that are none, as somebody says who looked.
    """
    base = measure_misfit(judge, values)
    if base <= BETTER:
        return None
    slips = list_reading_slips(names, units, values, given)
    tried = [moved for moved in slips if moved.fault not in denied]
    found = [(measure_misfit(judge, moved.values, moved.chosen), moved.text) for moved in tried]
    mended, _ = min(found, default=(np.inf, ""))
    if not base > BETTER * mended:
        return None
    alike = [text for off, text in sorted(found) if off <= ALIKE * max(mended, 1.0)][:MANY]
    times = (
        f"{format_significant(base / max(mended, 1.0), 2)} times better"
        if np.isfinite(base)
        else "then, and not as they stand,"
    )
    return f"they fit {times} if one mends: {' (or: '.join(alike)}{')' * (len(alike) - 1)}"
