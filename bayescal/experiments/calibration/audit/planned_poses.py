"""Poses at which it is planned to measure: random ones of the workspace, or those of a file."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.errors import InputError
from bayescal.experiments.calibration.priors import choose_priors
from bayescal.experiments.calibration.reading_tables import pose_names
from bayescal.experiments.calibration.schema import CalibrationAuditConfig
from bayescal.experiments.calibration.workspace import Workspace, check_given, draw_given, draw_standing
from bayescal.files.csv_tables import Table, read_table
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class PlannedPoses:
    """Poses (P, q) by name, and what the machine has to know of each, (P,) by name."""

    names: tuple[str, ...]
    pose: Array
    given: dict[str, Array]


def plan_poses(config: CalibrationAuditConfig, folder: Path, model: ReadingModel, workspace: Workspace) -> PlannedPoses:
    """Return where it is planned to measure; InputError for a faulty file or missing bounds."""
    if config.poses.file is not None:
        return _read_poses(folder / config.poses.file, model)
    assert config.poses.count is not None
    check_given(config.given, model)
    rng, count = np.random.default_rng([config.seed, 8]), config.poses.count
    given = draw_given(config.given, count, rng)
    pose, _ = draw_standing(model, workspace, _expect(config, model), given, count, rng)
    return PlannedPoses(tuple(f"P{k:03d}" for k in range(1, count + 1)), pose, given)


def _expect(config: CalibrationAuditConfig, model: ReadingModel) -> Array:
    """Return the machine as expected with everything free, (D,)."""
    priors, fixed, _ = choose_priors(config, None, [], model)
    known = fixed | {name: one.mean for name, one in priors.items()}
    layout = model.layout
    return np.array([known.get(name, value) for name, value in zip(layout.names, layout.nominal, strict=True)])


def _read_poses(path: Path, model: ReadingModel) -> PlannedPoses:
    table = read_table(path, None)
    known = {
        f"{one.name}_{unit}": (one.name, factor)
        for one in model.coordinates
        for unit, factor in units_like(one.unit).items()
    } | {name: (name, 1.0) for name in model.given}
    _check_columns(table, [*known], [f"{one.name}_{one.unit}" for one in model.coordinates] + [*model.given])
    columns: dict[str, Array] = {}
    for column in table.columns:
        if column == "pose":
            continue
        name, factor = known[column]
        if name in columns:
            raise InputError(f"{path}: found column {column!r} besides another of {name}, expected one of them")
        columns[name] = factor * table.numbers((column,))[:, 0]
    for name in (*(one.name for one in model.coordinates), *model.given):
        if name not in columns:
            raise InputError(f"{path}: found no column of {name}, expected one")
    pose = np.array([columns[one.name] for one in model.coordinates]).reshape(-1, len(table.rows)).T
    return PlannedPoses(tuple(pose_names(table)), pose, {name: columns[name] for name in model.given})


def _check_columns(table: Table, known: list[str], expected: list[str]) -> None:
    if "pose" not in table.columns:
        raise InputError(f"{table.path}: found no column 'pose', expected the poses' names")
    for name in table.columns:
        if name not in ("pose", *known):
            close = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
            hint = f", did you mean {close[0]!r}?" if close else ""
            raise InputError(f"{table.path}: found column {name!r}{hint}, expected pose, {', '.join(expected)}")
