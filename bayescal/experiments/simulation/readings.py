"""Readings of any machine, given or drawn within its priors, with the truth beside them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.data.truth import (
    PARAMETERS_FILE,
    POSES_FILE,
    format_true_parameters,
    format_true_poses,
    round_as_written,
)
from bayescal.density.priors import NormalPrior, Prior, UniformPrior
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
from bayescal.experiments.simulation.machine import read_model, read_truth
from bayescal.experiments.simulation.schema import SimulationConfig
from bayescal.files.csv_tables import format_table
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array

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
