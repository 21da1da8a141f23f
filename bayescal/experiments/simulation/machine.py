"""The machine that is simulated, as nominal and as it truly is."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal.config.classes import name_failures
from bayescal.config.load import look_up, read_toml
from bayescal.data.truth import read_true_parameters, round_as_written
from bayescal.errors import InputError
from bayescal.experiments.shared.per_leg import spread_over_legs
from bayescal.experiments.shared.readings.instruments import read_instruments
from bayescal.experiments.simulation.schema import SimulationConfig
from bayescal.files.csv_tables import read_matrix
from bayescal.machines.deformations import MatrixDeformation
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.read import build_chosen_machine, choose_model, load_mechanism, read_reading_model
from bayescal.machines.readings import Legs, ReadingModel, place
from bayescal.machines.readings.legs import TILTS
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units


def read_model(config: SimulationConfig, folder: Path) -> ReadingModel:
    """Return the machine before the config's instruments: any machine's file, or a mechanism's seen through ``model``.

    Raises
    ------
    InputError
        For faults of the files, for a mechanism without a model, and for a model or matrix of another machine.
    """
    path, matrix = folder / config.machine, None if config.truth is None else config.truth.deformation_matrix
    if "kind" not in read_toml(path)[0]:
        return place(_read_mechanism(config, folder, matrix), read_instruments(config, folder))
    for field, found in (("model", config.model), ("truth.deformation_matrix", matrix)):
        if found is not None:
            raise InputError(f"{field}: found {found!r} beside a machine whose file says its kind, expected none")
    return place(read_reading_model(path), read_instruments(config, folder))


def _read_mechanism(config: SimulationConfig, folder: Path, matrix: str | None) -> Legs:
    mechanism = load_mechanism(folder / config.machine)
    if config.model is None:
        raise InputError("model: found none, expected the kinematic model of the mechanism")
    n_legs = mechanism.n_legs
    bent = np.zeros((n_legs, n_legs)) if matrix is None else 1e-3 * read_matrix(folder / matrix, n_legs)
    chosen = choose_model(config.model, "model", folder)
    with name_failures(chosen.found, "model", folder):
        machine = build_chosen_machine(chosen, mechanism, MatrixDeformation(bent))
    return Legs(machine, inclined=any(name.partition("[")[0] in TILTS for name in config.sensors))


def read_truth(config: SimulationConfig, layout: ParameterLayout, folder: Path) -> Array | None:
    """Return the given true parameters (D,) with the digits that are written of them; None where none are given."""
    truth = config.truth
    if truth is None:
        return None
    if truth.parameters is not None:
        return round_as_written(read_true_parameters(folder / truth.parameters, layout))
    theta, units = layout.nominal.copy(), Units(config.units.length, config.units.angle)
    for symbol, offset in (truth.offsets or {}).items():
        index = look_up(layout.index, symbol, "truth.offsets", folder)
        values = spread_over_legs(offset, len(index), symbol, "truth.offsets")
        theta[index] += units.factor(layout.block(symbol).unit) * np.array(values)
    layout.check(theta)
    return round_as_written(theta)
