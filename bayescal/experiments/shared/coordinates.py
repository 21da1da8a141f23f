"""Tables of poses by a machine's coordinates."""

from __future__ import annotations

import difflib
from pathlib import Path

import numpy as np

from bayescal.errors import InputError
from bayescal.files.csv_tables import Table, read_table
from bayescal.identifiability.units import units_like
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array


def read_coordinates(path: Path, model: ReadingModel) -> tuple[tuple[str, ...], Array, dict[str, Array]]:
    """Return names of poses, their coordinates (P, q), and what the machine has to know of each, (P,) by name.

    Columns: ``pose``; each coordinate with its unit, such as ``x_mm``; what else is to be known.
    """
    table = read_table(path, None)
    known = {
        f"{one.name}_{unit}": (one.name, factor)
        for one in model.coordinates
        for unit, factor in units_like(one.unit).items()
    } | {name: (name, 1.0) for name in model.given}
    _check_columns(table, [*known], [f"{one.name}_{one.unit}" for one in model.coordinates] + [*model.given])
    columns: dict[str, Array] = {}
    for column in table.columns:
        if column == "pose":
            continue
        name, factor = known[column]
        if name in columns:
            raise InputError(f"{path}: found column {column!r} besides another of {name}, expected one of them")
        columns[name] = factor * table.numbers((column,))[:, 0]
    for name in (*(one.name for one in model.coordinates), *model.given):
        if name not in columns:
            raise InputError(f"{path}: found no column of {name}, expected one")
    pose = np.array([columns[one.name] for one in model.coordinates]).reshape(-1, len(table.rows)).T
    return tuple(pose_names(table)), pose, {name: columns[name] for name in model.given}


def _check_columns(table: Table, known: list[str], expected: list[str]) -> None:
    if "pose" not in table.columns:
        raise InputError(f"{table.path}: found no column 'pose', expected the poses' names")
    for name in table.columns:
        if name not in ("pose", *known):
            close = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
            hint = f", did you mean {close[0]!r}?" if close else ""
            raise InputError(f"{table.path}: found column {name!r}{hint}, expected pose, {', '.join(expected)}")


def pose_names(table: Table) -> list[str]:
    """Return the names of a table's poses; InputError where one stands there twice."""
    names = table.text("pose")
    for row, name in enumerate(names):
        if (first := names.index(name)) != row:
            raise InputError(
                f"{table.where(row)}: pose {name!r} stands already on line {table.lines[first]}, expected it once"
            )
    return names
