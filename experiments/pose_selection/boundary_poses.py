"""Pose selection that counts poses at the boundary, where RR-8096 finds the optimal ones (section 6.3.2)."""

from __future__ import annotations

from bayescal.experiments.runner.results import Results
from bayescal.experiments.selection.compute import BOUNDARY_FRACTION
from bayescal.experiments.selection.kind import Selection
from bayescal.experiments.selection.page import BLOCKS, build_page
from bayescal.experiments.selection.schema import SelectionConfig
from bayescal.experiments.selection.verdict import JUDGEMENTS, Tables
from bayescal.report.blocks import Page, Statement
from bayescal.report.numbers import format_percent


class BoundaryPosesConfig(SelectionConfig):
    """An experiment on pose selection."""

    kind: str
    """The file and this kind."""


class BoundaryPoses(Selection):
    """Which poses to measure, and how many lie at the boundary."""

    schema = BoundaryPosesConfig

    def page(self, results: Results) -> Page:
        """Return the page."""
        judgements = (JUDGEMENTS[0], judge_boundary, *JUDGEMENTS[1:])
        return build_page(Tables(self.config_of(results), results), BLOCKS, judgements)


def judge_boundary(tables: Tables) -> list[Statement]:
    """Return how many of the chosen poses lie at the boundary."""
    shares = tables["selections"].groupby("label", sort=False)["boundary_fraction"].mean().dropna()
    label, share = str(shares.idxmax()), float(shares.max())
    near = format_percent(1 - BOUNDARY_FRACTION)
    text = f"Poses within {near} of a limit: up to {format_percent(share)} ({label})."
    return [Statement(text, "plain", "Boundary", value=share)]
