"""Simulated self-calibrations as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.report.blocks import Page
from bayescal.reproductions.sika2008.compute import compute_self_calibrations
from bayescal.reproductions.sika2008.page.pages import build_page
from bayescal.reproductions.sika2008.published import Published, read_published
from bayescal.reproductions.sika2008.schema import SelfCalibrationsConfig
from bayescal.reproductions.sika2008.setup import Setup, read_setup


class SelfCalibrations(Experiment[SelfCalibrationsConfig, tuple[Setup, Published]]):
    """Self-calibrations of a documented machine and of plausible ones, simulated with sets of sensors."""

    schema = SelfCalibrationsConfig
    digits = 6

    def read(self, config: SelfCalibrationsConfig, folder: Path) -> tuple[Setup, Published]:
        """Return the machine with its sets of sensors, and what was printed."""
        return read_setup(config, folder), read_published(config, folder)

    def compute(self, inputs: tuple[Setup, Published], run: Run) -> Results:
        """Return calibrabilities and errors, beside what was printed."""
        return compute_self_calibrations(*inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        config = self.config_of(results)
        return build_page(config.name, config.title, results.tables, results.summary)
