"""The calibrated machine of a study's results, and what they hold of it: its file, its class's code, its commands."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayescal.calibrated.exported import (
    MATRIX,
    MATRIX_COVARIANCE,
    format_matrix,
    format_matrix_covariance,
    read_kept,
    read_matrix_covariance,
)
from bayescal.calibrated.functions import KnownFunctions
from bayescal.calibrated.machine import CalibratedMachine, CommandErrors, LegErrors, Source, build_calibrated
from bayescal.config.registry import list_references, list_sources
from bayescal.config.trust import check_same
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.terms import CommonDraws
from bayescal.errors import InputError, say_unknown
from bayescal.experiments.runner.kept_inputs import find_config
from bayescal.experiments.runner.results import PRELIMINARY, Results, Writer
from bayescal.experiments.shared.calibrating import KEPT
from bayescal.experiments.shared.headline import choose_best
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.posterior_files import read_draws, read_functions
from bayescal.experiments.shared.readings.found_frames import FoundFrames, list_unstated, settle_unstated
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.instruments import leave_instruments, read_instruments, read_model
from bayescal.experiments.shared.readings.measurement import expect_trackers
from bayescal.experiments.shared.readings.noise import group_channels, noise_of_channels
from bayescal.experiments.shared.readings.priors import choose_priors
from bayescal.experiments.shared.readings.workspace import build_workspace
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig, stem_of
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.rows import CommandErrorRow
from bayescal.files.csv_tables import format_table, read_table
from bayescal.machines.read import list_machine_sources
from bayescal.machines.readings import Instrument, Legs, ReadingModel, place
from bayescal.numerics.geometry import Array

COMMANDS = "commands.csv"
"""Of all variants, where all take in the same poses."""
ERRORS = "errors"
"""Table of the results: by what each commanded channel errs."""


# --- writing -------------------------------------------------------------------------------------------------------


def list_machine_files(inputs: StudyInputs) -> dict[str, str | Writer]:
    """Return the files that a study's results hold of its machines, and the commands of its poses, by name."""
    found: dict[str, str | Writer] = {name: partial(_write, one) for name, one in inputs.files.items()}
    found |= {_name_commands(one.name): _format_commands(one) for one in inputs.variants.values()}
    seen = inputs.pads
    if seen is not None and seen.pads is not None and seen.needs_matrix:  # K and the covariance of its rows, measured
        found[MATRIX] = format_matrix(seen.pads.matrix.matrix)
        found[MATRIX_COVARIANCE] = format_matrix_covariance(seen.pads.matrix.by_row)
    return {f"{KEPT}/{name}": one for name, one in found.items()}


def _write(content: bytes, path: Path) -> None:
    path.write_bytes(content)


def _name_commands(variant: str) -> str:
    return f"commands_{stem_of(variant)}.csv"


def _format_commands(variant: Variant) -> str:
    """Return what the commanded channels read at each calibration pose, and what was known of it besides, as CSV."""
    whole, data = variant.whole, variant.data.pick(~variant.verification)
    read = dict(zip(variant.model.names, data.values.T, strict=True))
    channels = [whole.channels[k] for k in whole.select(whole.commanded)]
    columns = {f"{one.stem}_{one.unit}": read.get(one.name, np.full(data.n_poses, np.nan)) for one in channels}
    columns |= {name: np.asarray(value) for name, value in data.given.items()}
    written = ([repr(float(x)) if np.isfinite(x) else "" for x in one] for one in columns.values())
    comments = ["Commands of the calibration poses; elsewhere extrapolated"]
    return format_table(comments, ["pose", *columns], list(zip(data.poses, *written, strict=True)))


def tabulate_errors(
    config: StudyConfig, variant: Variant, posterior: CalibrationPosterior, y: Array, draws: CommonDraws
) -> pd.DataFrame:
    """Return by what each commanded channel errs: noise and model error, root mean squares over draws of the posterior.

    Errors that are functions count by their mean squares at the calibration poses, with the model error; sizes that the
    data hardly determine by their 90 % intervals (`CommandErrors.limit`).

    Parameters
    ----------
    posterior : CalibrationPosterior
        Of its calibration poses.
    y : ndarray, shape (T, n)
        Draws, in its coordinates.
    draws : CommonDraws
        Of the errors common to all rows, one for each.
    """
    whole, names, zeta = variant.whole, variant.model.names, posterior.errors.limit(posterior.zeta(y))
    commanded = [names.index(whole.names[k]) for k in whole.select(whole.commanded) if whole.names[k] in names]
    parts = list[tuple[Array, Array]]()
    for some, data in posterior.likelihood.data.split():
        own, beside = posterior.errors.noise(zeta, data, posterior.likelihood.sd[some])
        square = np.broadcast_to(beside**2, own.shape)
        if posterior.errors.has_columns:
            square = square + draws.at(data) ** 2
        parts.append((own[..., commanded], square[..., commanded]))
    own, square = (np.concatenate(one, axis=1) for one in zip(*parts, strict=True))  # of the commanded channels
    present = posterior.likelihood.data.present
    stated = np.nan_to_num(noise_of_channels(config.sensors, whole))
    rows = list[CommandErrorRow]()
    for k in whole.select(whole.commanded):
        channel, noise, model_error = whole.channels[k], float(stated[k]), 0.0
        if channel.name in names:
            own_k, there = commanded.index(names.index(channel.name)), present[:, names.index(channel.name)]
            noise = float(np.sqrt((np.median(own[:, there, own_k], axis=1) ** 2).mean()))
            model_error = float(np.sqrt(square[:, there, own_k].mean()))
        rows.append(
            CommandErrorRow(
                variant=variant.name,
                channel=channel.name,
                unit=channel.unit,
                noise=noise,
                model_error=model_error,
                others=_relate(variant, channel.name),
            )
        )
    return CommandErrorRow.collect(rows)


