"""Simulated readings of any machine as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal.experiments.shared.readings.machine_kind import MachineExperiment
from bayescal.experiments.shared.readings.schema import CalibrationSimulationConfig
from bayescal.experiments.shared.simulated_data import Simulated, SimulatedData
from bayescal.experiments.simulation.readings import SimulationInputs, read_simulation, simulate


class CalibrationSimulation(
    MachineExperiment[CalibrationSimulationConfig, SimulationInputs],
    SimulatedData[CalibrationSimulationConfig, SimulationInputs],
):
    """Readings of any machine, with the truth beside them."""

    schema = CalibrationSimulationConfig

    def machines(self, config: CalibrationSimulationConfig) -> list[str]:
        """Return the machine's file."""
        return [config.machine]

    def read(self, config: CalibrationSimulationConfig, folder: Path) -> SimulationInputs:
        """Return machine, noise and workspace."""
        return read_simulation(config, folder)

    def count(self, inputs: SimulationInputs) -> tuple[int, int]:
        """Return the number of poses and of channels."""
        return inputs.config.n_poses + inputs.config.verification_poses, len(inputs.model.channels)

    def seed(self, inputs: SimulationInputs) -> int:
        """Return the config's seed."""
        return inputs.config.seed

    def simulate(self, inputs: SimulationInputs, rng: np.random.Generator) -> Simulated:
        """Return readings, true parameters and true poses."""
        return simulate(inputs, rng)
