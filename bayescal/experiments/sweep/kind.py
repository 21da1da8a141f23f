"""Sweeps as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.sweep.compute import compute_sweep
from bayescal.experiments.sweep.inputs import SweepInputs, list_files, read_sweep
from bayescal.experiments.sweep.page.pages import build_page
from bayescal.experiments.sweep.schema import SweepConfig
from bayescal.report.blocks import Page


class Sweep(Experiment[SweepConfig, SweepInputs]):
    """Many experiments of one kind that differ in some keys."""

    schema = SweepConfig

    def files(self, config: SweepConfig, folder: Path) -> list[str]:
        """Return the experiment's file, those that it extends, and all that members read."""
        return list_files(read_sweep(config, folder))

    def modules(self, config: SweepConfig, folder: Path) -> dict[str, str]:
        """Return the hashes of others' modules that members use."""
        return read_sweep(config, folder).modules

    def read(self, config: SweepConfig, folder: Path) -> SweepInputs:
        """Return the experiment and what varies, checked."""
        return read_sweep(config, folder)

    def compute(self, inputs: SweepInputs, run: Run) -> Results:
        """Return all members' figures."""
        return compute_sweep(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        return build_page(self.config_of(results), results)
