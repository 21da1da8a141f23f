"""The calibrated machine of a study's results, and the nominal one that is kept with them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayescal.calibrated.exported import (
    MATRIX,
    MATRIX_COVARIANCE,
    MEASURED,
    MECHANISM,
    PER_MILLE,
    format_matrix,
    format_matrix_covariance,
    format_measured,
    format_mechanism,
    read_matrix_covariance,
    read_measured,
)
from bayescal.calibrated.machine import CalibratedMachine, Source, build_calibrated_legs, build_leg_errors
from bayescal.config.registry import list_references, list_sources
from bayescal.config.trust import check_same, check_trust
from bayescal.density.schema import FixedConfig
from bayescal.errors import InputError
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.calibrating import KEPT, list_problems, read_draws_of, read_means, read_parameters
from bayescal.experiments.shared.headline import choose_best
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.per_leg import spread_over_legs
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig, stem_of
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.load import load_inputs
from bayescal.files.csv_tables import read_matrix
from bayescal.machines.deformations import NominalDeformation
from bayescal.machines.kinematics import Machine
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.read import build_named_machine, load_mechanism
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE

TAU = "tau"


def describe_nominal(inputs: StudyInputs) -> dict[str, str]:
    """Return the files of the nominal machine that a study's results keep, by name."""
    comments = [f"Nominal mechanism of study {inputs.config.name}; what calibrated it stands in the results"]
    texts = {
        MECHANISM: format_mechanism(inputs.mechanism, comments),
        MEASURED: format_measured(_see(inputs), inputs.measured.actuators[~inputs.verification], {}),
    }
    if any(inputs.machine(variant).deformation.uses_matrix for variant in inputs.config.variants):
        texts[MATRIX] = format_matrix(inputs.matrix)
        covariance = find_matrix_covariance(inputs)
        if covariance is not None:
            texts[MATRIX_COVARIANCE] = format_matrix_covariance(covariance)
    sources = [one for variant in inputs.config.variants for one in _list_own(variant, inputs.folder)]
    texts |= {name: (inputs.folder / name).read_text(encoding="utf-8") for name in dict.fromkeys(sources)}
    return {f"{KEPT}/{name}": text for name, text in texts.items()}


def _list_own(variant: VariantConfig, folder: Path) -> list[str]:
    """Return the files of a variant's own classes, as far as they lie in the study's folder."""
    named = zip(("MODELS", "DEFORMATIONS"), variant.seen, strict=True)
    found = [one for what, name in named for one in list_sources(what, name, folder)]
    return [one for one in found if (folder / one).resolve().is_relative_to(folder.resolve())]


def _see(inputs: StudyInputs) -> Legs:
    return Legs(inputs.machine(inputs.config.variants[0]))


def find_matrix_covariance(inputs: StudyInputs) -> Array | None:
    """Return the covariance of each row of a measured K, shape (N, N, N); None where K was not measured."""
    if not inputs.matrix_from_targets or inputs.measured_matrix is None:
        return None
    n = inputs.mechanism.n_legs
    legs = np.arange(n)
    return np.asarray(inputs.measured_matrix.covariance.reshape(n, n, n, n)[legs, :, legs, :])


def calibrate_study(
    results: Results, config: StudyConfig, variant: str | None, experiment: Path | None, trust: bool
) -> CalibratedMachine:
    """Return the machine of a variant of a study's results; see `Calibrating.calibrate`."""
    chosen, name = _choose(results, config, variant)
    fit = results.summary["variants"][name]
    if experiment is None:
        machine, covariance = _read_nominal(results, config, chosen, trust)
    else:
        machine, covariance = _load_nominal(config, chosen, experiment.parent)
    theta = _fix(config, machine.layout)
    parameters = read_parameters(results, name)
    _set_named(theta, machine.layout, read_means(results, name))
    variance = _find_model_variance(parameters, machine)
    errors = build_leg_errors(machine, theta, config.measured.actuator_noise_um * MICROMETRE, variance, covariance)
    source = Source(config.name, name, name_origin(config.origin.model_dump()), list_problems(fit))
    draws = _read_draws(results, name, machine.layout, theta)
    return build_calibrated_legs(machine, theta, draws, errors, source, _read_measured(results, machine))


