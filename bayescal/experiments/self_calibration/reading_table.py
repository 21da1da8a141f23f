"""Tables of readings: one row a pose, one column a sensor with its unit, every fault named by row and column."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.data.truth import read_true_parameters
from bayescal.errors import InputError
from bayescal.files.csv_tables import Table, read_table
from bayescal.machines.readings import Channel, ReadingModel
from bayescal.numerics.geometry import Array

USES = ("calibration", "verification")
LARGEST_ANGLE = 2.0 * float(np.pi)
POSE_COLUMNS = ("pose", "x_mm", "y_mm", "phi_rad")


@dataclass(frozen=True, eq=False)
class ReadingTable:
    """Readings as measured.

    Attributes
    ----------
    poses : tuple of str
        Names of the P poses.
    verification : ndarray of bool, shape (P,)
        Whether a pose is kept from the calibration.
    values : ndarray, shape (P, K)
        Readings of all sensors that the machine could have, mm and rad; NaN for those that the file does not have.
    """

    poses: tuple[str, ...]
    verification: np.ndarray
    values: Array


@dataclass(frozen=True, eq=False)
class Truth:
    """What simulated readings were made from: parameters (D,), and the platform's poses (P, 3), mm and rad."""

    theta: Array
    pose: Array


def name_column(channel: Channel) -> str:
    """Return the column of a sensor: ``s[2]`` in mm is ``s_2_mm``."""
    return f"{channel.name.replace('[', '_').rstrip(']')}_{channel.unit}"


def read_readings(path: Path, model: ReadingModel, wanted: Iterable[int]) -> ReadingTable:
    """Read a table of readings.

    Parameters
    ----------
    path : Path
    model : ReadingModel
    wanted : iterable of int
        Sensors, by their places in the model, whose columns must be there.

    Raises
    ------
    InputError
        For a missing or unknown column, a pose twice, an unknown use, a cell that holds no finite number, and an angle
        beyond a turn to either side, which will be in degrees.
    """
    table = read_table(path, None)
    columns = [name_column(channel) for channel in model.channels]
    _check_columns(table, columns, ["pose", "use", *(columns[k] for k in sorted(set(wanted)))])
    there = [k for k, column in enumerate(columns) if column in table.columns]
    values = np.full((len(table.rows), len(columns)), np.nan)
    values[:, there] = table.numbers([columns[k] for k in there])
    for k in there:
        if model.channels[k].unit == "rad":
            _check_angles(table, columns[k], values[:, k])
    return ReadingTable(tuple(_read_names(table)), _read_uses(table), values)


def _check_columns(table: Table, known: Sequence[str], needed: Sequence[str]) -> None:
    for name in table.columns:
        if name not in ("pose", "use", *known):
            close = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
            hint = f", did you mean {close[0]!r}?" if close else ""
            raise InputError(f"{table.path}: found column {name!r}{hint}, expected pose, use, {', '.join(known)}")
    for name in needed:
        if name not in table.columns:
            raise InputError(f"{table.path}: found no column {name!r}, expected {', '.join(needed)}")


def _check_angles(table: Table, column: str, values: Array) -> None:
    for row in np.flatnonzero(np.abs(values) > LARGEST_ANGLE)[:1]:
        raise InputError(
            f"{table.where(int(row))}: {column}: found {values[row]:g}, expected radians, at most 2π in size"
        )


def _read_names(table: Table) -> list[str]:
    names = table.text("pose")
    first: dict[str, int] = {}
    for row, name in enumerate(names):
        if name in first:
            raise InputError(
                f"{table.where(row)}: pose {name!r} stands already on line {table.lines[first[name]]}, expected it once"
            )
        first[name] = row
    return names


def _read_uses(table: Table) -> np.ndarray:
    uses = table.text("use")
    for row, use in enumerate(uses):
        if use not in USES:
            raise InputError(f"{table.where(row)}: use: found {use!r}, expected {' or '.join(USES)}")
    if "calibration" not in uses:
        raise InputError(f"{table.path}: found no pose for calibration, expected some")
    return np.array([use == "verification" for use in uses])


def read_truth(parameters: Path, poses: Path, model: ReadingModel, names: Sequence[str]) -> Truth:
    """Read what simulated readings were made from; InputError where parameters or poses are not those expected."""
    theta = read_true_parameters(parameters, model.layout)
    stands = read_table(poses, POSE_COLUMNS)
    _check_same(stands.text("pose"), names, f"{poses}: poses")
    return Truth(theta, stands.numbers(POSE_COLUMNS[1:]))


def _check_same(found: Sequence[str], expected: Sequence[str], what: str) -> None:
    for k, (one, other) in enumerate(zip(found, expected, strict=False)):
        if one != other:
            raise InputError(f"{what}: found {one!r} in row {k + 1}, expected {other!r}")
    if len(found) != len(expected):
        raise InputError(f"{what}: found {len(found)}, expected {len(expected)}")
