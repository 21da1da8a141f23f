"""The calibrated machine of a calibration's results, and what they keep of it: its file, its class's code, commands."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayescal.calibrated.exported import read_kept
from bayescal.calibrated.machine import (
    CalibratedMachine,
    Errors,
    LegErrors,
    Source,
    build_calibrated,
    build_calibrated_legs,
)
from bayescal.config.registry import list_references, list_sources
from bayescal.config.trust import check_same, check_trust
from bayescal.errors import InputError
from bayescal.experiments.frame.results import Results, Writer
from bayescal.experiments.shared.calibrating import (
    KEPT,
    list_problems,
    read_draws_of,
    read_means,
    read_parameters,
    write_bytes,
)
from bayescal.experiments.shared.headline import choose_best
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.readings.inputs import ReadingInputs, Variant
from bayescal.experiments.shared.readings.instruments import leave_instruments, read_model
from bayescal.experiments.shared.readings.noise import group_channels, noise_of_channels
from bayescal.experiments.shared.readings.priors import choose_priors
from bayescal.experiments.shared.readings.workspace import build_workspace
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig
from bayescal.experiments.shared.trees import name_file
from bayescal.files.csv_tables import format_table, read_table
from bayescal.machines.read import list_machine_sources
from bayescal.machines.readings import Legs, ReadingModel
from bayescal.numerics.geometry import Array

ERRORS = "errors"
"""Table of the results: by what each commanded channel errs."""
ERROR_DRAWS = 200


# --- writing -------------------------------------------------------------------------------------------------------


def keep_machine(inputs: ReadingInputs) -> dict[str, str | Writer]:
    """Return the files of the machines that a calibration's results keep, and the commands of its poses, by name."""
    kept: dict[str, str | Writer] = {f"{KEPT}/{name}": write_bytes(one) for name, one in inputs.files.items()}
    for variant in inputs.variants.values():
        kept[_name_commands(variant.name)] = _format_commands(variant)
    return kept


def _name_commands(variant: str) -> str:
    return f"{KEPT}/commands_{Path(name_file(variant)).stem}.csv"


def _format_commands(variant: Variant) -> str:
    """Return what the commanded channels read at each calibration pose, and what was known of it besides, as CSV."""
    whole, data = variant.whole, variant.data.pick(~variant.verification)
    columns: dict[str, Array] = {}
    for k in whole.select(whole.commanded):
        channel, nothing = whole.channels[k], np.full(data.n_poses, np.nan)
        read = dict(zip(variant.model.names, data.values.T, strict=True)).get(channel.name, nothing)
        columns[f"{channel.stem}_{channel.unit}"] = read
    columns |= {name: np.asarray(value) for name, value in data.given.items()}
    rows = zip(data.poses, *(map(_write, column) for column in columns.values()), strict=True)
    comments = ["Commands of the poses that calibrated the machine: where it is known, not extrapolated"]
    return format_table(comments, ["pose", *columns], list(rows))


def _write(value: float) -> str:
    return repr(float(value)) if np.isfinite(value) else ""


def tabulate_errors(config: StudyConfig, variant: Variant, kept: Array) -> pd.DataFrame:
    """Return by what each commanded channel errs: noise and model error, root mean squares over draws of the posterior.

    Errors that are functions count by their mean squares at the calibration poses, with the model error.

    Parameters
    ----------
    config : StudyConfig
    variant : Variant
    kept : ndarray, shape (T, n)
        Draws of the posterior, in its coordinates.
    """
    whole, names, posterior = variant.whole, variant.model.names, variant.posterior().anchored()
    y = kept[np.linspace(0, len(kept) - 1, min(ERROR_DRAWS, len(kept))).astype(int)]
    own, beside = posterior.likelihood.noise(posterior.errors, posterior.zeta(y))
    square = np.broadcast_to(beside**2, own.shape)
    if posterior.errors.has_columns:
        common = posterior.likelihood.draw_common(*posterior.at(y), np.random.default_rng([config.seed, 12]))
        square = square + common.at(posterior.likelihood.data) ** 2
    present = posterior.likelihood.data.present
    stated = np.nan_to_num(noise_of_channels(config.sensors, whole))
    rows: list[dict[str, Any]] = []
    for k in whole.select(whole.commanded):
        channel, noise, model_error = whole.channels[k], float(stated[k]), 0.0
        if channel.name in names:
            own_k, there = names.index(channel.name), present[:, names.index(channel.name)]
            noise = float(np.sqrt((np.median(own[:, there, own_k], axis=1) ** 2).mean()))
            model_error = float(np.sqrt(square[:, there, own_k].mean()))
        named = {"variant": variant.name, "channel": channel.name, "unit": channel.unit}
        rows.append({**named, "noise": noise, "model_error": model_error, **_relate(variant, channel.name)})
    return pd.DataFrame(rows)


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
    results: Results, config: StudyConfig, variant: str | None, experiment: Path | None, trust: bool
) -> CalibratedMachine:
    """Return the machine of a variant of a calibration's results; see `Calibrating.calibrate`."""
    assert results.folder is not None
    chosen = _choose(results, config, variant)
    if experiment is None and "machine_folder" not in results.summary:
        raise InputError(
            f"{results.folder}: found results without their machine, which earlier versions did not keep, expected "
            "those of a new run"
        )
    kept = results.folder / KEPT / str(results.summary.get("machine_folder"))
    folder = kept if experiment is None else experiment.parent
    path = Path(os.path.normpath(folder / (chosen.machine or config.machine)))
    if chosen.model is None:
        model = read_kept(path, trust or experiment is not None, results.hashes)
    else:
        for what, name in zip(("MODELS", "DEFORMATIONS"), chosen.seen, strict=True):
            if name not in list_references(what):
                check_trust(folder, f"own class {name!r}", trust or experiment is not None)
                check_same(folder, list_sources(what, name, folder), results.hashes)
        model = read_model(config, chosen, path, folder)
    config, chosen = leave_instruments(config, chosen, model)
    fit = results.summary["variants"][chosen.name]
    theta, draws = _read_posterior(results, config, chosen, model)
    commands, given = _read_commands(results.folder / _name_commands(chosen.name), model)
    workspace = build_workspace(model, config.workspace, config.units)
    errors, noise = _build_errors(results, chosen.name, model), _find_noise(results, config, chosen.name, model)
    source = Source(config.name, chosen.name, name_origin(config.origin.model_dump()), list_problems(fit))
    if isinstance(model, Legs):  # a mechanism on legs is one whatever calibrated it
        machine, size = model.machine, model.machine.layout.size
        by_legs = LegErrors(errors.noise, errors.model_variance, machine, theta[:size])
        some = None if draws is None else draws[:, :size]
        legs = build_calibrated_legs(machine, theta[:size], some, by_legs, source, commands)
        return replace(legs, noise=noise[model.select(legs.model.names)])
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
    return replace(found, noise=noise)


