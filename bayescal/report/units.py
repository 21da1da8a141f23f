"""The units in which a page shows values: those that the config names, one for each quantity."""

from __future__ import annotations

import math
from collections.abc import Mapping

from bayescal.report.numbers import format_fixed, format_significant

INNER = {"mm": "length", "rad": "angle"}
SHOWN = {
    "um": (1e3, "µm"),
    "mm": (1.0, "mm"),
    "m": (1e-3, "m"),
    "arcsec": (3600.0 * math.degrees(1.0), "arcsec"),
    "mrad": (1e3, "mrad"),
    "deg": (math.degrees(1.0), "°"),
    "rad": (1.0, "rad"),
}
"""Factor and name of the units that a config may name, which inside are mm or rad."""
PLACES = {"mm": 0, "um": 0, "arcsec": 0, "deg": 1, "mrad": 1}
"""Decimals of coordinates that say where to measure."""

type Asked = Mapping[str, str] | None
"""The units of a config, ``length`` and ``angle``; None for mm and degrees."""

USUAL = {"length": "mm", "angle": "deg"}


def shown_in(unit: str, asked: Asked = None) -> tuple[float, str]:
    """Return factor and name of the unit that values of an inner unit are shown in."""
    if unit in INNER:
        return SHOWN[(asked or USUAL)[INNER[unit]]]
    return 1.0, "" if unit == "1" else unit


def format_amount(value: float, unit: str, digits: int = 2, asked: Asked = None) -> str:
    """Return a value of an inner unit with the unit it is shown in."""
    factor, name = shown_in(unit, asked)
    return f"{format_significant(factor * value, digits)} {name}".rstrip().replace(" °", "°")


def format_place(column: str, value: float, asked: Asked = None) -> str:
    """Return a coordinate of a column such as ``x_mm`` in the unit that places are shown in."""
    unit = column.rpartition("_")[2]
    if unit not in INNER:
        return format_fixed(value, 3)
    return format_fixed(shown_in(unit, asked)[0] * value, PLACES.get((asked or USUAL)[INNER[unit]], 3))


def name_unit(column: str, asked: Asked = None) -> str:
    """Return the unit of a column such as ``x_mm`` as places are shown."""
    unit = column.rpartition("_")[2]
    return shown_in(unit, asked)[1] if unit in INNER else unit
