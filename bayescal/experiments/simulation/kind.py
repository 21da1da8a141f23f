"""Simulated measurements as a kind of experiment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.data.instruments.simulate import count_stations, simulate_readings, true_frames
from bayescal.data.schema import SimulationConfig
from bayescal.data.simulation import Twin, build_twin, format_survey, format_truth, name_poses, survey_twin
from bayescal.experiments.shared.look import look_at_machine
from bayescal.experiments.shared.simulated_data import Simulated, SimulatedData, tabulate_truth
from bayescal.machines.frames import frame_blocks
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM


@dataclass(frozen=True, eq=False)
class PlacedTwin:
    """A twin, and the folder where its config's file names start."""

    twin: Twin
    folder: Path


class Simulation(SimulatedData[SimulationConfig, PlacedTwin]):
    """Targets, or an instrument's readings, and the actuator positions of a twin."""

    schema = SimulationConfig

    def read(self, config: SimulationConfig, folder: Path) -> PlacedTwin:
        """Return the twin."""
        if config.instrument is not None:
            true_frames(config.instrument, count_stations(config.instrument, folder))
        return PlacedTwin(build_twin(config, folder), folder)

    def count(self, inputs: PlacedTwin) -> tuple[int, int]:
        """Return the number of poses, and how many coordinates of targets or of the platform are seen at each."""
        twin, targets = inputs.twin, inputs.twin.config.targets
        n_poses, n_legs = len(twin.calibration) + len(twin.verification), twin.machine.mechanism.n_legs
        if targets is None:
            return n_poses, n_legs * DEGREES_OF_FREEDOM
        n_targets = sum(ring.count for ring in (*targets.base, *targets.platform)) + n_legs * targets.per_pad
        return n_poses, n_legs + 3 * n_targets

    def list_file_faults(self, content: Mapping[str, Any], folder: Path) -> list[str]:
        """Return what is wrong with the machine's file by itself."""
        return look_at_machine(content, folder)[1]

    def seed(self, inputs: PlacedTwin) -> int:
        """Return the config's seed."""
        return inputs.twin.config.seed

    def simulate(self, inputs: PlacedTwin, rng: np.random.Generator) -> Simulated:
        """Return the files of the survey or of the instrument, true parameters and true poses."""
        twin, layout = inputs.twin, inputs.twin.machine.layout
        config, theta = twin.config, twin.theta
        if config.instrument is None:
            survey, poses = survey_twin(twin, rng)
            files = format_survey(survey, config.origin)
        else:
            files, poses = simulate_readings(twin, config.instrument, inputs.folder, rng)
            n_stations = count_stations(config.instrument, inputs.folder)
            layout = layout.extend(frame_blocks(n_stations))
            theta = np.concatenate([theta, true_frames(config.instrument, n_stations)])
        truth = tabulate_truth(layout.names, layout.units, layout.nominal, theta)
        files |= format_truth(twin, name_poses(twin)[0], poses)
        return Simulated(files, truth, config.origin, len(twin.calibration), len(twin.verification))