def _relate(variant: Variant, channel: str) -> dict[str, float]:
    """Return the mean correlations of a commanded channel's noise with that of all, where any are stated."""
    if variant.data.correlation is None:
        return {}
    names, mean = variant.model.names, variant.data.correlation.mean(axis=0)
    return {
        f"correlation_{other}": float(mean[names.index(channel), names.index(other)])
        if {channel, other} <= set(names)
        else float(channel == other)
        for other in variant.whole.commanded
    }


# --- reading -------------------------------------------------------------------------------------------------------


def calibrate_machine(
    results: Results,
    config: StudyConfig,
    variant: str | None,
    experiment: Path | None,
    mode: int | None,
    with_instruments: bool = False,
) -> CalibratedMachine:
    """Return the machine of a variant of a study's results; see `Calibrating.calibrate`."""
    assert results.folder is not None
    chosen = _choose(results, config, variant)
    solution = _choose_solution(results, chosen.name, mode)
    kept = results.folder / KEPT
    if experiment is None and not ("machine_folder" in results.summary and kept.is_dir()):
        raise InputError(f"{results.folder}: found no machine, expected --experiment STUDY.toml")
    folder = kept / str(results.summary["machine_folder"]) if experiment is None else experiment.parent
    path = folder.with_segments(os.path.normpath(str(folder / (chosen.machine or config.machine))))
    covariance = None
    if chosen.model is None:
        model = read_kept(path, results.hashes).with_optional(config.parameters)
    elif experiment is not None and chosen.deformation == "matrix" and config.deformation.matrix == "targets":
        inputs = StudyInputs.load(config, folder)
        whole, pads = inputs.variants[chosen.name].whole.legs, inputs.pads
        assert whole is not None
        assert pads is not None
        assert pads.pads is not None
        model, covariance = Legs(whole.machine, has_gains=whole.has_gains), pads.pads.matrix.by_row
    else:
        for what, name in zip(("MODELS", "DEFORMATIONS"), chosen.seen, strict=True):
            if name not in list_references(what):
                check_same(folder, list_sources(what, name, folder), results.hashes)
        if (kept / MATRIX).is_file():  # as it was measured
            measured = config.deformation.model_copy(
                update={"matrix": os.path.relpath(str(kept / MATRIX), str(folder))}
            )
            config = config.model_copy(update={"deformation": measured})
        model = read_model(config, chosen, path, folder)
        if (kept / MATRIX_COVARIANCE).is_file():
            covariance = read_matrix_covariance(kept / MATRIX_COVARIANCE, len(model.commanded))

    def locate_inputs() -> Path:
        return find_config(results.folder or folder, results.provenance).parent if experiment is None else folder

    kept_config, trackers = expect_trackers(config, model, locate_inputs) if with_instruments else (config, {})
    if with_instruments and (config.instruments or trackers):
        config, chosen, model = _keep_instruments(results, kept_config, chosen, model, folder, trackers)
    else:
        config, chosen = leave_instruments(config, chosen, model)
    fit = results.summary["variants"][chosen.name]
    theta, draws = _read_posterior(results, config, chosen, model, solution)
    commands, given = _read_commands(kept, chosen.name, model)
    errors = _build_errors(results, chosen.name, model)
    noise = _find_noise(results, config, chosen.name, model, solution)
    problems = () if fit["converged"] else tuple(str(fit["problems"] or "not converged").split("; "))
    if results.summary.get(PRELIMINARY):
        problems = ("preliminary answer, which no chain has checked", *problems)
    source = Source(config.name, chosen.name, name_origin(config.provenance.model_dump()), problems, solution.say())
    functions = _read_functions(results, chosen.name, solution)
    units = {name: unit for name, unit in results.summary.get("column_units", {}).items() if name in model.names}
    if (alone := model.legs) is not None and alone is model:  # a mechanism on legs is one whatever calibrated it
        bare = Legs(alone.machine, has_gains=alone.has_gains)  # without inclinometers, whose zeros come last
        size = bare.layout.size
        covariance = covariance if bare.machine.deformation.uses_matrix else None
        by_legs = LegErrors(errors.noise, errors.model_variance, bare, theta[:size], covariance)
        some = None if draws is None else draws[:, :size]
        legs = build_calibrated(bare, theta[:size], some, by_legs, source, commands)
        aligned = config.accuracy_frame == "aligned"
        legs = replace(legs, functions=_change(functions, legs), units=units, aligned=aligned)
        return replace(legs, noise=noise[model.select(legs.model.names)]) if np.isfinite(noise).any() else legs
    workspace = build_workspace(model, config.workspace, config.units)
    own = [path.name, *list_machine_sources(path)]
    found = build_calibrated(
        model,
        theta,
        draws,
        errors,
        source,
        commands,
        given,
        np.stack([workspace.low, workspace.high]),
        path.name,
        {one: (path.parent / one).read_bytes() for one in own},
    )
    aligned = config.accuracy_frame == "aligned"
    return replace(found, noise=noise, functions=_change(functions, found), units=units, aligned=aligned)


