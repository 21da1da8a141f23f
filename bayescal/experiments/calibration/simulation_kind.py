"""Simulated readings of any machine as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal.experiments.calibration.machine_files import hash_machine_modules, list_sources
from bayescal.experiments.calibration.schema import CalibrationSimulationConfig
from bayescal.experiments.calibration.simulate import SimulationInputs, read_simulation, simulate
from bayescal.experiments.shared.simulated_data import Simulated, SimulatedData


class CalibrationSimulation(SimulatedData[CalibrationSimulationConfig, SimulationInputs]):
    """Readings of any machine, with the truth beside them."""

    schema = CalibrationSimulationConfig

    def files(self, config: CalibrationSimulationConfig, folder: Path) -> list[str]:
        """Return the input files, the source of the machine's own class among them."""
        return [*super().files(config, folder), *list_sources([config.machine], folder)]

    def modules(self, config: CalibrationSimulationConfig, folder: Path) -> dict[str, str]:
        """Return the hash of the installed module that the machine's class stands in."""
        return super().modules(config, folder) | hash_machine_modules([config.machine], folder)

    def read(self, config: CalibrationSimulationConfig, folder: Path) -> SimulationInputs:
        """Return machine, noise and workspace."""
        return read_simulation(config, folder)

    def seed(self, inputs: SimulationInputs) -> int:
        """Return the config's seed."""
        return inputs.config.seed

    def simulate(self, inputs: SimulationInputs, rng: np.random.Generator) -> Simulated:
        """Return readings, true parameters and true poses."""
        return simulate(inputs, rng)
