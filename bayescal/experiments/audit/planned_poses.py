"""Poses at which it is planned to measure: random ones of the workspace, or those of a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.calibrated.tables import list_columns, read_given, read_named, read_quantities
from bayescal.experiments.shared.readings.priors import choose_priors
from bayescal.experiments.shared.readings.schema import CalibrationAuditConfig, FreeConfig
from bayescal.experiments.shared.readings.workspace import Workspace, check_given, draw_given, draw_standing
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
    priors, fixed, _ = choose_priors(config, FreeConfig(), model)
    known = fixed | {name: one.mean for name, one in priors.items()}
    layout = model.layout
    return np.array([known.get(name, value) for name, value in zip(layout.names, layout.nominal, strict=True)])


def _read_poses(path: Path, model: ReadingModel) -> PlannedPoses:
    known = [*list_columns(model.coordinates), *model.given]
    expected = [*(f"{one.name}_{one.unit}" for one in model.coordinates), *model.given]
    table, names = read_named(path, known, expected)
    return PlannedPoses(names, read_quantities(table, model.coordinates), read_given(table, model.given))
