"""Tables of actuator positions: at which poses measurements were taken, and what each pose is for."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal.errors import InputError
from bayescal.files.csv_tables import Table, read_table
from bayescal.numerics.geometry import Array

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


def read_uses(table: Table) -> np.ndarray:
    """Return which rows of a table are for verification; InputError for another use."""
    uses = table.text("use")
    for row, use in enumerate(uses):
        if use not in USES:
            raise InputError(f"{table.where(row)}: use: found {use!r}, expected one of {', '.join(USES)}")
    return np.array([use == "verification" for use in uses])


def check_calibration(path: Path, verification: np.ndarray) -> None:
    """Raise InputError where no pose is left to calibrate with."""
    if verification.all():
        raise InputError(f"{path}: found no calibration pose, expected at least one")
