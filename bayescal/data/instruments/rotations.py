"""Rotations as instruments write them, told by the columns' names: vectors, quaternions, angles one after the other.

A turn of the platform out of the base's axes, R, takes coordinates on the platform to base axes. It is read from

- ``rx_deg, ry_deg, rz_deg``: the rotation vector, axis times angle; alone these may be measured in part;
- ``qw, qx, qy, qz``: the unit quaternion;
- ``roll_deg, pitch_deg, yaw_deg``: R = Rz(yaw) Ry(pitch) Rx(roll), about the fixed axes x, y, z one after the other;
- ``xyz_1_deg, xyz_2_deg, xyz_3_deg``: three angles in any order of axes, by the letters as `scipy.spatial.transform`
  takes them: small ones about the fixed axes, capital ones about axes that turn along.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.errors import InputError
from bayescal.files.csv_tables import Table
from bayescal.numerics.geometry import Array

VECTOR = ("rx_deg", "ry_deg", "rz_deg")
QUATERNION = ("qw", "qx", "qy", "qz")
ROLL_PITCH_YAW = ("roll_deg", "pitch_deg", "yaw_deg")
FIXED = "xyz"
SEQUENCES = tuple(
    "".join(axes)
    for letters in (FIXED, FIXED.upper())
    for axes in product(letters, repeat=3)
    if axes[0] != axes[1] != axes[2]
)
UNIT_LENGTH = 1e-3
"""How far a quaternion's length may be from one: what rounding to three digits leaves."""


def name_angles(sequence: str) -> tuple[str, str, str]:
    """Return the columns of three angles about these axes."""
    return (f"{sequence}_1_deg", f"{sequence}_2_deg", f"{sequence}_3_deg")


ANGLES: dict[tuple[str, ...], str] = {ROLL_PITCH_YAW: FIXED, **{name_angles(one): one for one in SEQUENCES}}
OTHER_COLUMNS = (*QUATERNION, *(name for names in ANGLES for name in names))
"""Those that a table may have in place of a rotation vector's."""


def read_rotation_vectors(table: Table) -> Array:
    """Return rotation vectors in rad, shape (P, 3), of the form the table has; NaN where not measured.

    Raises
    ------
    InputError
        For two forms in one table, one that is there in part, a quaternion far from length one, or a rotation vector
        longer than half a turn.
    """
    found = [names for names in (VECTOR, QUATERNION, *ANGLES) if any(name in table.columns for name in names)]
    if len(found) > 1:
        first, second = (next(name for name in names if name in table.columns) for names in found[:2])
        raise InputError(f"{table.path}: found column {first!r} beside {second!r}, expected rotations in one form")
    if not found:
        return np.full((len(table.rows), 3), np.nan)
    if found[0] == VECTOR:
        return _read_vectors(table)
    table.has(found[0])
    values = table.numbers(found[0], gaps=True)
    there = np.isfinite(values)
    whole = there.all(axis=1)
    text = f"found a rotation in part, expected {', '.join(found[0])} or none of them"
    table.refuse(there.any(axis=1) & ~whole, lambda _: text)
    result = np.full((len(values), 3), np.nan)
    if found[0] == QUATERNION:
        length = np.linalg.norm(values, axis=1)
        wrong = np.abs(length - 1.0) > UNIT_LENGTH  # not of NaN
        table.refuse(wrong, lambda row: f"found a quaternion of length {length[row]:.4g}, expected 1")
        turned = Rotation.from_quat(values[whole], scalar_first=True)
    else:
        turned = Rotation.from_euler(ANGLES[found[0]], values[whole], degrees=True)
    result[whole] = turned.as_rotvec()
    return result


def _read_vectors(table: Table) -> Array:
    values = np.full((len(table.rows), 3), np.nan)
    there = [k for k, name in enumerate(VECTOR) if name in table.columns]
    values[:, there] = table.numbers([VECTOR[k] for k in there], gaps=True)
    largest = np.nanmax(np.abs(values), axis=1, initial=0.0)
    table.refuse(
        largest > 180.0,
        lambda row: (
            f"found a rotation vector of {largest[row]:g} deg, expected at most 180 deg; angles about axes one after "
            f"the other have other columns, such as {', '.join(ROLL_PITCH_YAW)}"
        ),
    )
    return np.radians(values)