def _find_noise(results: Results, config: StudyConfig, variant: str, model: ReadingModel) -> Array:
    """Return the noise of each channel, stated and as found since, root mean square, (K,); NaN where none is stated."""
    mine = read_parameters(results, variant)
    square = (mine["mean"] ** 2 + mine["sd"] ** 2).to_dict()
    groups = group_channels(config, model)
    factor = np.array([square.get(f"noise_factor({group})", 1.0) for group in groups])
    tau = np.array([square.get(f"model_error({group})", 0.0) for group in groups])
    return np.sqrt(noise_of_channels(config.sensors, model) ** 2 * factor + tau)


def _choose(results: Results, config: StudyConfig, name: str | None) -> VariantConfig:
    """Return the variant that is wanted, by default that which the page says to use."""
    wanted = choose_best(results.summary) if name is None else name
    for one in config.variants:
        if one.name == wanted:
            return one
    known = ", ".join(one.name for one in config.variants)
    raise InputError(f"{results.folder}: --variant: found {wanted!r}, expected one of {known}")


def _read_posterior(
    results: Results, config: StudyConfig, variant: VariantConfig, model: ReadingModel
) -> tuple[Array, Array | None]:
    """Return the posterior's mean as a parameter vector (D,) and its draws (S, D); None where the results have none."""
    layout = model.layout
    priors, fixed, common = choose_priors(config, variant, model.layout, config.parameters)
    start = layout.nominal.copy()
    for name, value in fixed.items():
        start[layout.names.index(name)] = value
    found = read_draws_of(results, name_file(variant.name))
    mean = read_means(results, variant.name)

    def place(values: Mapping[str, Any], theta: Array) -> Array:
        for name in priors:
            if name not in values:
                raise InputError(f"{results.folder}: found no parameter {name!r} in the posterior, expected it")
            places = [layout.names.index(member) for member in common.get(name, (name,))]
            theta[..., places] += (np.asarray(values[name]) - start[places[0]])[..., None]
        return theta

    if found is None:
        return place(mean, start.copy()), None
    n_draws = len(next(iter(found.values())))
    draws = place(found, np.tile(start, (n_draws, 1)))
    return place(mean, start.copy()), draws


def _read_commands(path: Path, model: ReadingModel) -> tuple[Array | None, dict[str, Array]]:
    """Return commands (P, C) and what was given of the same poses, of those at which all are known."""
    if not path.is_file():
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


def _build_errors(results: Results, variant: str, model: ReadingModel) -> Errors:
    """Return by what the commands err, by the table of the results."""
    table = results.table(ERRORS)
    if table.empty:
        raise InputError(f"{results.folder}: found no table {ERRORS}.csv, expected results of this version")
    mine = table[table["variant"] == variant]
    if list(mine["channel"]) != list(model.commanded):
        raise InputError(
            f"{results.folder}: {ERRORS}.csv: found channels {', '.join(mine['channel'])}, expected those that are "
            f"commanded: {', '.join(model.commanded)}"
        )
    sd, tau = mine["noise"].to_numpy(dtype=float), mine["model_error"].to_numpy(dtype=float)
    columns = [f"correlation_{name}" for name in model.commanded]
    correlation = np.eye(len(sd))
    if set(columns) <= set(mine.columns) and mine[columns].notna().all(axis=None):
        correlation = mine[columns].to_numpy(dtype=float)
    return Errors(correlation * np.outer(sd, sd), tau**2)
