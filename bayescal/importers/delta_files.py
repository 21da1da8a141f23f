"""The files of a linear delta that the formats of several firmwares write alike."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayescal.errors import InputError
from bayescal.importers import fill_template

ANGLES = (210.0, 330.0, 90.0)
"""Directions of towers 1 to 3 where nothing else is said, degrees."""
LARGEST_MM = 1e6
SMALLEST_MM = 1e-3
LEVEL = 0.25  # of the height of the endstops, up to which accuracy counts


def parse_number(text: str, what: str, where: tuple[Path, int], least: float, most: float = LARGEST_MM) -> float:
    """Return a number of a file; InputError, with the line, for what is none or lies beyond the limits."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not least <= value <= most:
        expected = "a number" if (least, most) == (-LARGEST_MM, LARGEST_MM) else f"a number from {least:g} to {most:g}"
        raise InputError(f"{where[0]}, line {where[1]}: {what}: found {text!r}, expected {expected}")
    return value


def format_delta(
    firmware: str,
    radius: float,
    arms: Sequence[float],
    endstops: Sequence[float],
    angles: Sequence[float],
    bed: float,
    paired: bool = False,
) -> str:
    """Return the file of a delta with values in mm and degrees, of towers 1 to 3 where there are several.

    ``bed`` is the radius where accuracy counts, as far as arms reach; ``paired``: whether a row is two places.
    """
    bed = min(bed, 0.99 * (min(arms) - radius))
    height = max(1.0, LEVEL * min(endstops))
    places = "places = 2              # a row is two places of the nozzle, or one alone\n" if paired else ""
    return fill_template(
        "delta",
        firmware=firmware,
        places=places,
        radius=repr(float(radius)),
        arms=repr([float(one) for one in arms]),
        endstops=repr([float(one) for one in endstops]),
        angles=repr([float(one) for one in angles]),
        bed=repr(float(bed)),
        height=repr(float(height)),
    )
