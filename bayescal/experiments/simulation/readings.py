"""Readings of any machine, given or drawn within its priors, with the truth beside them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.config.classes import name_failures
from bayescal.config.load import look_up, read_toml
from bayescal.data.truth import (
    PARAMETERS_FILE,
    POSES_FILE,
    format_true_parameters,
    format_true_poses,
    read_true_parameters,
    round_as_written,
)
from bayescal.density.priors import NormalPrior, Prior, UniformPrior
from bayescal.errors import InputError
from bayescal.experiments.shared.per_leg import spread_over_legs
from bayescal.experiments.shared.readings.instruments import read_instruments
from bayescal.experiments.shared.readings.noise import noise_of_channels
from bayescal.experiments.shared.readings.priors import choose_priors
from bayescal.experiments.shared.readings.reading_tables import USES
from bayescal.experiments.shared.readings.workspace import (
    Workspace,
    build_workspace,
    check_given,
    draw_given,
    draw_standing,
)
from bayescal.experiments.simulation.schema import SimulationConfig
from bayescal.files.csv_tables import format_table, read_matrix
from bayescal.machines.deformations import MatrixDeformation
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.read import build_chosen_machine, choose_model, load_mechanism, read_reading_model
from bayescal.machines.readings import Legs, ReadingModel, place
from bayescal.machines.readings.legs import TILTS
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units

DECIMALS = {"mm": 6, "rad": 9}


@dataclass(frozen=True, eq=False)
class ReadingPlan:
    """A machine with the channels that are read, its priors, its workspace, and a truth if one is given."""

    config: SimulationConfig
    model: ReadingModel
    noise: Array
    priors: dict[str, Prior]
    fixed: dict[str, float]
    common: dict[str, tuple[str, ...]]
    workspace: Workspace
    truth: Array | None

    @property
    def layout(self) -> ParameterLayout:
        """The true parameters'."""
        return self.model.layout

    @property
    def n_held_back(self) -> int:
        """How many poses are held back."""
        return self.config.verification_poses

    @property
    def n_poses(self) -> int:
        """Number of poses, those held back among them."""
        return (self.config.n_poses or 0) + self.n_held_back

    @property
    def width(self) -> int:
        """How many numbers are simulated of each."""
        return len(self.model.channels)

    def simulate(self, rng: np.random.Generator) -> tuple[dict[str, str], Array]:
        """Return the texts of all files by their names, and the true parameters (D,)."""
        return _simulate(self, rng)


def plan_readings(config: SimulationConfig, folder: Path) -> ReadingPlan:
    """Return what is simulated; InputError for every fault of the config or its files."""
    whole = read_model(config, folder)
    check_given(config.given, whole)
    noise = noise_of_channels(config.sensors, whole)
    chosen = whole.select(config.sensors)
    priors, fixed, common = choose_priors(config, config, whole.layout)
    truth = read_truth(config, whole.layout, folder)
    workspace = build_workspace(whole, config.workspace, config.units)
    return ReadingPlan(config, whole.pick(chosen), noise[chosen], priors, fixed, common, workspace, truth)


def _simulate(plan: ReadingPlan, rng: np.random.Generator) -> tuple[dict[str, str], Array]:
    config, model = plan.config, plan.model
    drawn = _draw_machine(plan, rng)  # in any case, so that a truth that is given leaves poses and noise as they are
    theta = round_as_written(drawn if plan.truth is None else plan.truth)
    given = draw_given(config.given, plan.n_poses, rng)
    pose, exact = draw_standing(model, plan.workspace, theta, given, plan.n_poses, rng)
    measured = exact + plan.noise * rng.standard_normal(exact.shape)
    n_calibration = plan.n_poses - plan.n_held_back
    names = [f"C{k:03d}" for k in range(1, n_calibration + 1)]
    names += [f"V{k:02d}" for k in range(1, plan.n_held_back + 1)]
    columns = ["pose", "use", *(f"{one.stem}_{one.unit}" for one in model.channels), *given]
    decimals = [DECIMALS.get(one.unit, 9) for one in model.channels]
    rows = [
        (
            name,
            USES[k >= n_calibration],
            *(f"{x:.{d}f}" for x, d in zip(measured[k], decimals, strict=True)),
            *(f"{value[k]:.12g}" for value in given.values()),
        )
        for k, name in enumerate(names)
    ]
    coordinates = [f"{one.name}_{one.unit}" for one in model.coordinates]
    origin = config.origin.text
    files = {
        "readings.csv": format_table([origin, "Columns end with their unit."], columns, rows),
        PARAMETERS_FILE: format_true_parameters([origin, "True parameters."], model.layout, theta),
        POSES_FILE: format_true_poses([origin, "True poses."], coordinates, names, pose),
    }
    return files, theta


def _draw_machine(plan: ReadingPlan, rng: np.random.Generator) -> Array:
    """Return a machine within its priors, (D,)."""
    layout = plan.model.layout
    theta = layout.nominal.copy()
    for name, value in plan.fixed.items():
        theta[layout.names.index(name)] = value
    for name, prior in plan.priors.items():
        places = [layout.names.index(one) for one in plan.common.get(name, (name,))]
        theta[places] += _draw(prior, rng) - theta[places[0]]
    layout.check(theta)
    return theta


def _draw(prior: Prior, rng: np.random.Generator) -> float:
    if isinstance(prior, UniformPrior):
        return float(rng.uniform(prior.lower, prior.upper))
    assert isinstance(prior, NormalPrior)
    return float(rng.normal(prior.centre, prior.scale))


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
