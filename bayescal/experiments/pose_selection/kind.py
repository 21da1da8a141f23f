"""Pose selection as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.pose_selection.compute import compute_selections
from bayescal.experiments.pose_selection.inputs import SelectionInputs, read_selection
from bayescal.experiments.pose_selection.page import build_page
from bayescal.experiments.pose_selection.published import check_published
from bayescal.experiments.pose_selection.schema import SelectionConfig
from bayescal.report.blocks import Page


class PoseSelection(Experiment[SelectionConfig, SelectionInputs]):
    """Which poses to measure, by criteria and methods set side by side."""

    schema = SelectionConfig
    digits = 12

    def read(self, config: SelectionConfig, folder: Path) -> SelectionInputs:
        """Return what the experiment computes with."""
        inputs = read_selection(config, folder)
        check_published(config, inputs.published)
        return inputs

    def compute(self, inputs: SelectionInputs, run: Run) -> Results:
        """Return the selections and what they are worth."""
        return compute_selections(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        return build_page(self.config_of(results), results)
