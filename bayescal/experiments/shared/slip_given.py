"""What may have happened to what is given of rows, a load, a temperature, a pulse: another unit or sign, exchanged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from bayescal.experiments.shared.slip_rows import RowReadings, VariantReadings
from bayescal.numerics.geometry import Array

type Change = tuple[float, float]
"""Factor and zero: x is taken as factor (x - zero)."""

ANY: Mapping[str, Change] = {
    "1000 times too large": (1e-3, 0.0),
    "1000 times too small": (1e3, 0.0),
    "of the other sign": (-1.0, 0.0),
}
BY_UNIT: Mapping[str, Mapping[str, Change]] = {
    "mm": {"in inches": (25.4, 0.0), "10 times too small (cm for mm)": (10.0, 0.0)},
    "deg": {"in radians": (180.0 / np.pi, 0.0)},
    "rad": {"in degrees": (np.pi / 180.0, 0.0)},
    "c": {"in kelvins": (1.0, 273.15)},
    "celsius": {"in kelvins": (1.0, 273.15)},
}
"""Beside these, by the last part of a column's name."""


def list_rescaled(readings: VariantReadings) -> Iterator[tuple[str, RowReadings]]:
    """Yield words and tables in which a column that is given has another unit or sign."""
    for name in find_moving(readings):
        value = readings.posterior.likelihood.data.given[name]
        own = BY_UNIT.get(name.rpartition("_")[2].lower(), {})
        for words, (factor, zero) in {**ANY, **own}.items():
            yield f"what is given as {name} seems to be {words}", _take(readings, {name: factor * (value - zero)})


def list_exchanged(readings: VariantReadings) -> Iterator[tuple[str, RowReadings]]:
    """Yield words and tables in which two columns that are given of one unit are exchanged."""
    given = readings.posterior.likelihood.data.given
    for one, other in list_alike(find_moving(readings)):
        swapped = {one: given[other], other: given[one]}
        yield f"what is given as {one} and as {other} seems to be exchanged", _take(readings, swapped)


def list_alike(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs of columns of one unit, the last part of their names."""
    return [(a, b) for a, b in combinations(names, 2) if a.rpartition("_")[2] == b.rpartition("_")[2]]


def find_moving(readings: VariantReadings) -> list[str]:
    """Return the columns that the machine reads, known of all rows and not zero throughout."""
    given = readings.posterior.likelihood.data.given
    return [one for one in readings.model.given if np.isfinite(given[one]).all() and given[one].any()]


def _take(readings: VariantReadings, given: Mapping[str, Array]) -> RowReadings:
    return RowReadings(readings.values, np.arange(len(readings.values)), given=given)
