"""Simulated calibrations of hexapods as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM
from bayescal.report.blocks import Page
from yu2023.indices import read_published, run_indices
from yu2023.pages import build_page
from yu2023.repeats import read_figures, read_parameters, run_accuracy, run_numbers
from yu2023.schema import AccuracyStudyConfig, HexapodCalibrationsConfig, IndexStudyConfig, StudyOfConfig
from yu2023.setup import Setup, read_setup

CANDIDATES, FITS = 8, 3
"""Arrays of all candidates' derivatives, and of calibrations' poses."""


def _list_numbers(study: StudyOfConfig) -> set[int]:
    """Return how many poses are selected."""
    if isinstance(study, IndexStudyConfig):
        return {one.poses for one in study.conditions}
    return {study.poses} if isinstance(study, AccuracyStudyConfig) else set(study.poses)


class HexapodCalibrations(Experiment[HexapodCalibrationsConfig, Setup]):
    """Calibrations of hexapods, simulated to compare observability indices, sets of poses and their number."""

    schema = HexapodCalibrationsConfig

    def read(self, config: HexapodCalibrationsConfig, folder: Path) -> Setup:
        """Return machine, workspace and candidates; tables that are needed later are read once, to find faults.

        So are all numbers of poses put to the candidates that they are selected from.
        """
        setup, study = read_setup(config, folder), config.study
        for scale in [1.0, *study.workspace_scales] if isinstance(study, IndexStudyConfig) else [1.0]:
            scaled = setup if scale == 1.0 else setup.scale_workspace(scale)
            for n in sorted(_list_numbers(study)):
                scaled.problem("O1", n)
        if isinstance(study, IndexStudyConfig):
            read_published(setup, study)
        else:
            setup.read_machine(study.parameter_errors)
        if isinstance(study, AccuracyStudyConfig):
            read_figures(setup, study.published)
            read_parameters(setup, study.published_parameters)
        return setup

    def estimate_memory(self, inputs: Setup) -> Need:
        """Return what candidates take, and the calibrations that are fitted together."""
        config, study, n = inputs.config, inputs.config.study, inputs.machine.layout.size
        several = isinstance(study, IndexStudyConfig)
        fits = max(study.parameter_sets, study.noise_draws) if several else study.repeats
        most = max(_list_numbers(study))
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
