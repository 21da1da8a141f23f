"""Simulated calibrations of hexapods as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.report.blocks import Page
from bayescal.reproductions.yu2023.accuracy import read_figures, read_parameters, run_accuracy
from bayescal.reproductions.yu2023.indices import read_published, run_indices
from bayescal.reproductions.yu2023.numbers import run_numbers
from bayescal.reproductions.yu2023.page.pages import build_page
from bayescal.reproductions.yu2023.schema import AccuracyStudyConfig, HexapodCalibrationsConfig, IndexStudyConfig
from bayescal.reproductions.yu2023.setup import Setup, read_setup


class HexapodCalibrations(Experiment[HexapodCalibrationsConfig, Setup]):
    """Calibrations of hexapods, simulated to compare observability indices, sets of poses and their number."""

    schema = HexapodCalibrationsConfig

    def read(self, config: HexapodCalibrationsConfig, folder: Path) -> Setup:
        """Return machine, workspace and candidates; tables that are needed later are read once, to find faults."""
        setup, study = read_setup(config, folder), config.study
        if isinstance(study, IndexStudyConfig):
            read_published(setup, study)
        else:
            setup.read_machine(study.parameter_errors)
        if isinstance(study, AccuracyStudyConfig):
            read_figures(setup, study.published)
            read_parameters(setup, study.published_parameters)
        return setup

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
