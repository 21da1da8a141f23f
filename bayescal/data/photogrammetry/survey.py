"""A photogrammetry survey as files hold it: targets on two bodies at many poses, and the actuators' positions.

Three CSV tables: the targets as measured, pose by pose, each pose in a measurement frame of its own; the actuator
positions; and where each target sits on its body.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.data.actuators import Columns, check_calibration, read_actuators
from bayescal.data.photogrammetry.rigid_fit import is_collinear
from bayescal.errors import InputError, say_unknown
from bayescal.files.csv_tables import CsvTable, read_table
from bayescal.numerics.geometry import Array

TARGET_COLUMNS = ("pose", "body", "target", "x_mm", "y_mm", "z_mm")
REFERENCE_COLUMNS = ("body", "target", "leg", "x_mm", "y_mm", "z_mm")
COORDINATES = ("x_mm", "y_mm", "z_mm")
BODIES = ("base", "platform")
MIN_TARGETS = 3
COLLINEAR = 1e-3  # largest ratio of the second to the first extent of targets that count as a line


@dataclass(frozen=True, eq=False)
class BodyTargets:
    """Targets of one body."""

    names: tuple[str, ...]  # the n targets
    leg: np.ndarray  # (n,): leg whose pad carries the target, counted from one; zero on the rigid part of the body
    reference: Array  # (n, 3): where the targets sit on the undeformed body, body frame, mm
    # (P, n, 3): measured coordinates, measurement frame of each pose, mm; NaN where a target was not seen
    measured: Array


@dataclass(frozen=True, eq=False)
class Survey:
    """Targets and actuator positions of all poses."""

    poses: tuple[str, ...]  # names of the P poses, in the order of the actuator table
    verification: np.ndarray  # (P,): which poses are kept for verification
    actuators: Array  # (P, N): actuator positions, mm
    base: BodyTargets
    platform: BodyTargets


def read_survey(targets: Path, actuators: Path, reference: Path, columns: Columns, n_legs: int | None = None) -> Survey:
    """Read and check a survey, with actuator positions of these columns; pads are of N legs, by default a column each.

    InputError for unknown columns, numbers that are none or not finite, duplicate or missing poses and targets, targets
    without a reference, fewer than three or collinear rigid targets on a body, legs that do not exist.
    """
    poses, verification, positions = read_actuators(actuators, columns)
    known = read_reference(reference, len(columns) if n_legs is None else n_legs)
    measured = _read_targets(read_table(targets, TARGET_COLUMNS), poses, known, actuators, reference)
    bodies = {}
    for body in BODIES:
        names, legs, points = known[body]
        bodies[body] = BodyTargets(tuple(names), legs, points, measured[body])
        _check_seen(bodies[body], body, poses, targets)
    check_calibration(actuators, verification)
    return Survey(tuple(poses), verification, positions, bodies["base"], bodies["platform"])


def check_target_columns(path: Path) -> None:
    """Raise InputError for a table of targets without its columns, or with a coordinate that is no number."""
    read_table(path, TARGET_COLUMNS).numbers(COORDINATES)


def read_reference(path: Path, n_legs: int) -> dict[str, tuple[list[str], np.ndarray, Array]]:
    """Return names, legs (n,) and places (n, 3), mm, of the targets of each body; see `read_survey`."""
    table = read_table(path, REFERENCE_COLUMNS)
    bodies, names = table.text("body"), table.text("target")
    table.check_unique(list(zip(bodies, names, strict=True)), "target")
    legs, points = table.numbers(["leg"])[:, 0], table.numbers(COORDINATES)
    for row, (body, leg) in enumerate(zip(bodies, legs, strict=True)):
        if body not in BODIES:
            raise InputError(say_unknown(f"{table.where(row)}: body", body, BODIES))
        if leg not in range(n_legs + 1) or (leg and body == "base"):
            allowed = f"0 to {n_legs}" if body == "platform" else "0 on the base"
            raise InputError(f"{table.where(row)}: {table.name('leg')}: found {leg:g}, expected {allowed}")
    result = {}
    for body in BODIES:
        chosen = np.array([b == body for b in bodies])
        rigid = points[chosen & (legs == 0)]
        if len(rigid) < MIN_TARGETS:
            found = f"{len(rigid)} rigid targets on the {body}"
            raise InputError(f"{path}: found {found}, expected at least {MIN_TARGETS}")
        if is_collinear(rigid, COLLINEAR):
            raise InputError(f"{path}: rigid targets of the {body} lie on a line, expected them spread out")
        result[body] = ([n for n, c in zip(names, chosen, strict=True) if c], legs[chosen].astype(int), points[chosen])
    return result


def _read_targets(
    table: CsvTable,
    poses: list[str],
    known: dict[str, tuple[list[str], np.ndarray, Array]],
    actuators: Path,
    reference: Path,
) -> dict[str, Array]:
    columns = [table.text(column) for column in ("pose", "body", "target")]
    table.check_unique(list(zip(*columns, strict=True)), "pose/body/target")
    points = table.numbers(COORDINATES)
    pose_index = {pose: k for k, pose in enumerate(poses)}
    target_index = {body: {name: k for k, name in enumerate(known[body][0])} for body in BODIES}
    measured = {body: np.full((len(poses), len(known[body][0]), 3), np.nan) for body in BODIES}
    for row, (pose, body, target) in enumerate(zip(*columns, strict=True)):
        if pose not in pose_index:
            raise InputError(f"{table.where(row)}: pose {pose!r}: not in {actuators}")
        if body not in BODIES:
            raise InputError(say_unknown(f"{table.where(row)}: body", body, BODIES))
        if target not in target_index[body]:
            raise InputError(f"{table.where(row)}: {body} target {target!r}: not in {reference}")
        measured[body][pose_index[pose], target_index[body][target]] = points[row]
    found = set(columns[0])
    for pose in poses:
        if pose not in found:
            raise InputError(f"{table.path}: found no targets of pose {pose!r}, expected them by {actuators}")
    return measured


def _check_seen(body: BodyTargets, name: str, poses: list[str], path: Path) -> None:
    rigid = body.leg == 0
    seen = np.isfinite(body.measured[..., 0]) & rigid
    for pose, visible in zip(poses, seen, strict=True):
        if visible.sum() < MIN_TARGETS:
            found = f"{visible.sum()} rigid targets on the {name}"
            raise InputError(f"{path}: pose {pose!r}: found {found}, expected at least {MIN_TARGETS}")
        if is_collinear(body.reference[visible], COLLINEAR):
            raise InputError(
                f"{path}: pose {pose!r}: seen targets of the {name} lie on a line, expected them spread out"
            )
