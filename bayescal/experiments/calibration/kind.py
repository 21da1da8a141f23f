"""Calibrations of any machine as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from bayescal.experiments.calibration.compute import compute_calibration
from bayescal.experiments.calibration.inputs import CalibrationInputs, list_machines, read_inputs
from bayescal.experiments.calibration.machine_files import hash_machine_modules, list_sources
from bayescal.experiments.calibration.page.build import build_page, list_variants
from bayescal.experiments.calibration.schema import CalibrationConfig
from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.report.blocks import Page


class Calibration(Experiment[CalibrationConfig, CalibrationInputs]):
    """Any machine calibrated from any of its readings."""

    schema = CalibrationConfig

    def files(self, config: CalibrationConfig, folder: Path) -> list[str]:
        """Return the input files, the source of a machine's own class among them."""
        return [*super().files(config, folder), *list_sources(list_machines(config), folder)]

    def modules(self, config: CalibrationConfig, folder: Path) -> dict[str, str]:
        """Return the hashes of installed modules that the machines' classes stand in."""
        return super().modules(config, folder) | hash_machine_modules(list_machines(config), folder)

    def read(self, config: CalibrationConfig, folder: Path) -> CalibrationInputs:
        """Return machine, readings and variants."""
        return read_inputs(config, folder)

    def compute(self, inputs: CalibrationInputs, run: Run) -> Results:
        """Return the posteriors of all variants and what they predict."""
        return compute_calibration(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        return build_page(results.tables, results.summary)

    def show(self, results: Results, page: Page, console: Console) -> None:
        """Print the verdict, then the variants."""
        super().show(results, page, console)
        for line in list_variants(results.tables):
            console.print(line, soft_wrap=True)

    def list_failures(self, results: Results) -> list[str]:
        """Return that a posterior did not converge."""
        return [] if results.summary["converged"] else ["not everything converged"]
