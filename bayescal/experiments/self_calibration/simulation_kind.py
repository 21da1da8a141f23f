"""Simulated readings as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal.data.truth import read_true_parameters
from bayescal.experiments.self_calibration.schema import ReadingSimulationConfig
from bayescal.experiments.self_calibration.simulate import simulate_readings
from bayescal.experiments.shared.simulated_data import Simulated, SimulatedData
from bayescal.machines.read import read_sliding_platform
from bayescal.machines.readings import SlidingPlatform
from bayescal.numerics.geometry import Array

type Inputs = tuple[ReadingSimulationConfig, SlidingPlatform, Array | None]


class ReadingSimulation(SimulatedData[ReadingSimulationConfig, Inputs]):
    """Readings of a machine's own sensors, with the truth beside them."""

    schema = ReadingSimulationConfig

    def read(self, config: ReadingSimulationConfig, folder: Path) -> Inputs:
        """Return config, machine and, where the config names a file of them, true parameters."""
        model = read_sliding_platform(folder / config.machine)
        given = None if config.truth is None else read_true_parameters(folder / config.truth.parameters, model.layout)
        return config, model, given

    def count(self, inputs: Inputs) -> tuple[int, int]:
        """Return the number of poses and of sensors."""
        config, model, _ = inputs
        return config.poses.n_poses + config.verification_poses, len(model.channels)

    def seed(self, inputs: Inputs) -> int:
        """Return the config's seed."""
        return inputs[0].seed

    def simulate(self, inputs: Inputs, rng: np.random.Generator) -> Simulated:
        """Return readings, true parameters and true poses."""
        config, model, truth = inputs
        return simulate_readings(config, model, rng, truth)
