"""Errors of readings, from their sections to terms: those named in [error_terms], and the model error in its terms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from bayescal.config.classes import choose, name_failures
from bayescal.density.calibration.functions import FunctionErrors
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements, RowPositions
from bayescal.density.calibration.model_error import (
    COVERED_BY,
    GPTerm,
    OwnChannelRows,
    RandomTerm,
    build_model_error,
    count_columns,
)
from bayescal.density.calibration.terms import ErrorModel, ErrorTerm, TermRows, check_term
from bayescal.density.components import MOST_ROWS
from bayescal.density.priors import Prior
from bayescal.density.schema import TERMS, ModelErrorConfig, TermName
from bayescal.errors import InputError, name_faults, say_unknown
from bayescal.experiments.shared.function_errors import check_functions
from bayescal.experiments.shared.readings.noise import group_channels
from bayescal.experiments.shared.readings.workspace import Workspace
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE

NO_ERRORS = ErrorModel()
N_COVERED = 60  # poses at which functions of the model error are compared with parameters
LARGEST_GRID = 3**6  # poses over the workspace, from which the readings' ranges are taken


def build_terms(
    config: StudyConfig,
    section: VariantConfig,
    whole: ReadingModel,
    chosen: np.ndarray,
    data: Measurements,
    reach: Array,
    positions: RowPositions,
    folder: Path,
) -> tuple[ErrorTerm, ...]:
    """Return the terms that a variant has, for the rows that it takes in and the channels chosen of the whole machine.

    ``reach`` (K,): how far readings go from those at home; ``positions``: where the K channels stand at the rows.

    Raises
    ------
    InputError
        For an unknown name, an error on a channel that is not there, and whatever a term refuses.
    """
    for name in section.error_terms or ():
        if name not in config.error_terms:
            raise InputError(say_unknown("error_terms", name, config.error_terms))
    model, groups, found = whole.pick(chosen), group_channels(config, whole), []
    everywhere = [{one.name, one.kind, group} for one, group in zip(whole.channels, groups, strict=True)]
    for name, one in config.error_terms.items():
        if section.error_terms is not None and name not in section.error_terms:
            continue
        wanted = one.options.get("channels")
        if section.error_terms is None and wanted and _is_elsewhere(wanted, everywhere, chosen):
            continue
        rows = TermRows(name, model, data, tuple(groups[k] for k in chosen), reach, positions.home, positions)
        with name_faults(f"error_terms.{name}"):
            choice = choose("ERRORS", one.kind, ErrorTerm, f"error_terms.{name}.kind", folder, one.options)
            with name_failures(choice.found, f"error_terms.{name}"):
                term = choice.found.build(choice.options, rows)
            check_term(term, data)
            for functions in ErrorModel((term,)).terms_of(FunctionErrors):
                check_functions(functions, *data.sd.shape)
        found.append(term)
    return tuple(found)


def _is_elsewhere(names: list[str], everywhere: list[set[str]], chosen: np.ndarray) -> bool:
    """Whether the channels that an error is of are all among those that a variant does not take in."""
    mine = set().union(*(everywhere[k] for k in chosen))
    return set(names) <= set().union(*everywhere) and mine.isdisjoint(names)


def measure_ranges(model: ReadingModel, data: Measurements, workspace: Workspace) -> tuple[Array, Array]:
    """Return what the nominal machine reads in the middle of the workspace, and how far readings go from it, (K,).

    A channel that no coordinate moves goes as far as what is given of the rows takes it, as the pulse does a servo. Of
    a workspace around poses that no machine reaches, as wrong readings make one, both are those of the data.
    """
    q = len(workspace.low)
    if 3**q <= LARGEST_GRID:
        steps = np.array([*product((-1.0, 0.0, 1.0), repeat=q)])
    else:
        steps = np.random.default_rng(0).integers(-1, 2, (LARGEST_GRID, q)).astype(np.float64)
    pose = np.concatenate([workspace.middle[None], workspace.middle + workspace.half * steps.reshape(len(steps), q)])
    given = {name: np.full(len(pose), np.median(value)) for name, value in data.given.items()}
    with np.errstate(all="ignore"):
        read = model.read(model.layout.nominal, pose, given)
        by_given = model.read(model.layout.nominal, np.repeat(pose[:1], data.n_poses, axis=0), data.given)
    middle = np.where(np.isfinite(read[0]), read[0], _find_median(data.values))
    reach = _find_farthest(np.concatenate([read, np.where(np.isfinite(read[0]), np.nan, data.values)]) - middle)
    return middle, np.where(reach > 0.0, reach, _find_farthest(by_given - middle))


def _find_farthest(away: Array) -> Array:
    return np.asarray(np.where(np.isfinite(away), np.abs(away), 0.0).max(axis=0))


def _find_median(values: Array) -> Array:
    """Return medians over rows (P, K), zero of a channel without readings."""
    return np.array([np.median(one[np.isfinite(one)]) if np.isfinite(one).any() else 0.0 for one in values.T])


# --- the model error in its terms ----------------------------------------------------------------------------------


def build_terms_of_model(
    error: ModelErrorConfig,
    model: ReadingModel,
    data: Measurements,
    own: OwnChannelRows,
    tolerances: Mapping[str, Prior],
    others: ErrorModel = NO_ERRORS,
    few: bool | None = None,
) -> tuple[tuple[ErrorTerm, ...], str]:
    """Return the terms of a variant's model error, and in a line which of them there cannot be; empty for none.

    They are what the machine's own channels err by, whatever is said of their noise.

    Parameters
    ----------
    error : ModelErrorConfig
        With the terms of the variant.
    model : ReadingModel
        The machine with the K channels that the variant takes in.
    data : Measurements
        Of all P rows.
    own : OwnChannels
    tolerances : mapping of parameter to Prior
        Of what is free.
    others : Errors
        What else the readings err by: beside outliers, and other functions, coefficients are integrated out one by one.
    few : bool, optional
        Whether functions are made of few columns; by default where there are many rows, or where few columns leave
        nothing out and are fewer than half of the equations.

    Raises
    ------
    InputError
        For terms asked for by name that there cannot be, and a floor beyond all tolerances.
    """
    if not (terms := error.terms):
        return (), ""
    missing = own.find_missing(terms, _find_costly(others))
    if list(terms) != list(TERMS):  # asked for by name
        for name, why in [(name, why) for name, why in missing.items() if not own.is_covered(name)][:1]:
            raise InputError(f"model_error: found term {name!r}, but {why}")
    floors = error.floors()
    lengths = {name for name, unit in zip(model.layout.names, model.layout.units, strict=True) if unit == "mm"}
    check_floors(floors, [prior.sd for name, prior in tolerances.items() if name in lengths])
    there = [name for name in terms if name not in missing]
    n_equations = data.n_poses * (len(model.channels) - len(model.coordinates))
    left = build_model_error(
        own,
        len(model.channels),
        there,
        error.scales(own.find_noise(data)),
        {name: MICROMETRE * floor for name, floor in floors.items()},
        error.separate_by_leg,
        few=_suits_few(there, len(own.places), n_equations) if few is None else few,
    )
    without = [([name for name, why in missing.items() if why == one], one) for one in dict.fromkeys(missing.values())]
    said = [f"no term{'s' * (len(names) > 1)} {', '.join(names)}, as {why}" for names, why in without]
    known = [name for name, covered in zip(own.names, own.covered.diagonal(), strict=True) if covered]
    if known and {"linear", "positioning"} & {*there}:
        said.append(f"no error linear in the own position of {', '.join(known)}, as {COVERED_BY}")
    return left, f"the model error has {' and '.join(said)}" if said else ""


def _suits_few(terms: Sequence[str], n_own: int, n_equations: int) -> bool:
    """Return whether functions of so many own channels are made of few columns: their density then costs less.

    A covariance of M equations takes M³ / 3 products, N columns M N². What columns leave out of smooth functions counts
    as independent from row to row.
    """
    return n_equations > MOST_ROWS or sum(count_columns(name, n_own) for name in terms) < n_equations / 2


def find_own_channels(
    posterior: CalibrationPosterior,
    data: Measurements,
    pose: Array,
    used: np.ndarray,
    reach: Array,
    positions: RowPositions,
    workspace: Workspace,
) -> OwnChannelRows:
    """Return a machine's own channels, with the linear errors that the free parameters of a posterior are.

    ``pose`` (P, q): where the nominal machine explains all P rows best; ``used``: which of them are for calibration.
    """
    model = posterior.likelihood.model
    own = OwnChannelRows.find(model, data, pose, used, positions, reach)
    start, many = posterior.first_machine, workspace.draw(N_COVERED, np.random.default_rng(0))
    rows = np.random.default_rng(1).integers(0, data.n_poses, len(many))  # channels may move by what is given alone
    given = {name: value[rows] for name, value in data.given.items()}
    with np.errstate(all="ignore"):
        return own.cover(model, posterior.sampling.jacobian(start), start, many, given)


def _find_costly(others: ErrorModel) -> str:
    """Return why errors with as many coefficients as rows cost too much beside others; empty where they do not."""
    if others.outliers.expected:
        return "single rows may be outliers"
    return "there are other functions in [error_terms]" if others.has_columns else ""


def check_floors(floors: Mapping[TermName, float], tolerances: Sequence[float]) -> None:
    """Raise InputError where a floor of the model error, µm, is beyond all tolerances of lengths, mm."""
    largest = max(tolerances, default=np.inf) / MICROMETRE
    for name, floor in floors.items():
        if floor > largest:
            raise InputError(
                f"model_error.floor_um: found {floor:g} µm for {name!r}, expected less than {largest:g} µm"
            )


def drop_model_error(posterior: CalibrationPosterior) -> CalibrationPosterior:
    """Return a posterior without the terms of its model error."""
    errors = posterior.errors
    own = [*errors.terms_of(RandomTerm), *errors.terms_of(GPTerm)]
    return replace(posterior, errors=errors.without(own))
