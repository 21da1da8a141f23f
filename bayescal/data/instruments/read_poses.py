"""Tables of measured poses, whole or in part, with their covariances, and what tables of all instruments share.

One row a pose: position in mm and rotation vector in degrees, as `bayescal poses-from-targets` writes them, or another
form of rotation; covariance in µm and µrad, or standard deviations. What was not measured is a
column that is missing or a cell that is empty.

A turn of the platform out of the base's axes, R, takes coordinates on the platform to base axes. It is read from

- ``rx_deg, ry_deg, rz_deg``: the rotation vector, axis times angle; alone these may be measured in part;
- ``qw, qx, qy, qz``: the unit quaternion;
- ``r11, r12 ... r33``: R row by row;
- ``roll_deg, pitch_deg, yaw_deg``: R = Rz(yaw) Ry(pitch) Rx(roll), about the fixed axes x, y, z one after the other;
- ``xyz_1_deg, xyz_2_deg, xyz_3_deg``: three angles in any order of axes, by the letters as `scipy.spatial.transform`
  takes them: small ones about the fixed axes, capital ones about axes that turn along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.data.actuators import Columns, check_calibration, read_actuators, read_positions, read_uses
from bayescal.data.instruments.readings import TrackedPoses
from bayescal.errors import InputError
from bayescal.files.atomic import read_text
from bayescal.files.csv_tables import CsvTable, read_table
from bayescal.machines.readings import POSE
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE, MICRORADIAN

LEAST_EIGENVALUE = 1e-12  # of a correlation matrix
ASYMMETRY = 1e-6


@dataclass(frozen=True, eq=False)
class PoseRecords:
    """When readings were taken: names of P poses, which are for verification (P,), actuator positions (P, N)."""

    names: tuple[str, ...]
    verification: np.ndarray
    actuators: Array


def read_taken(table: CsvTable, path: Path | None, columns: Columns) -> PoseRecords:
    """Return the poses of a table that has a row for each, with actuator positions from it or from a table beside it.

    Without columns of actuators there are none.

    InputError for a pose that stands in one table only or twice, two tables with actuator positions or uses that
    differ, or none.
    """
    names = table.text("pose")
    table.check_unique([(name,) for name in names], "pose")
    listed = list(columns)
    own = table.has(listed)
    if own and path is not None:
        raise InputError(f"{table.path}: found actuator positions also in {path}, expected them once")
    if listed and not own and path is None:
        raise InputError(
            f"{table.path}: found no columns {listed[0]} to {listed[-1]}, expected them, or data.actuators"
        )
    uses = read_uses(table) if "use" in table.columns else None
    if path is None:
        uses = np.zeros(len(names), dtype=bool) if uses is None else uses
        check_calibration(table.path, uses)
        return PoseRecords(tuple(names), uses, read_positions(table, columns))
    known, verification, positions = read_actuators(path, columns)
    check_same_poses(table, names, known, path)
    places = {name: k for k, name in enumerate(known)}
    order = [places[name] for name in names]
    for row, k in enumerate(order):
        if uses is not None and uses[row] != verification[k]:
            raise InputError(f"{table.where(row)}: {table.name('use')}: differs from {path}, expected the same")
    check_calibration(path, verification)
    return PoseRecords(tuple(names), verification[order], positions[order])


def check_same_poses(table: CsvTable, names: Sequence[str], known: Sequence[str], path: Path) -> None:
    """Raise InputError where a table has a pose that the actuators' has not, or lacks one."""
    there, listed = set(names), set(known)
    for row, name in enumerate(names):
        if name not in listed:
            raise InputError(f"{table.where(row)}: pose {name!r}: not in {path}")
    for name in known:
        if name not in there:
            raise InputError(f"{table.path}: found nothing of pose {name!r}, which {path} lists")


# --- noise -------------------------------------------------------------------------------------------------------


