"""Simulated self-calibrations as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.report.blocks import Page
from bayescal.reproductions.sika2008.compute import compute_self_calibrations
from bayescal.reproductions.sika2008.page.pages import build_page
from bayescal.reproductions.sika2008.published import Published, read_published
from bayescal.reproductions.sika2008.schema import SelfCalibrationsConfig
from bayescal.reproductions.sika2008.setup import Setup, read_setup

READINGS, AT_ONCE = 8, 16
"""Arrays of all readings, and machines calibrated at a time."""


class SelfCalibrations(Experiment[SelfCalibrationsConfig, tuple[Setup, Published]]):
    """Self-calibrations of a documented machine and of plausible ones, simulated with sets of sensors."""

    schema = SelfCalibrationsConfig
    digits = 6

    def read(self, config: SelfCalibrationsConfig, folder: Path) -> tuple[Setup, Published]:
        """Return the machine with its sets of sensors, and what was printed."""
        return read_setup(config, folder), read_published(config, folder)

    def estimate_memory(self, inputs: tuple[Setup, Published]) -> Need:
        """Return what the readings of all machines take, and derivatives of those calibrated at a time."""
        setup, machines = inputs[0], inputs[0].config.calibrations
        sensors, n_poses = len(setup.plans.every.sensors.chosen), len(setup.pose) + len(setup.targets)
        return estimate_arrays(
            {"poses": len(setup.pose), "simulated machines": machines},
            [
                (READINGS, machines, n_poses, sensors),
                (READINGS, AT_ONCE, n_poses, sensors, len(setup.plans.every.free.places)),
            ],
            "fewer poses or machines",
        )

    def compute(self, inputs: tuple[Setup, Published], run: Run) -> Results:
        """Return calibrabilities and errors, beside what was printed."""
        return compute_self_calibrations(*inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        config = self.config_of(results)
        return build_page(config.name, config.title, results.tables, results.summary)
