"""Pose selection as a kind of experiment."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from bayescal.experiments.runner.experiment import Experiment
from bayescal.experiments.runner.memory import MemoryEstimate, check_memory, estimate_arrays
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.experiments.selection.inputs import SelectionInputs, check_problems, read_selection
from bayescal.experiments.selection.rows import ROWS
from bayescal.experiments.selection.schema import SelectionConfig
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM
from bayescal.pose_selection.domain import AT_ONCE
from bayescal.report.blocks import Page

COPIES, DERIVATIVES, PLACING = 3, 8, 12
"""Arrays held of the rows of all candidates, of some candidates' derivatives, and where poses are placed."""


class Selection(Experiment[SelectionConfig, SelectionInputs]):
    """Which poses to measure, by criteria and methods compared."""

    schema: ClassVar[type[SelectionConfig]] = SelectionConfig
    rows = ROWS
    digits = 12

    def read(self, config: SelectionConfig, folder: Path) -> SelectionInputs:
        """Return what the experiment computes with; InputError where poses are too few or too many, too."""
        inputs = read_selection(config, folder)
        check_memory(self.estimate_memory(inputs), 1)
        check_problems(inputs)
        return inputs

    def estimate_memory(self, inputs: SelectionInputs) -> MemoryEstimate:
        """Return what the rows of all candidates take."""
        n, n_parameters = inputs.config.candidates.count, len(inputs.design.names)
        n_rows = max(DEGREES_OF_FREEDOM, inputs.design.machine.mechanism.n_legs)
        held = [
            (COPIES, n, n_rows, n_parameters),
            (DERIVATIVES, min(n, AT_ONCE), n_rows, n_parameters + n_rows),
            (PLACING, n, n_rows, n_rows),
        ]
        return estimate_arrays({"candidates": n, "parameters": n_parameters}, held, "fewer candidates")

    def compute(self, inputs: SelectionInputs, run: Run) -> Results:
        """Return the selections and what calibrations with them achieve."""
        from bayescal.experiments.selection.compute import compute_selections  # with pandas, for those who compute

        return compute_selections(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        from bayescal.experiments.selection.page import build_page  # with matplotlib, for those who make pages
        from bayescal.experiments.selection.verdict import Tables

        return build_page(Tables(self.config_of(results), results))
