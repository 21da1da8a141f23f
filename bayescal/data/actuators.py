"""Tables of actuator positions: at which poses measurements were taken, and what each pose is for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bayescal.errors import InputError, name_faults
from bayescal.files.csv_tables import CsvTable, read_matrix, read_table
from bayescal.numerics.geometry import Array

OVERTRAVEL = 0.05
"""Share of the range by which a position that was read may lie outside of it."""
STIRRING = 0.1
"""Share of the range below which a plan hardly moves the machine: nobody meant that."""
USES = ("calibration", "verification")


def name_actuators(n_legs: int) -> tuple[str, ...]:
    """Return the columns of actuator positions."""
    return tuple(f"rho_{leg}_mm" for leg in range(1, n_legs + 1))


def read_actuators(path: Path, n_legs: int) -> tuple[list[str], np.ndarray, Array]:
    """Return the names of P poses, which are for verification (P,), and their actuator positions (P, N), mm."""
    table = read_table(path, ("pose", "use", *name_actuators(n_legs)))
    poses = table.text("pose")
    table.check_unique([(pose,) for pose in poses], "pose")
    return poses, read_uses(table), table.numbers(name_actuators(n_legs))


def read_uses(table: CsvTable) -> np.ndarray:
    """Return which rows of a table are for verification; InputError for another use."""
    uses = table.text("use")
    for row, use in enumerate(uses):
        if use not in USES:
            raise InputError(f"{table.where(row)}: use: found {use!r}, expected one of {', '.join(USES)}")
    return np.array([use == "verification" for use in uses])


def check_range(actuators: Array, home: Array, largest: float, names: Sequence[str]) -> None:
    """Raise InputError where actuators have moved further than they can; the message tries what may have gone wrong.

    Positions (P, N), the initial ones (N,) and the largest displacement from there, mm; names of the poses.
    """
    moved = np.abs(actuators - home)
    limit = largest * (1.0 + OVERTRAVEL)
    if not np.any(moved > limit):
        return
    pose, leg = divmod(int(np.argmax(moved)), len(home))
    raise InputError(
        f"pose {names[pose]!r}, leg {leg + 1}: found {actuators[pose, leg]:g} mm, "
        f"{moved[pose, leg]:.3g} mm from the initial position, expected at most {largest:g} "
        f"mm{_explain(actuators, home, limit)}"
    )


def _explain(actuators: Array, home: Array, limit: float) -> str:
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
    return best if best and travel[best] > STIRRING * limit else ""


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
