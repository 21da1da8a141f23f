"""Poses at which it is planned to measure: random ones of the workspace or of the actuators, or those of a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.calibrated.tables import list_columns, read_given, read_named, read_quantities
from bayescal.errors import InputError
from bayescal.experiments.audit.schema import AuditConfig, PosesConfig
from bayescal.experiments.shared.readings.priors import choose_priors
from bayescal.experiments.shared.readings.schema import FreeConfig
from bayescal.experiments.shared.readings.workspace import Workspace, check_given, draw_given, draw_standing
from bayescal.identifiability.design import draw_displacements
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class PlannedPoses:
    """Poses (P, q) by name, and what the machine has to know of each, (P,) by name."""

    names: tuple[str, ...]
    pose: Array
    given: dict[str, Array]


def plan_poses(config: AuditConfig, folder: Path, model: ReadingModel, workspace: Workspace) -> PlannedPoses:
    """Return where it is planned to measure; InputError for a faulty file or missing bounds."""
    section = config.poses
    if section.configurations is not None:
        raise InputError("poses.configurations: found displacements of a mechanism's actuators, expected poses.file")
    if section.file is not None:
        return _read_poses(folder / section.file, model)
    assert section.count is not None
    check_given(config.given, model)
    rng, count = np.random.default_rng([config.seed, 8]), section.count
    given, theta = draw_given(config.given, count, rng), _expect(config, model)
    if section.plan == "workspace":
        pose, _ = draw_standing(model, workspace, theta, given, count, rng)
    else:
        pose = _draw_commands(model, theta, given, section, rng)
    return PlannedPoses(tuple(f"P{k:03d}" for k in range(1, count + 1)), pose, given)


def _draw_commands(
    model: ReadingModel, theta: Array, given: dict[str, Array], section: PosesConfig, rng: np.random.Generator
) -> Array:
    """Return the poses (P, q) of random actuator positions; InputError for one at which the machine cannot stand."""
    limits = model.command_range
    if not len(limits) or not np.isfinite(limits).all():
        raise InputError(f"poses.plan: found {section.plan!r}, but no range of the actuators, expected 'workspace'")
    assert section.count is not None
    half = 0.5 * (limits[:, 1] - limits[:, 0])
    half = half if section.range_mm is None else np.minimum(half, section.range_mm)
    moves = draw_displacements(section.plan, section.count, len(limits), 1.0, rng)
    pose, found = model.locate(theta, limits.mean(axis=1) + half * moves, given)
    for k in np.flatnonzero(~found)[:1]:
        raise InputError(f"poses: pose {k + 1}: found no pose at actuator positions drawn, expected a smaller range_mm")
    return pose


def _expect(config: AuditConfig, model: ReadingModel) -> Array:
    """Return the machine as expected with everything free, (D,)."""
    priors, fixed, _ = choose_priors(config, FreeConfig(), model.layout)
    known = fixed | {name: one.mean for name, one in priors.items()}
    layout = model.layout
    return np.array([known.get(name, value) for name, value in zip(layout.names, layout.nominal, strict=True)])


def _read_poses(path: Path, model: ReadingModel) -> PlannedPoses:
    known = [*list_columns(model.coordinates), *model.given]
    expected = [*(f"{one.name}_{one.unit}" for one in model.coordinates), *model.given]
    table, names = read_named(path, known, expected)
    return PlannedPoses(names, read_quantities(table, model.coordinates), read_given(table, model.given))
