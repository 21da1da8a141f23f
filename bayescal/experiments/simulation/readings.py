"""Readings of any machine drawn within its priors, with the truth beside them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.data.truth import (
    PARAMETERS_FILE,
    POSES_FILE,
    format_true_parameters,
    format_true_poses,
    read_true_parameters,
    round_as_written,
)
from bayescal.density.priors import NormalPrior, Prior, UniformPrior
from bayescal.experiments.shared.readings.instruments import read_machine
from bayescal.experiments.shared.readings.noise import noise_of_channels
from bayescal.experiments.shared.readings.priors import choose_priors
from bayescal.experiments.shared.readings.reading_tables import USES
from bayescal.experiments.shared.readings.schema import CalibrationSimulationConfig
from bayescal.experiments.shared.readings.workspace import (
    Workspace,
    build_workspace,
    check_given,
    draw_given,
    draw_standing,
)
from bayescal.experiments.shared.simulated_data import Simulated, tabulate_truth
from bayescal.files.csv_tables import format_table
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array

DECIMALS = {"mm": 6, "rad": 9}


@dataclass(frozen=True, eq=False)
class SimulationInputs:
    """A machine with the channels that are read, its priors, its workspace, and a truth if one is given."""

    config: CalibrationSimulationConfig
    model: ReadingModel
    noise: Array
    priors: dict[str, Prior]
    fixed: dict[str, float]
    common: dict[str, tuple[str, ...]]
    workspace: Workspace
    truth: Array | None


def read_simulation(config: CalibrationSimulationConfig, folder: Path) -> SimulationInputs:
    """Return what is simulated; InputError for every fault of the config or its files."""
    whole = read_machine(config, folder)
    check_given(config.given, whole)
    noise = noise_of_channels(config.sensors, whole)
    chosen = whole.select(config.sensors)
    priors, fixed, common = choose_priors(config, config, whole)
    truth = None if config.truth is None else read_true_parameters(folder / config.truth.parameters, whole.layout)
    workspace = build_workspace(whole, config.workspace, config.units)
    return SimulationInputs(config, whole.pick(chosen), noise[chosen], priors, fixed, common, workspace, truth)


def simulate(inputs: SimulationInputs, rng: np.random.Generator) -> Simulated:
    """Return ``readings.csv``, ``true_parameters.csv`` and ``true_poses.csv`` of a machine."""
    config, model = inputs.config, inputs.model
    drawn = _draw_machine(inputs, rng)
    theta = round_as_written(drawn if inputs.truth is None else inputs.truth)
    count = config.n_poses + config.verification_poses
    given = draw_given(config.given, count, rng)
    pose, exact = draw_standing(model, inputs.workspace, theta, given, count, rng)
    measured = exact + inputs.noise * rng.standard_normal(exact.shape)
    names = [f"C{k:03d}" for k in range(1, config.n_poses + 1)]
    names += [f"V{k:02d}" for k in range(1, config.verification_poses + 1)]
    columns = ["pose", "use", *(f"{one.stem}_{one.unit}" for one in model.channels), *given]
    decimals = [DECIMALS.get(one.unit, 9) for one in model.channels]
    rows = [
        (
            name,
            USES[k >= config.n_poses],
            *(f"{x:.{d}f}" for x, d in zip(measured[k], decimals, strict=True)),
            *(f"{value[k]:.12g}" for value in given.values()),
        )
        for k, name in enumerate(names)
    ]
    coordinates = [f"{one.name}_{one.unit}" for one in model.coordinates]
    about = [config.origin, "Columns end with their unit."]
    files = {
        "readings.csv": format_table(about, columns, rows),
        PARAMETERS_FILE: format_true_parameters([config.origin, "True parameters."], model.layout, theta),
        POSES_FILE: format_true_poses([config.origin, "True poses."], coordinates, names, pose),
    }
    layout = model.layout
    truth = tabulate_truth(layout.names, layout.units, layout.nominal, theta)
    return Simulated(files, truth, config.origin, config.n_poses, config.verification_poses)


def _draw_machine(inputs: SimulationInputs, rng: np.random.Generator) -> Array:
    """Return a machine within its priors, (D,)."""
    layout = inputs.model.layout
    theta = layout.nominal.copy()
    for name, value in inputs.fixed.items():
        theta[layout.names.index(name)] = value
    for name, prior in inputs.priors.items():
        places = [layout.names.index(one) for one in inputs.common.get(name, (name,))]
        theta[places] += _draw(prior, rng) - theta[places[0]]
    layout.check(theta)
    return theta


def _draw(prior: Prior, rng: np.random.Generator) -> float:
    if isinstance(prior, UniformPrior):
        return float(rng.uniform(prior.lower, prior.upper))
    assert isinstance(prior, NormalPrior)
    return float(rng.normal(prior.centre, prior.scale))
