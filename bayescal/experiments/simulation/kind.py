"""Simulated photogrammetry as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal.data.schema import SimulationConfig
from bayescal.data.simulation import Twin, build_twin, format_survey, simulate_survey
from bayescal.experiments.shared.simulated_data import Simulated, SimulatedData, tabulate_truth


class Simulation(SimulatedData[SimulationConfig, Twin]):
    """Targets, actuator positions and target coordinates of a twin."""

    schema = SimulationConfig

    def read(self, config: SimulationConfig, folder: Path) -> Twin:
        """Return the twin."""
        return build_twin(config, folder)

    def seed(self, inputs: Twin) -> int:
        """Return the config's seed."""
        return inputs.config.seed

    def simulate(self, inputs: Twin, rng: np.random.Generator) -> Simulated:
        """Return the survey's files."""
        survey, layout = simulate_survey(inputs, rng), inputs.machine.layout
        truth = tabulate_truth(layout.names, layout.units, layout.nominal, inputs.theta)
        origin = inputs.config.origin
        counts = len(inputs.calibration), len(inputs.verification)
        return Simulated(format_survey(survey, origin), truth, origin, *counts)
