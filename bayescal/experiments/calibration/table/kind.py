"""Look-up tables as a kind of experiment."""

from __future__ import annotations

import os
from pathlib import Path

from bayescal.experiments.calibration.page.table import build_page
from bayescal.experiments.calibration.table.compute import compute_table
from bayescal.experiments.calibration.table.inputs import TableInputs, read_table
from bayescal.experiments.calibration.table.schema import LookupTableConfig
from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.load import load
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.report.blocks import Page


class LookupTable(Experiment[LookupTableConfig, TableInputs]):
    """What actuators have to do by elevation, temperature and the like."""

    schema = LookupTableConfig

    def files(self, config: LookupTableConfig, folder: Path) -> list[str]:
        """Return the calibration's file and its files."""
        experiment, calibration = load(folder / config.calibration)
        beside = Path(config.calibration).parent
        own = [os.path.normpath(beside / name) for name in experiment.files(calibration, folder / beside)]
        return [*super().files(config, folder), *own]

    def modules(self, config: LookupTableConfig, folder: Path) -> dict[str, str]:
        """Return the hashes of others' modules that the calibration's classes stand in."""
        experiment, calibration = load(folder / config.calibration)
        return experiment.modules(calibration, (folder / config.calibration).parent)

    def read(self, config: LookupTableConfig, folder: Path) -> TableInputs:
        """Return the calibration's variant and the places of the table."""
        return read_table(config, folder)

    def compute(self, inputs: TableInputs, run: Run) -> Results:
        """Return the table."""
        return compute_table(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        return build_page(results.tables, results.summary)