def name_covariances(components: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the columns of a covariance: of the upper triangle, and of the rest of the matrix."""
    pairs = [(i, j) for i in range(len(components)) for j in range(len(components))]
    upper = tuple(f"cov_{components[i]}_{components[j]}" for i, j in pairs if i <= j)
    return upper, tuple(f"cov_{components[i]}_{components[j]}" for i, j in pairs if i > j)


def read_covariances(table: CsvTable, components: Sequence[str], measured: np.ndarray) -> Array | None:
    """Return the covariances (rows, n, n) in a table's units; None where it has none.

    Entries of what was not measured may be empty, and do not count. InputError for a matrix that is not symmetric,
    lacks an entry that counts or is not positive definite.
    """
    upper, _ = name_covariances(components)
    there = [name for name in upper if name in table.columns]
    if not there:
        return None
    n = len(components)
    result = np.full((len(table.rows), n, n), np.nan)
    for i, one in enumerate(components):
        for j, other in enumerate(components):
            name = f"cov_{one}_{other}"
            if name in table.columns:
                result[:, i, j] = table.numbers([name], gaps=True)[:, 0]
    mirrored, variance = np.swapaxes(result, -1, -2), np.diagonal(result, axis1=-2, axis2=-1)
    size = np.sqrt(np.abs(variance[..., :, None] * variance[..., None, :]))
    unlike = np.abs(result - mirrored) > ASYMMETRY * size  # never where one is missing
    table.refuse(
        unlike,
        lambda row, i, j: (
            f"{table.name(f'cov_{components[i]}_{components[j]}')}: found {result[row, i, j]:g}, "
            f"expected {result[row, j, i]:g} as {table.name(f'cov_{components[j]}_{components[i]}')}"
        ),
    )
    result = np.where(np.isfinite(result), result, mirrored)
    table.refuse(
        measured[:, :, None] & measured[:, None, :] & ~np.isfinite(result),
        lambda _, i, j: (
            f"{table.name(f'cov_{components[min(i, j)]}_{components[max(i, j)]}')}: found nothing, expected a number"
        ),
    )
    return result


def check_positive(table: CsvTable, covariance: Array, measured: np.ndarray) -> None:
    """Raise InputError for the first row whose covariance (rows, n, n) of what was measured is not positive."""
    for row, (matrix, chosen) in enumerate(zip(covariance, measured, strict=True)):
        part = matrix[np.ix_(chosen, chosen)]
        variance = np.diagonal(part)
        if not (variance > 0.0).all():
            raise InputError(f"{table.where(row)}: covariance: found variance {variance.min():g}, expected > 0")
        scale = np.sqrt(variance)
        if len(part) and np.linalg.eigvalsh(part / np.outer(scale, scale))[0] < LEAST_EIGENVALUE:
            raise InputError(f"{table.where(row)}: covariance: found an indefinite matrix, expected positive definite")


def choose_noise(path: Path, in_table: bool, in_config: bool, columns: str, keys: str) -> None:
    """Raise InputError where the noise is stated neither in the table nor in the config, or in both."""
    if in_table and in_config:
        raise InputError(f"{path}: found noise columns and {keys} in [[data]], expected either")
    if not in_table and not in_config:
        raise InputError(describe_no_noise(path, columns, keys))


def describe_no_noise(path: Path, columns: str, keys: str) -> str:
    """Return that the noise is stated neither in a table nor in the config."""
    return f"{path}: found no noise, expected columns {columns}, or {keys} in [[data]]"


VECTOR = ("rx_deg", "ry_deg", "rz_deg")
QUATERNION = ("qw", "qx", "qy", "qz")
MATRIX = tuple(f"r{i}{j}" for i in range(1, 4) for j in range(1, 4))
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
ORTHONORMAL = 3e-3
"""How far the products of a matrix's columns may be from those of unit axes: the same."""


def name_angles(sequence: str) -> tuple[str, str, str]:
    """Return the columns of three angles about these axes."""
    return (f"{sequence}_1_deg", f"{sequence}_2_deg", f"{sequence}_3_deg")


ANGLES: dict[tuple[str, ...], str] = {ROLL_PITCH_YAW: FIXED, **{name_angles(one): one for one in SEQUENCES}}
OTHER_COLUMNS = (*QUATERNION, *MATRIX, *(name for names in ANGLES for name in names))
"""Those that a table may have instead of a rotation vector's."""


def read_rotation_vectors(table: CsvTable, prefix: str = "") -> Array:
    """Return rotation vectors in rad, shape (P, 3), of the form the table has; NaN where not measured.

    Columns begin with a prefix; angles may be in another unit. InputError for two forms in one table, one that is there
    in part, a quaternion far from length one, a matrix that is no rotation, a rotation vector longer than half a turn,
    or angles beyond a whole one.
    """
    forms = {tuple(f"{prefix}{name}" for name in names): names for names in (VECTOR, QUATERNION, MATRIX, *ANGLES)}
    table = table.convert([one for names in forms for one in names])
    found = [names for names in forms if any(name in table.columns for name in names)]
    if len(found) > 1:
        first, second = (next(name for name in names if name in table.columns) for names in found[:2])
        raise InputError(f"{table.path}: found {first!r} and {second!r}, expected one rotation form")
    if not found:
        return np.full((len(table.rows), 3), np.nan)
    form = forms[found[0]]
    if form == VECTOR:
        return _read_vectors(table, found[0])
    table.has(found[0])
    values = table.numbers(found[0], gaps=True)
    there = np.isfinite(values)
    whole = there.all(axis=1)
    text = f"found part of a rotation, expected {', '.join(map(table.name, found[0]))} or none"
    table.refuse(there.any(axis=1) & ~whole, lambda _: text)
    result = np.full((len(values), 3), np.nan)
    if form == QUATERNION:
        length = np.linalg.norm(values, axis=1)
        wrong = np.abs(length - 1.0) > UNIT_LENGTH  # not of NaN
        table.refuse(wrong, lambda row: f"found a quaternion of length {length[row]:.4g}, expected 1")
        turned = Rotation.from_quat(values[whole], scalar_first=True)
    elif form == MATRIX:
        matrix = values.reshape(-1, 3, 3)
        determinant = np.linalg.det(np.where(whole[:, None, None], matrix, np.eye(3)))
        table.refuse(
            determinant < 0.0,
            lambda row: (
                f"found a matrix of determinant {determinant[row]:.3g}, expected 1: mirrored, left-handed axes?"
            ),
        )
        off = np.abs(np.swapaxes(matrix, 1, 2) @ matrix - np.eye(3)).max(axis=(1, 2))
        table.refuse(
            off > ORTHONORMAL,
            lambda row: f"found a matrix whose columns are off unit axes by {off[row]:.3g}, expected a rotation",
        )
        turned = Rotation.from_matrix(matrix[whole])
    else:
        table.refuse_beyond(found[0], values, 360.0, hint=_doubt_radians(table, found[0]))
        turned = Rotation.from_euler(ANGLES[form], values[whole], degrees=True)
    result[whole] = turned.as_rotvec()
    return result


def _doubt_radians(table: CsvTable, names: Sequence[str]) -> str:
    """Return what may be wrong with angles that are too large, where the file's unit is larger than degrees."""
    return "; degrees in columns of radians?" if any(table.written_as(one).size > 1.0 for one in names) else ""


def _read_vectors(table: CsvTable, names: Sequence[str]) -> Array:
    values = np.full((len(table.rows), 3), np.nan)
    there = [k for k, name in enumerate(names) if name in table.columns]
    values[:, there] = table.numbers([names[k] for k in there], gaps=True)
    hint = f"; other angles have columns such as {', '.join(ROLL_PITCH_YAW)}{_doubt_radians(table, names)}"
    table.refuse_beyond(names, values, 180.0, "a rotation vector of ", hint)
    return np.radians(values)


POSITION = ("x_mm", "y_mm", "z_mm")
VALUES = (*POSITION, *VECTOR)
DEVIATIONS = ("sd_x_um", "sd_y_um", "sd_z_um", "sd_rx_urad", "sd_ry_urad", "sd_rz_urad")
UNITS = np.array([MICROMETRE] * 3 + [MICRORADIAN] * 3)
COLUMNS = "cov_x_x ... cov_rz_rz or sd_x_um ... sd_rz_urad"
KEYS = "position_um and orientation_arcsec (or orientation_urad)"


@dataclass(frozen=True)
class PoseNoise:
    """Standard deviations of all positions (µm) and orientations (arcsec), where the table does not state them."""

    position_um: float | None = None
    orientation_arcsec: float | None = None

    @property
    def is_stated(self) -> bool:
        """Whether there is any."""
        return self.position_um is not None or self.orientation_arcsec is not None


def read_poses(
    path: Path, actuators: Path | None, noise: PoseNoise, columns: Columns
) -> tuple[TrackedPoses, PoseRecords]:
    """Return measured poses, and when they were taken, with actuator positions of these columns.

    InputError for unknown columns, a pose without any coordinate, a covariance that is not positive, noise that is
    stated twice or not at all, and what `read_taken` refuses.
    """
    table = _read_columns(path, columns)
    taken = read_taken(table, actuators, columns)
    values = _read_values(table)
    covariance = read_noise(table, noise, np.isfinite(values))
    check_positive(table, covariance, np.isfinite(values))
    return TrackedPoses(taken.names, taken.actuators, values, covariance * np.outer(UNITS, UNITS)), taken


def _read_columns(path: Path, actuators: Columns) -> CsvTable:
    upper, lower = name_covariances(POSE)
    return read_table(path, ("pose",), ("use", *VALUES, *DEVIATIONS, *upper, *lower, *actuators, *OTHER_COLUMNS))


def check_pose_table(path: Path, noise: PoseNoise, actuators: Columns) -> None:
    """Raise InputError for a table of poses that is none by itself, with all that is wrong with values and noise."""
    try:
        table = _read_columns(path, actuators)
    except InputError as error:
        if noise.is_stated or any(mark in read_text(path, "a CSV table") for mark in ("sd_", "cov_")):
            raise
        raise InputError(str(error), (*error.others, describe_no_noise(path, COLUMNS, KEYS))) from error
    values = _read_values(table)
    covariance = read_noise(table, noise, np.isfinite(values))
    check_positive(table, covariance, np.isfinite(values))


def _read_values(table: CsvTable) -> Array:
    """Return positions (mm) and rotation vectors (rad), shape (P, 6), NaN where not measured."""
    position = np.full((len(table.rows), len(POSITION)), np.nan)
    there = [k for k, name in enumerate(POSITION) if name in table.columns]
    if not there and not any(name in table.columns for name in (*VECTOR, *OTHER_COLUMNS)):
        raise InputError(f"{table.path}: found no coordinate, expected one of {', '.join(VALUES)}")
    if there:
        position[:, there] = table.numbers([POSITION[k] for k in there], gaps=True)
    values = np.concatenate([position, read_rotation_vectors(table)], axis=1)
    table.refuse(~np.isfinite(values).any(axis=1), lambda _: "found no coordinate, expected one")
    return values


def read_noise(table: CsvTable, noise: PoseNoise, measured: np.ndarray) -> Array:
    """Return the covariances (P, 6, 6) in µm and µrad."""
    covariance = read_covariances(table, POSE, measured)
    deviations = [k for k, name in enumerate(DEVIATIONS) if name in table.columns]
    if covariance is not None and deviations:
        raise InputError(f"{table.path}: found standard deviations and covariances, expected either")
    stated = covariance is not None or bool(deviations)
    choose_noise(table.path, stated, noise.is_stated, COLUMNS, KEYS)
    if covariance is not None:
        return covariance
    sd = np.full(measured.shape, np.nan)
    if deviations:
        sd[:, deviations] = table.numbers([DEVIATIONS[k] for k in deviations], gaps=True)
        names = DEVIATIONS
    else:
        if noise.position_um is not None:
            sd[:, :3] = noise.position_um
        if noise.orientation_arcsec is not None:
            sd[:, 3:] = noise.orientation_arcsec * ARCSECOND / MICRORADIAN
        names = ("position_um",) * 3 + ("orientation_arcsec",) * 3
    missing = measured & ~np.isfinite(sd)
    table.refuse(missing, lambda _, k: f"{table.name(VALUES[k])}: found no {table.name(names[k])}, expected its noise")
    table.refuse_values(names, sd, measured & ~(sd > 0.0), "expected above 0")
    sd = np.where(measured, sd, 1.0)
    result: Array = np.eye(len(VALUES)) * sd[:, None, :] ** 2
    return result
