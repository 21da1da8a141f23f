"""Simulated photogrammetry as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal.data.schema import SimulationConfig
from bayescal.data.simulation import Twin, build_twin, format_survey, format_truth, survey_twin
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
        """Return the survey's files, true parameters and true poses."""
        (survey, poses), layout = survey_twin(inputs, rng), inputs.machine.layout
        truth = tabulate_truth(layout.names, layout.units, layout.nominal, inputs.theta)
        origin = inputs.config.origin
        counts = len(inputs.calibration), len(inputs.verification)
        files = format_survey(survey, origin) | format_truth(inputs, survey.poses, poses)
        return Simulated(files, truth, origin, *counts)
