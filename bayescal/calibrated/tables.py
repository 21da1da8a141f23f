"""Tables of commanded poses and actuator positions as they are read, and of what the machine makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.predict import Command, PosePrediction
from bayescal.data.actuators import check_range, name_actuators
from bayescal.data.instruments.poses import COORDINATES
from bayescal.data.instruments.read_poses import DEVIATIONS, POSITION, VALUES
from bayescal.data.instruments.rotations import OTHER_COLUMNS, VECTOR, read_rotation_vectors
from bayescal.data.instruments.tables import name_covariances
from bayescal.errors import InputError, name_faults
from bayescal.files.csv_tables import Table, format_table, read_table
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector, rotation_vector_from_matrix
from bayescal.numerics.units import MICROMETRE, MICRORADIAN

REACHED = "reached"
NAMED = 12
"""Poses out of reach that a message names."""
TO_FILE = np.array([1 / MICROMETRE] * 3 + [1 / MICRORADIAN] * 3)


@dataclass(frozen=True, eq=False)
class Commanded:
    """Poses to be taken: their table, names (P), positions (P, 3) in mm and rotations (P, 3, 3), base frame."""

    table: Table
    names: tuple[str, ...]
    position: Array
    rotation: Array


def read_commanded(path: Path, n_legs: int) -> Commanded:
    """Return the poses of a table: position in mm, rotation in any form; what else is measured is passed over.

    Raises
    ------
    InputError
        For a missing column, a cell that is no number, or a pose that stands twice.
    """
    upper, lower = name_covariances(COORDINATES)
    others = ("use", *DEVIATIONS, *upper, *lower, *name_actuators(n_legs))
    table = read_table(path, ("pose", *POSITION), (*VECTOR, *OTHER_COLUMNS, *others))
    names = _read_names(table)
    turn = read_rotation_vectors(table)
    if not np.isfinite(turn).all():
        row = int(np.argmax(~np.isfinite(turn).all(axis=1)))
        raise InputError(f"{table.where(row)}: found no whole rotation, expected {', '.join(VECTOR)}")
    return Commanded(table, names, table.numbers(POSITION), matrix_from_rotation_vector(turn))


def read_positions(path: Path, calibrated: CalibratedMachine) -> tuple[tuple[str, ...], Array]:
    """Return names (P) and actuator positions (P, N) in mm of a table; InputError where they are out of range."""
    mechanism = calibrated.machine.mechanism
    columns = name_actuators(mechanism.n_legs)
    table = read_table(path, ("pose", *columns), ("use", REACHED, *_name_deviations(mechanism.n_legs)))
    names, actuators = _read_names(table), table.numbers(columns)
    with name_faults(path):
        check_range(actuators, mechanism.initial_actuator_positions, mechanism.actuator_range, names)
    return names, actuators


def _name_deviations(n_legs: int) -> tuple[str, ...]:
    return tuple(f"sd_rho_{leg}_um" for leg in range(1, n_legs + 1))


def _read_names(table: Table) -> tuple[str, ...]:
    names = table.text("pose")
    table.check_unique([(name,) for name in names], "pose")
    return tuple(names)


def check_reached(commanded: Commanded, command: Command) -> None:
    """Raise InputError that names the poses out of reach, with their lines."""
    lost = [k for k, fault in enumerate(command.faults) if fault]
    if not lost:
        return
    lines, names = commanded.table.lines, commanded.names
    told = [f"line {lines[k]}, pose {names[k]!r}: {command.faults[k]}" for k in lost[:NAMED]]
    more = f"; and {len(lost) - NAMED} more" if len(lost) > NAMED else ""
    raise InputError(
        f"{commanded.table.path}: found {len(lost)} of {len(names)} poses out of reach, expected none, or --mark: "
        f"{'; '.join(told)}{more}"
    )


def check_found(path: Path, names: Sequence[str], prediction: PosePrediction) -> None:
    """Raise InputError that names the actuator positions at which the machine has no pose."""
    lost = [repr(name) for name, found in zip(names, prediction.found, strict=True) if not found]
    if lost:
        more = f" and {len(lost) - NAMED} more" if len(lost) > NAMED else ""
        raise InputError(
            f"{path}: found no pose of the machine at {', '.join(lost[:NAMED])}{more}, expected actuator "
            "positions that close on home's branch"
        )


def format_command(calibrated: CalibratedMachine, names: Sequence[str], command: Command) -> str:
    """Return actuator positions in mm as CSV text, with standard deviations in µm, and which poses are out of reach."""
    positions = name_actuators(calibrated.n_legs)
    deviations = _name_deviations(calibrated.n_legs)
    sd = np.full(command.actuators.shape, np.nan) if command.sd is None else command.sd / MICROMETRE
    rows = [
        (name, _quote(fault) or "yes", *_format_cells(rho, ".9f", fault), *_format_cells(spread, ".6g", fault))
        for name, fault, rho, spread in zip(names, command.faults, command.actuators, sd, strict=True)
    ]
    comments = [
        *calibrated.source.describe(),
        "Actuator positions that hold the poses: posterior mean in mm, standard deviation in µm of all but the",
        "actuators' own control: geometry, errors of the legs, noise of the actuators' readings.",
    ]
    return format_table(comments, ["pose", REACHED, *positions, *deviations], rows)


def format_prediction(calibrated: CalibratedMachine, names: Sequence[str], prediction: PosePrediction) -> str:
    """Return poses as CSV text as `bayescal poses-from-targets` writes them: mm and degrees, covariance in µm, µrad."""
    upper, _ = name_covariances(COORDINATES)
    pairs = np.triu_indices(6)
    columns, values = ["pose", *VALUES], _list_values(prediction.position, prediction.rotation)
    rows: list[tuple[str, ...]] = [(name, *row) for name, row in zip(names, values, strict=True)]
    if prediction.covariance is not None:
        columns += upper
        scaled = (prediction.covariance * np.outer(TO_FILE, TO_FILE))[:, pairs[0], pairs[1]]
        rows = [(*row, *(f"{c:.8g}" for c in cells)) for row, cells in zip(rows, scaled, strict=True)]
    comments = [
        *calibrated.source.describe(),
        "Predicted pose of the platform frame in the base frame; position in mm, rotation vector in degrees.",
        "cov: covariance of position (µm) and of the rotation vector (µrad) about the base axes: geometry, errors of",
        "the legs, noise of the actuators' readings.",
    ]
    return format_table(comments, columns, rows)


def format_draws(calibrated: CalibratedMachine, names: Sequence[str], position: Array, rotation: Array) -> str:
    """Return drawn poses (S, P, ...) as CSV text, a row for each draw of each pose."""
    rows: list[tuple[object, ...]] = []
    for draw, (p, r) in enumerate(zip(position, rotation, strict=True), start=1):
        rows += [(name, draw, *row) for name, row in zip(names, _list_values(p, r), strict=True)]
    comments = [
        *calibrated.source.describe(),
        "Poses by draws of the posterior; position in mm, rotation vector in degrees.",
    ]
    return format_table(comments, ["pose", "draw", *VALUES], rows)


def _list_values(position: Array, rotation: Array) -> list[list[str]]:
    angles = np.degrees(rotation_vector_from_matrix(rotation))
    return [[f"{x:.9f}" for x in p] + [f"{x:.10f}" for x in a] for p, a in zip(position, angles, strict=True)]


def _format_cells(values: Array, digits: str, fault: str) -> list[str]:
    """Return cells, empty ones where there is nothing to be had."""
    return ["" if fault or not np.isfinite(value) else format(value, digits) for value in values]


def _quote(text: str) -> str:
    return f'"{text}"' if "," in text else text
