"""A table of measured poses, whole or in part, with their covariances.

One row a pose: position in mm and rotation vector in degrees, as `bayescal poses-from-targets` writes them, or another
form of rotation that `rotations` knows; covariance in µm and µrad, or standard deviations. What was not measured is a
column that is missing or a cell that is empty.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.data.actuators import name_actuators
from bayescal.data.instruments.poses import COORDINATES, PoseReadings
from bayescal.data.instruments.rotations import OTHER_COLUMNS, VECTOR, read_rotation_vectors
from bayescal.data.instruments.tables import (
    Taken,
    check_positive,
    choose_noise,
    describe_no_noise,
    name_covariances,
    read_covariances,
    read_taken,
)
from bayescal.errors import InputError
from bayescal.files.atomic import read_text
from bayescal.files.csv_tables import Table, read_table
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE, MICRORADIAN

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


def read_poses(path: Path, actuators: Path | None, noise: PoseNoise, n_legs: int) -> tuple[PoseReadings, Taken]:
    """Return measured poses, and when they were taken.

    Raises
    ------
    InputError
        For unknown columns, a pose without any coordinate, a covariance that is not positive, noise that is stated
        twice or not at all, and what `read_taken` refuses.
    """
    table = _read_columns(path, name_actuators(n_legs))
    taken = read_taken(table, actuators, n_legs)
    values = _read_values(table)
    covariance = read_noise(table, noise, np.isfinite(values))
    check_positive(table, covariance, np.isfinite(values))
    return PoseReadings(taken.names, taken.actuators, values, covariance * np.outer(UNITS, UNITS)), taken


def _read_columns(path: Path, actuators: tuple[str, ...]) -> Table:
    upper, lower = name_covariances(COORDINATES)
    return read_table(path, ("pose",), ("use", *VALUES, *DEVIATIONS, *upper, *lower, *actuators, *OTHER_COLUMNS))


def check_pose_table(path: Path, noise: PoseNoise, actuators: tuple[str, ...]) -> None:
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


def _read_values(table: Table) -> Array:
    """Return positions (mm) and rotation vectors (rad), shape (P, 6), NaN where not measured."""
    position = np.full((len(table.rows), len(POSITION)), np.nan)
    there = [k for k, name in enumerate(POSITION) if name in table.columns]
    if not there and not any(name in table.columns for name in (*VECTOR, *OTHER_COLUMNS)):
        raise InputError(f"{table.path}: found no coordinate, expected some of the columns {', '.join(VALUES)}")
    if there:
        position[:, there] = table.numbers([POSITION[k] for k in there], gaps=True)
    values = np.concatenate([position, read_rotation_vectors(table)], axis=1)
    table.refuse(~np.isfinite(values).any(axis=1), lambda _: "found no coordinate, expected one at least")
    return values


def read_noise(table: Table, noise: PoseNoise, measured: np.ndarray) -> Array:
    """Return the covariances (P, 6, 6) in µm and µrad."""
    covariance = read_covariances(table, COORDINATES, measured)
    deviations = [k for k, name in enumerate(DEVIATIONS) if name in table.columns]
    if covariance is not None and deviations:
        raise InputError(f"{table.path}: found standard deviations beside covariances, expected either")
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
    table.refuse(missing, lambda _, k: f"{VALUES[k]}: found no {names[k]}, expected its noise")
    table.refuse(measured & ~(sd > 0.0), lambda row, k: f"{names[k]}: found {sd[row, k]:g}, expected above 0")
    sd = np.where(measured, sd, 1.0)
    result: Array = np.eye(len(VALUES)) * sd[:, None, :] ** 2
    return result
