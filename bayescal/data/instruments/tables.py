"""What tables of all instruments share: poses beside their actuator positions, noise stated once, covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.data.actuators import check_calibration, name_actuators, read_actuators, read_uses
from bayescal.errors import InputError
from bayescal.files.csv_tables import Table
from bayescal.numerics.geometry import Array

LEAST_EIGENVALUE = 1e-12  # of a correlation matrix
ASYMMETRY = 1e-6


@dataclass(frozen=True, eq=False)
class Taken:
    """When readings were taken: names of P poses, which are for verification (P,), actuator positions (P, N), mm."""

    names: tuple[str, ...]
    verification: np.ndarray
    actuators: Array


def read_taken(table: Table, path: Path | None, n_legs: int) -> Taken:
    """Return the poses of a table that has a row for each, with actuator positions from it or from a table beside it.

    Raises
    ------
    InputError
        For a pose that stands in one table only or twice, two tables with actuator positions or uses that differ, or
        none.
    """
    names = table.text("pose")
    table.check_unique([(name,) for name in names], "pose")
    columns = name_actuators(n_legs)
    own = table.has(columns)
    if own and path is not None:
        raise InputError(f"{table.path}: found actuator positions beside those of {path}, expected them once")
    if not own and path is None:
        raise InputError(
            f"{table.path}: found no columns {columns[0]} to {columns[-1]} and no data.actuators, expected either"
        )
    uses = read_uses(table) if "use" in table.columns else None
    if path is None:
        if uses is None:
            raise InputError(f"{table.path}: found no column 'use', expected it beside the actuator positions")
        check_calibration(table.path, uses)
        return Taken(tuple(names), uses, table.numbers(columns))
    known, verification, positions = read_actuators(path, n_legs)
    check_same_poses(table, names, known, path)
    order = [known.index(name) for name in names]
    for row, k in enumerate(order):
        if uses is not None and uses[row] != verification[k]:
            raise InputError(f"{table.where(row)}: use: found another than in {path}, expected the same")
    check_calibration(path, verification)
    return Taken(tuple(names), verification[order], positions[order])


def check_same_poses(table: Table, names: Sequence[str], known: Sequence[str], path: Path) -> None:
    """Raise InputError where a table has a pose that the actuators' has not, or lacks one."""
    for row, name in enumerate(names):
        if name not in known:
            raise InputError(f"{table.where(row)}: pose {name!r} is not in {path}, expected it there")
    there = set(names)
    for name in known:
        if name not in there:
            raise InputError(f"{table.path}: found nothing of pose {name!r}, which {path} lists")


# --- noise -------------------------------------------------------------------------------------------------------


def name_covariances(components: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the columns of a covariance: of the upper triangle, and of the rest of the matrix."""
    pairs = [(i, j) for i in range(len(components)) for j in range(len(components))]
    upper = tuple(f"cov_{components[i]}_{components[j]}" for i, j in pairs if i <= j)
    return upper, tuple(f"cov_{components[i]}_{components[j]}" for i, j in pairs if i > j)


def read_covariances(table: Table, components: Sequence[str], measured: np.ndarray) -> Array | None:
    """Return the covariances (rows, n, n) in a table's units; None where it has none.

    Entries of what was not measured may be empty, and do not count.

    Raises
    ------
    InputError
        For a matrix that is not symmetric, lacks an entry that counts or is not positive definite.
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
    mirrored = np.swapaxes(result, -1, -2)
    unlike = np.abs(result - mirrored) > ASYMMETRY * np.sqrt(np.abs(_products(result)))  # never where one is missing
    table.refuse(
        unlike,
        lambda row, i, j: (
            f"cov_{components[i]}_{components[j]}: found {result[row, i, j]:g}, "
            f"expected {result[row, j, i]:g} as cov_{components[j]}_{components[i]}"
        ),
    )
    result = np.where(np.isfinite(result), result, mirrored)
    _check_complete(table, components, measured, result)
    return result


def _products(covariance: Array) -> Array:
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    return variance[..., :, None] * variance[..., None, :]


def _check_complete(table: Table, components: Sequence[str], measured: np.ndarray, covariance: Array) -> None:
    missing = measured[:, :, None] & measured[:, None, :] & ~np.isfinite(covariance)
    table.refuse(
        missing,
        lambda _, i, j: (
            f"cov_{components[min(i, j)]}_{components[max(i, j)]}: found nothing, expected a number, since both were "
            "measured"
        ),
    )


def check_positive(table: Table, covariance: Array, measured: np.ndarray) -> None:
    """Raise InputError for the first row whose covariance (rows, n, n) of what was measured is not positive."""
    for row, (matrix, chosen) in enumerate(zip(covariance, measured, strict=True)):
        part = matrix[np.ix_(chosen, chosen)]
        variance = np.diagonal(part)
        if not (variance > 0.0).all():
            raise InputError(
                f"{table.where(row)}: covariance: found a variance of {variance.min():g}, expected above 0"
            )
        scale = np.sqrt(variance)
        if len(part) and np.linalg.eigvalsh(part / np.outer(scale, scale))[0] < LEAST_EIGENVALUE:
            raise InputError(
                f"{table.where(row)}: covariance: found a matrix that is not positive definite, expected one that is"
            )


def choose_noise(path: Path, in_table: bool, in_config: bool, columns: str, keys: str) -> None:
    """Raise InputError where the noise is stated neither in the table nor in the config, or in both."""
    if in_table and in_config:
        raise InputError(f"{path}: found columns of the noise beside {keys} in [data], expected it stated once")
    if not in_table and not in_config:
        raise InputError(describe_no_noise(path, columns, keys))


def describe_no_noise(path: Path, columns: str, keys: str) -> str:
    """Return that the noise is stated neither in a table nor in the config."""
    return f"{path}: found no noise, expected the columns {columns}, or {keys} in [data]"
