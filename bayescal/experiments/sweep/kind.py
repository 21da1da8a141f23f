"""Sweeps as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.runner.experiment import Experiment
from bayescal.experiments.runner.memory import MemoryEstimate
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.experiments.sweep.inputs import SweepInputs, list_files, read_sweep
from bayescal.experiments.sweep.rows import ROWS
from bayescal.experiments.sweep.schema import SweepConfig
from bayescal.report.blocks import Page


class Sweep(Experiment[SweepConfig, SweepInputs]):
    """Many experiments of one kind that differ in some keys."""

    schema = SweepConfig
    rows = ROWS
    _last: tuple[SweepConfig, Path, SweepInputs] | None = None
    """What was read last: files and modules are asked for after the inputs, and every axis is checked in reading."""

    def files(self, config: SweepConfig, folder: Path) -> list[str]:
        """Return the experiment's file, those that it extends, and all that members read."""
        return list_files(self.read(config, folder))

    def modules(self, config: SweepConfig, folder: Path) -> dict[str, str]:
        """Return the hashes of others' modules that members use."""
        return self.read(config, folder).modules

    def read(self, config: SweepConfig, folder: Path) -> SweepInputs:
        """Return the experiment and what varies, checked."""
        if self._last is None or self._last[0] is not config or self._last[1] != folder:
            self._last = (config, folder, read_sweep(config, folder))
        return self._last[2]

    def estimate_memory(self, inputs: SweepInputs) -> MemoryEstimate:
        """Return what a member takes, as the experiment stands; each is judged by itself before it is computed."""
        return inputs.need

    def compute(self, inputs: SweepInputs, run: Run) -> Results:
        """Return all members' figures."""
        from bayescal.experiments.sweep.compute import compute_sweep  # with pandas, for those who compute

        return compute_sweep(inputs, run)

    def list_failures(self, results: Results) -> list[str]:
        """Return which figures no member has."""
        from bayescal.experiments.sweep.compute import list_missing

        missing = list_missing(results.summary)
        return [f"found {', '.join(missing)} in no member's summary"] if missing else []

    def page(self, results: Results) -> Page:
        """Return the page."""
        from bayescal.experiments.sweep.page import build_page  # with matplotlib, for those who make pages

        return build_page(self.config_of(results), results)