def _keep_instruments(
    results: Results,
    config: StudyConfig,
    variant: VariantConfig,
    model: ReadingModel,
    folder: Path,
    trackers: Mapping[str, Instrument],
) -> tuple[StudyConfig, VariantConfig, ReadingModel]:
    """Return config, variant and machine with the instruments beside it, all that was found from the data free."""
    for section in config.instruments.values():
        if section.kind not in list_references("INSTRUMENTS"):
            check_same(folder, list_sources("INSTRUMENTS", section.kind, folder), results.hashes)
    instruments = read_instruments(config.instruments, folder)
    placed = place(model, {**trackers, **{name: settle_unstated(one) for name, one in instruments.items()}})
    config = FoundFrames(instruments, list_unstated(instruments)).free(config)
    return config, next(one for one in config.variants if one.name == variant.name), placed


@dataclass(frozen=True)
class _Solution:
    """Which of a posterior's solutions is taken, from 1."""

    number: int = 1
    n: int = 1  # of those that are shown
    probability: float = 1.0
    has_others: bool = False  # whether draws belong to several, small ones among them

    @property
    def of_draws(self) -> int | None:
        """What draws are told apart by; None where all are of one solution."""
        return self.number if self.has_others else None

    def say(self) -> str:
        """Return which solution it is in words; empty where there is one."""
        return f"mode {self.number} of {self.n}, probability {self.probability:.3f}" if self.n > 1 else ""


def _choose_solution(results: Results, variant: str, mode: int | None) -> _Solution:
    """Return the solution that is wanted; InputError where there are several and none is named."""
    row = results.summary["variants"][variant]
    probability = [float(one["probability"]) for one in row.get("modes", [])] or [1.0]
    if mode is None and len(probability) > 1:
        modes = ", ".join(f"mode {k} with {100 * p:.1f} %" for k, p in enumerate(probability, start=1))
        raise InputError(
            f"{results.folder}: variant {variant!r}: found {len(probability)} solutions ({modes}), "
            "expected one: --mode 1"
        )
    number = 1 if mode is None else mode
    if not 1 <= number <= len(probability):
        raise InputError(
            f"{results.folder}: --mode: found {number}, expected 1 to {len(probability)}"
            if len(probability) > 1
            else f"{results.folder}: --mode: found {number}, expected none: {variant!r} has one solution"
        )
    return _Solution(number, len(probability), probability[number - 1], "modes" in row or "other_modes" in row)


def _read_functions(results: Results, variant: str, solution: _Solution) -> tuple[KnownFunctions, Array] | None:
    """Return what a posterior knows of errors that are functions, and draws (S, n) of the parameters beside."""
    assert results.folder is not None
    path = results.folder / f"posterior/{stem_of(variant)}.nc"
    found = read_functions(path, solution.number) if path.is_file() else None
    if found is None:
        return None
    draws = read_draws(path, solution.of_draws)
    return found[0], np.stack([draws[name] for name in found[1]], axis=1)


def _change(known: tuple[KnownFunctions, Array] | None, calibrated: CalibratedMachine) -> KnownFunctions | None:
    """Return the same beside the machine's own parameters, which follow those of the posterior to first order."""
    if known is None or calibrated.draws is None:
        return None
    functions, draws = known
    from_mean, to = draws - draws.mean(axis=0), calibrated.draws - calibrated.draws.mean(axis=0)
    return functions.changed(np.linalg.lstsq(from_mean, to)[0].T)


