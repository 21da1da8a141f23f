"""Sensor placement as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.sensor_placement.compute import compute_placement
from bayescal.experiments.sensor_placement.inputs import PlacementInputs, read_placement
from bayescal.experiments.sensor_placement.page.pages import build_page
from bayescal.experiments.sensor_placement.schema import PlacementConfig
from bayescal.report.blocks import Page

DERIVATIVES, LOCATED, READINGS, AT_ONCE = 6, 9, 4, 16
"""Arrays of all readings by all parameters, of simulated machines' readings in use with their slopes, of those that
they are calibrated from, and machines calibrated at a time, as measured.
"""


class SensorPlacement(Experiment[PlacementConfig, PlacementInputs]):
    """Which sensors to buy: every set judged by accuracy and price."""

    schema = PlacementConfig
    digits = 6

    def read(self, config: PlacementConfig, folder: Path) -> PlacementInputs:
        """Return machine, choices, poses and workspace."""
        return read_placement(config, folder)

    def estimate_memory(self, inputs: PlacementInputs) -> Need:
        """Return what derivatives at all poses take, and machines that are calibrated side by side."""
        config, n, n_readings = inputs.config, len(inputs.free), len(inputs.sensors.chosen)
        places, n_sets = len(inputs.pose) + len(inputs.workspace), 2 ** len(inputs.optional)
        machines = config.machines if config.simulated_sets else 0
        slopes = n + inputs.pose.shape[1]
        return estimate_arrays(
            {"poses": len(inputs.pose), "sets of sensors": n_sets, "simulated machines": machines},
            [
                (DERIVATIVES, 1 + min(machines, AT_ONCE), places, n_readings, slopes),
                (LOCATED, machines, len(inputs.workspace), n_readings, 1 + inputs.pose.shape[1]),
                (READINGS, machines, len(inputs.pose), n_readings),
            ],
            "fewer poses or machines",
            kept=[(4, n_sets, len(inputs.choices))],
        )

    def compute(self, inputs: PlacementInputs, run: Run) -> Results:
        """Return how good every set is."""
        return compute_placement(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        return build_page(results.summary, results.tables)
