"""Simulated calibrations of hexapods as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal.experiments.runner.experiment import Experiment
from bayescal.experiments.runner.memory import MemoryEstimate, estimate_arrays
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM
from bayescal.report.blocks import Page
from yu2023.indices import read_published, run_indices
from yu2023.pages import build_page
from yu2023.repeats import read_figures, read_parameters, run_accuracy, run_numbers
from yu2023.schema import AccuracyStudyConfig, HexapodCalibrationsConfig, IndexStudyConfig
from yu2023.setup import Setup, read_setup

CANDIDATES, FITS = 8, 3
"""Arrays of all candidates' derivatives, and of calibrations' poses."""


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

    def estimate_memory(self, inputs: Setup) -> MemoryEstimate:
        """Return what candidates take, and the calibrations that are fitted together."""
        config, study, n = inputs.config, inputs.config.study, inputs.machine.layout.size
        if isinstance(study, IndexStudyConfig):
            most, fits = max(one.poses for one in study.conditions), max(study.parameter_sets, study.noise_draws)
        else:
            most, fits = int(np.max(study.poses)), study.repeats
        return estimate_arrays(
            {"candidates": config.selection.candidates, "poses": most, "calibrations": fits},
            [
                (CANDIDATES, config.selection.candidates + config.verification_poses, DEGREES_OF_FREEDOM, n),
                (FITS, fits, most, DEGREES_OF_FREEDOM),
                (FITS, fits, config.verification_poses, DEGREES_OF_FREEDOM),
            ],
            "fewer candidates, poses or calibrations",
        )

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
