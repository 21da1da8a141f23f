"""Tables of actuator positions: at which poses measurements were taken, and what each pose is for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from bayescal.errors import InputError, name_faults, say_unknown
from bayescal.files.csv_tables import CsvTable, read_matrix, read_table
from bayescal.machines.readings import Channel
from bayescal.machines.readings.base import narrow_range
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import units_like

OVERTRAVEL = 0.05
"""Share of the range by which a position that was read may lie outside of it."""
STIRRING = 0.1
"""Share of the range below which a plan hardly moves the machine: nobody meant that."""
USES = ("calibration", "verification")

type Columns = Mapping[str, float]
"""Columns of N actuator positions, each with the factor to the unit of the channel that it is of."""


def name_actuators(n_legs: int) -> Columns:
    """Return the columns of the actuator positions of a machine on legs."""
    return {f"rho_{leg}_mm": 1.0 for leg in range(1, n_legs + 1)}


def choose_columns(channels: Sequence[Channel], path: Path) -> Columns:
    """Return the columns of commanded channels: each in the unit in which a table has it, else in its own."""
    there, found = read_table(path, None).columns, dict[str, float]()
    for one in channels:
        units = {f"{one.stem}_{unit}": factor for unit, factor in units_like(one.unit).items()}
        name = next((name for name in units if name in there), f"{one.stem}_{one.unit}")
        found[name] = units[name]
    return found


def read_positions(table: CsvTable, columns: Columns) -> Array:
    """Return the actuator positions of a table (P, N), in the units of their channels."""
    return table.numbers(list(columns)) * np.array(list(columns.values()))


def read_actuators(path: Path, columns: Columns) -> tuple[list[str], np.ndarray, Array]:
    """Return the names of P poses, which are for verification (P,), and their actuator positions (P, N)."""
    table = read_table(path, ("pose", "use", *columns))
    poses = table.text("pose")
    table.check_unique([(pose,) for pose in poses], "pose")
    return poses, read_uses(table), read_positions(table, columns)


def read_uses(table: CsvTable) -> np.ndarray:
    """Return which rows of a table are for verification; InputError for another use."""
    uses = table.text("use")
    for row, use in enumerate(uses):
        if use not in USES:
            raise InputError(say_unknown(f"{table.where(row)}: {table.name('use')}", use, USES))
    return np.array([use == "verification" for use in uses])


def check_travel(
    actuators: Array, limits: Array, channels: Sequence[Channel], names: Sequence[str], path: Path
) -> None:
    """Raise InputError where positions (P, N) lie beyond the limits (N, 2) of commanded channels, where there are any.

    Limits are no wider than the ends of the channels' readings. Lengths and others are looked at by themselves; the
    message names row and column of the table that they were read from.
    """
    limits = narrow_range(limits, channels)
    for unit in dict.fromkeys(one.unit for one in channels):
        some = [k for k, one in enumerate(channels) if one.unit == unit and np.isfinite(limits[k]).all()]
        middle, reach = limits[some].mean(axis=1), 0.5 * np.ptp(limits[some], axis=1)
        if some:
            stems = [channels[k].stem for k in some]
            check_range(actuators[:, some], middle, reach, names, partial(find_position, path, stems, unit))


def check_ends(table: CsvTable, column: str, channel: Channel, values: Array, factor: float) -> None:
    """Raise InputError for the first reading of a column (P,) beyond the ends of its channel's.

    ``factor`` is the size of the column's unit in the channel's; NaN is no reading. Readings of the machine's own
    channels have a margin, since their zeros are not known.
    """
    name, (low, high) = table.name(column), (one / factor for one in channel.ends)
    margin = 0.0 if channel.external or not np.isfinite(high - low) else 0.5 * OVERTRAVEL * (high - low)
    wrong = (values < low - margin) | (values > high + margin)
    if wrong.any():
        turned = np.radians(values[np.isfinite(values)])
        degrees = column.endswith("_rad") and np.all((turned >= low) & (turned <= high))
        hint = "; degrees?" if degrees and np.ptp(turned) > STIRRING * (high - low) else ""
        table.refuse(
            wrong,
            lambda row: (
                f"{name}: found {values[row]:g}, expected {low:g} to {high:g}, all that {channel.name} can read{hint}"
            ),
        )


def check_range(
    actuators: Array,
    home: Array,
    largest: float | Array,
    names: Sequence[str],
    find: Callable[[str, int], tuple[str, str, float]] | None = None,
) -> None:
    """Raise InputError where actuators have moved further than they can; the message tries what may have gone wrong.

    Positions (P, N), the initial ones (N,) and the largest displacements from there, in one unit; names of the poses.
    ``find`` says where the position of a pose and an actuator stands in a file, as `find_position` does; without it
    actuators are legs, and positions in mm.
    """
    moved = np.abs(actuators - home)
    reach = np.broadcast_to(largest, home.shape)
    limit = reach * (1.0 + OVERTRAVEL)
    if not np.any(moved > limit):
        return
    pose, leg = divmod(int(np.argmax(moved - limit)), len(home))
    where, unit, size = (f"pose {names[pose]!r}, leg {leg + 1}", "mm", 1.0) if find is None else find(names[pose], leg)
    raise InputError(
        f"{where}: found {actuators[pose, leg] / size:g} {unit}, "
        f"{moved[pose, leg] / size:.3g} {unit} from the initial position, expected at most {reach[leg] / size:g} "
        f"{unit}{_explain(actuators, home, limit) if unit == 'mm' else ''}"
    )


def find_position(path: Path, stems: Sequence[str], unit: str, pose: str, place: int) -> tuple[str, str, float]:
    """Return where a position stands in its file, the unit that it has there, and the size of that.

    Positions are in the columns of these stems, in a unit of the same kind.
    """
    table = read_table(path, None)
    row = table.text("pose").index(pose)
    units = {f"{stems[place]}_{other}": (other, size) for other, size in units_like(unit).items()}
    column = next(name for name in table.columns if name in units)
    return (f"{table.where(row)}: pose {pose!r}, {table.name(column)}", *units[column])


def _explain(actuators: Array, home: Array, limit: Array) -> str:
    """Return what was perhaps written instead of positions in mm, found by trying it."""
    tried = {
        "; displacements instead of positions?": actuators + home,
        "; metres?": 1e3 * actuators,
        "; micrometres?": 1e-3 * actuators,
        "; displacements in metres?": 1e3 * actuators + home,
        "; displacements in micrometres?": 1e-3 * actuators + home,
    }
    travel = {word: float(np.ptp(other, axis=0).max()) for word, other in tried.items()}
    fits = [word for word, other in tried.items() if np.all(np.abs(other - home) <= limit)]
    best = max(fits, key=travel.__getitem__, default="")
    return best if best and travel[best] > STIRRING * limit.max() else ""


def read_moves(path: Path, unit: float, n_legs: int) -> Array:
    """Return the displacements of a plan (P, N), mm, from a table in some unit; InputError where all poses are one."""
    moves: Array = unit * read_matrix(path, n_legs)
    with name_faults(path):
        check_moves(moves)
    return moves


def check_moves(actuators: Array) -> None:
    """Raise InputError where no actuator moves from any of several poses (P, N) to another."""
    if len(actuators) > 1 and not np.ptp(actuators, axis=0).any():
        raise InputError(f"found equal actuator positions at all {len(actuators)} poses, expected different ones")


def check_calibration(path: Path, verification: np.ndarray) -> None:
    """Raise InputError where no pose is left to calibrate with."""
    if verification.all():
        raise InputError(f"{path}: found no calibration pose")
