"""Simulated readings as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal.experiments.self_calibration.schema import ReadingSimulationConfig
from bayescal.experiments.self_calibration.simulate import simulate_readings
from bayescal.experiments.shared.simulated_data import Simulated, SimulatedData
from bayescal.machines.read import read_sliding_platform
from bayescal.machines.readings import SlidingPlatform

type Inputs = tuple[ReadingSimulationConfig, SlidingPlatform]


class ReadingSimulation(SimulatedData[ReadingSimulationConfig, Inputs]):
    """Readings of a machine's own sensors, with the truth beside them."""

    schema = ReadingSimulationConfig

    def read(self, config: ReadingSimulationConfig, folder: Path) -> Inputs:
        """Return config and machine."""
        return config, read_sliding_platform(folder / config.machine)

    def seed(self, inputs: Inputs) -> int:
        """Return the config's seed."""
        return inputs[0].seed

    def simulate(self, inputs: Inputs, rng: np.random.Generator) -> Simulated:
        """Return readings, true parameters and true poses."""
        return simulate_readings(*inputs, rng)
