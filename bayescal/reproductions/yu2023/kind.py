"""Simulated calibrations of hexapods as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.report.blocks import Page
from bayescal.reproductions.yu2023.accuracy import run_accuracy
from bayescal.reproductions.yu2023.indices import run_indices
from bayescal.reproductions.yu2023.numbers import run_numbers
from bayescal.reproductions.yu2023.page.pages import build_page
from bayescal.reproductions.yu2023.schema import AccuracyStudyConfig, HexapodCalibrationsConfig, IndexStudyConfig
from bayescal.reproductions.yu2023.setup import Setup, read_setup


class HexapodCalibrations(Experiment[HexapodCalibrationsConfig, Setup]):
    """Calibrations of hexapods, simulated to compare observability indices, sets of poses and their number."""

    schema = HexapodCalibrationsConfig

    def read(self, config: HexapodCalibrationsConfig, folder: Path) -> Setup:
        """Return machine, workspace and candidates."""
        return read_setup(config, folder)

    def compute(self, inputs: Setup, run: Run) -> Results:
        """Return the tables and the summary of one of the three studies."""
        study = inputs.config.study
        if isinstance(study, IndexStudyConfig):
            return run_indices(inputs, study, run)
        if isinstance(study, AccuracyStudyConfig):
            return run_accuracy(inputs, study, run)
        return run_numbers(inputs, study, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        config = self.config_of(results)
        return build_page(config.study.of, config.name, config.title, results.tables, results.summary)