def _choose(results: Results, config: StudyConfig, name: str | None) -> tuple[VariantConfig, str]:
    """Return the variant that is wanted, and what the results call it."""
    known = list(results.summary["variants"])
    wanted = choose_best(results.summary) if name is None else name
    for variant, content in zip(config.variants, results.config["variants"], strict=True):
        if content["name"] == wanted:
            return variant, wanted
    raise InputError(f"{results.folder}: --variant: found {wanted!r}, expected one of {', '.join(known)}")


# --- the nominal machine -----------------------------------------------------------------------------------------


def _read_nominal(
    results: Results, config: StudyConfig, variant: VariantConfig, trust: bool
) -> tuple[Machine, Array | None]:
    """Return the nominal machine that the results keep, and the covariance of its measured K."""
    assert results.folder is not None
    folder = results.folder / KEPT
    if not (folder / MECHANISM).is_file():
        raise InputError(
            f"{folder / MECHANISM}: no such file, expected the nominal machine, which earlier versions did not write; "
            "name the study's config: --experiment STUDY.toml"
        )
    for what, name in zip(("MODELS", "DEFORMATIONS"), variant.seen, strict=True):
        if name not in list_references(what):
            file = name.partition(":")[0]
            if not (folder / file).is_file():
                raise InputError(
                    f"{results.folder}: found variant {variant.name!r} with {name!r}, whose code the results do not "
                    "keep, expected the study's config: --experiment STUDY.toml"
                )
            check_trust(folder / file, f"own class {name!r}", trust)
            check_same(folder, list_sources(what, name, folder), results.hashes)
    mechanism = load_mechanism(folder / MECHANISM)
    nominal = NominalDeformation(
        config.deformation.kappa, lambda: PER_MILLE * read_matrix(folder / MATRIX, mechanism.n_legs)
    )
    machine = build_named_machine(mechanism, folder / MECHANISM, *variant.seen, nominal, "variants", folder)
    if not (machine.deformation.uses_matrix and (folder / MATRIX_COVARIANCE).is_file()):
        return machine, None
    return machine, read_matrix_covariance(folder / MATRIX_COVARIANCE, mechanism.n_legs)


def _load_nominal(config: StudyConfig, variant: VariantConfig, folder: Path) -> tuple[Machine, Array | None]:
    """Return the nominal machine of a study's own files, and the covariance of its measured K."""
    inputs = load_inputs(config, folder)
    machine = inputs.machine(variant)
    return machine, find_matrix_covariance(inputs) if machine.deformation.uses_matrix else None


def _read_measured(results: Results, machine: Machine) -> Array | None:
    """Return the actuator positions of the calibration's poses; None of results of earlier versions."""
    assert results.folder is not None
    path = results.folder / KEPT / MEASURED
    return read_measured(path, Legs(machine))[0] if path.is_file() else None


# --- the posterior -----------------------------------------------------------------------------------------------


def _fix(config: StudyConfig, layout: ParameterLayout) -> Array:
    """Return the nominal vector with what the config fixes off nominal, shape (D,)."""
    theta = layout.nominal.copy()
    for symbol, prior in config.parameters.items():
        if isinstance(prior, FixedConfig) and symbol in layout.index:
            theta[layout.index[symbol]] += spread_over_legs(prior.offset, len(layout.index[symbol]), symbol)
    return theta


def _set_named(theta: Array, layout: ParameterLayout, values: dict[str, Any]) -> None:
    """Set parameters (..., D) by name; those of frames and model errors are none of the machine's."""
    position = {name: k for k, name in enumerate(layout.names)}
    for name, value in values.items():
        if name in position:
            theta[..., position[name]] = value


def _find_model_variance(parameters: pd.DataFrame, machine: Machine) -> Array:
    """Return the posterior mean of τ_i², shape (N,), mm²; zero without a model error."""
    n_legs = machine.mechanism.n_legs
    square = (parameters["mean"] ** 2 + parameters["sd"] ** 2).to_dict()
    return np.array([square.get(TAU, square.get(f"{TAU}[{leg}]", 0.0)) for leg in range(1, n_legs + 1)])


def _read_draws(results: Results, variant: str, layout: ParameterLayout, theta: Array) -> Array | None:
    """Return the posterior's draws as parameter vectors (S, D); None where the results have none."""
    values = read_draws_of(results, f"posterior/{stem_of(variant)}.nc")
    if values is None:
        return None
    n_draws = len(next(iter(values.values())))
    draws = np.broadcast_to(theta, (n_draws, layout.size)).copy()
    _set_named(draws, layout, values)
    return draws
