"""Errors of readings that a config names in [errors]: from their sections to terms."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np

from bayescal.config.classes import choose, name_failures
from bayescal.density.calibration.functions import FunctionErrors
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import ErrorTerm, TermRows, check_term
from bayescal.errors import InputError, name_faults
from bayescal.experiments.shared.function_errors import check_functions
from bayescal.experiments.shared.readings.noise import group_channels
from bayescal.experiments.shared.readings.workspace import Workspace
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array

LARGEST_GRID = 3**6  # poses over the workspace, from which the readings' ranges are taken


def build_terms(
    config: StudyConfig,
    section: VariantConfig,
    whole: ReadingModel,
    chosen: np.ndarray,
    data: Measurements,
    workspace: Workspace,
    folder: Path,
) -> tuple[ErrorTerm, ...]:
    """Return the terms that a variant has, for the rows that it takes in and the channels chosen of the whole machine.

    Raises
    ------
    InputError
        For an unknown name, an error on a channel that is not there, and whatever a term refuses.
    """
    for name in section.errors or ():
        if name not in config.errors:
            raise InputError(f"errors: found {name!r}, expected some of {', '.join(config.errors) or 'none'}")
    model, groups, found = whole.pick(chosen), group_channels(config, whole), []
    everywhere = [{one.name, one.kind, group} for one, group in zip(whole.channels, groups, strict=True)]
    home, reach = measure_ranges(model, data, workspace)
    for name, one in config.errors.items():
        if section.errors is not None and name not in section.errors:
            continue
        wanted = one.options.get("channels")
        if section.errors is None and wanted and _is_elsewhere(wanted, everywhere, chosen):
            continue
        rows = TermRows(name, model, data, tuple(groups[k] for k in chosen), reach, home)
        with name_faults(f"errors.{name}"):
            choice = choose("ERRORS", one.kind, ErrorTerm, f"errors.{name}.kind", folder, one.options)
            with name_failures(choice.found, f"errors.{name}", folder):
                term = choice.found.build(choice.options, rows)
            check_term(term, data)
            if isinstance(term, FunctionErrors):
                check_functions(term, *data.sd.shape)
        found.append(term)
    return tuple(found)


def _is_elsewhere(names: list[str], everywhere: list[set[str]], chosen: np.ndarray) -> bool:
    """Whether the channels that an error is of are all among those that a variant does not take in."""
    mine = set().union(*(everywhere[k] for k in chosen))
    return set(names) <= set().union(*everywhere) and mine.isdisjoint(names)


def measure_ranges(model: ReadingModel, data: Measurements, workspace: Workspace) -> tuple[Array, Array]:
    """Return what the nominal machine reads in the middle of the workspace, and how far readings go from it, (K,)."""
    q = len(workspace.low)
    steps = np.array([*product((-1.0, 0.0, 1.0), repeat=q)]) if 3**q <= LARGEST_GRID else _draw_ends(q)
    pose = np.concatenate([workspace.middle[None], workspace.middle + workspace.half * steps.reshape(-1, q)])
    given = {name: np.full(len(pose), np.median(value)) for name, value in data.given.items()}
    with np.errstate(all="ignore"):
        read = model.read(model.layout.nominal, pose, given)
    away = np.abs(read - read[0])
    return read[0], np.where(np.isfinite(away), away, 0.0).max(axis=0)


def _draw_ends(q: int) -> Array:
    return np.random.default_rng(0).integers(-1, 2, (LARGEST_GRID, q)).astype(np.float64)