def _find_noise(results: Results, config: StudyConfig, variant: str, model: ReadingModel, solution: _Solution) -> Array:
    """Return the noise of each channel, stated and as found since, root mean square, (K,); NaN where none is stated."""
    mine = _read_parameters(results, variant, solution)
    square = (mine["mean"] ** 2 + mine["sd"] ** 2).to_dict()
    groups = group_channels(config, model)
    factor = np.array([square.get(f"noise_factor({group})", 1.0) for group in groups])
    tau = np.array([square.get(f"model_error({group})", 0.0) for group in groups])
    return np.sqrt(noise_of_channels(config.sensors, model) ** 2 * factor + tau)


def _read_parameters(results: Results, variant: str, solution: _Solution) -> pd.DataFrame:
    """Return a variant's posterior of its parameters, with its model error if it has any, by their names."""
    rows = results.table("parameters")
    rows = rows[rows["variant"] == variant]
    return (rows[rows["mode"] == solution.number] if solution.n > 1 else rows).set_index("parameter")


def _choose(results: Results, config: StudyConfig, name: str | None) -> VariantConfig:
    """Return the variant that is wanted, by default that which the page says to use."""
    wanted = choose_best(results.summary) if name is None else name
    for one in config.variants:
        if one.name == wanted:
            return one
    known = [one.name for one in config.variants]
    raise InputError(say_unknown(f"{results.folder}: --variant", wanted, known))


def _read_posterior(
    results: Results, config: StudyConfig, variant: VariantConfig, model: ReadingModel, solution: _Solution
) -> tuple[Array, Array | None]:
    """Return the posterior's mean as a parameter vector (D,) and its draws (S, D); None where the results have none."""
    layout = model.layout
    priors, fixed, common = choose_priors(config, variant, model.layout, config.parameters)
    start = layout.nominal.copy()
    for name, value in fixed.items():
        start[layout.names.index(name)] = value
    assert results.folder is not None
    path, mean = (
        results.folder / f"posterior/{stem_of(variant.name)}.nc",
        _read_parameters(results, variant.name, solution)["mean"],
    )

    def place(values: Any, theta: Array) -> Array:
        for name in priors:
            if name not in values:
                raise InputError(f"{results.folder}: found no parameter {name!r} in the posterior")
            places = [layout.names.index(member) for member in common.get(name, (name,))]
            theta[..., places] += (np.asarray(values[name]) - start[places[0]])[..., None]
        return theta

    expected = place(mean, start.copy())
    if not path.is_file():
        return expected, None
    found = read_draws(path, solution.of_draws)
    return expected, place(found, np.tile(start, (len(next(iter(found.values()))), 1)))


def _read_commands(folder: Path, variant: str, model: ReadingModel) -> tuple[Array | None, dict[str, Array]]:
    """Return commands (P, C) and what was given of the same poses, of those at which all are known."""
    path = next((one for one in (folder / _name_commands(variant), folder / COMMANDS) if one.is_file()), None)
    if path is None:
        return None, {}
    channels = [model.channels[k] for k in model.select(model.commanded)]
    columns = [f"{one.stem}_{one.unit}" for one in channels]
    table = read_table(path, ("pose", *columns, *model.given))
    values = table.numbers([*columns, *model.given], gaps=True)
    known = values[np.isfinite(values[:, len(columns) :]).all(axis=1)]
    whole = known[np.isfinite(known).all(axis=1)]
    some = whole if len(whole) else known
    given = {name: some[:, len(columns) + k] for k, name in enumerate(model.given)}
    return (whole[:, : len(columns)] if len(whole) and columns else None), given


def _build_errors(results: Results, variant: str, model: ReadingModel) -> CommandErrors:
    """Return by what the commands err, by the table of the results."""
    table = results.table(ERRORS)
    if not len(model.commanded):  # all channels stand beside the machine, and the table has no row
        return CommandErrors(np.zeros((0, 0)), np.zeros(0))
    if table.empty:
        raise InputError(f"{results.folder}: found no table {ERRORS}.csv, expected results of this version")
    mine = table[table["variant"] == variant]
    if list(mine["channel"]) != list(model.commanded):
        raise InputError(
            f"{results.folder}: {ERRORS}.csv: found channels {', '.join(mine['channel'])}, expected "
            f"{', '.join(model.commanded)}"
        )
    sd, tau = mine["noise"].to_numpy(dtype=float), mine["model_error"].to_numpy(dtype=float)
    columns = [f"correlation_{name}" for name in model.commanded]
    correlation = np.eye(len(sd))
    if set(columns) <= set(mine.columns) and mine[columns].notna().all(axis=None):
        correlation = mine[columns].to_numpy(dtype=float)
    return CommandErrors(correlation * np.outer(sd, sd), tau**2)
