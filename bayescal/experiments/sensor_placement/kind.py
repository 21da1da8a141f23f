"""Sensor placement as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.sensor_placement.compute import compute_placement
from bayescal.experiments.sensor_placement.inputs import PlacementInputs, read_placement
from bayescal.experiments.sensor_placement.page.pages import build_page
from bayescal.experiments.sensor_placement.schema import PlacementConfig
from bayescal.report.blocks import Page


class SensorPlacement(Experiment[PlacementConfig, PlacementInputs]):
    """Which sensors to buy: every set judged by accuracy and price."""

    schema = PlacementConfig
    digits = 6

    def read(self, config: PlacementConfig, folder: Path) -> PlacementInputs:
        """Return machine, choices, poses and workspace."""
        return read_placement(config, folder)

    def compute(self, inputs: PlacementInputs, run: Run) -> Results:
        """Return how good every set is."""
        return compute_placement(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        return build_page(results.summary, results.tables)
