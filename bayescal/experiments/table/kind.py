"""Look-up tables as a kind of experiment."""

from __future__ import annotations

from bayescal.experiments.runner.memory import MemoryEstimate, estimate_arrays
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.experiments.shared.derived import DerivedExperiment
from bayescal.experiments.shared.search_memory import KEPT_READINGS, list_sampling, list_variant
from bayescal.experiments.table.inputs import TableInputs, read_table
from bayescal.experiments.table.rows import ROWS
from bayescal.experiments.table.schema import TableConfig
from bayescal.report.blocks import Page

RESPONSES, ELSEWHERE, SLOPES = 4, 64, 6
"""Arrays of all draws' responses at all places, poses beside the table's, and arrays of derivatives at all places."""


class LookUpTable(DerivedExperiment[TableConfig, TableInputs]):
    """What actuators have to do by elevation, temperature and the like."""

    schema = TableConfig
    rows = ROWS
    read = staticmethod(read_table)

    def compute(self, inputs: TableInputs, run: Run) -> Results:
        """Return what actuators have to do at every place of the table."""
        from bayescal.experiments.table.compute import compute_table  # with pandas, for those who compute

        return compute_table(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        from bayescal.experiments.table.page import build_page  # with matplotlib, for those who make pages

        return build_page(results)

    def estimate_memory(self, inputs: TableInputs) -> MemoryEstimate:
        """Return what every draw does at every place of the table, and what its study takes."""
        variant, config = inputs.variant, inputs.study.config
        n_places, n_parameters = len(inputs.cells), len(variant.priors)
        width = len(inputs.actuators.channels) + len(inputs.pose)
        return estimate_arrays(
            {"places": n_places, "parameters": n_parameters, "poses": len(variant.start)},
            [
                (RESPONSES, KEPT_READINGS, n_places, width),
                (RESPONSES, ELSEWHERE, n_places, width),
                (SLOPES, n_places, width, variant.whole.layout.size),
                *list_variant(variant),
                *list_sampling(config.sampler, config.evidence, n_parameters),
            ],
            "fewer axis values",
        )

    def list_failures(self, results: Results) -> list[str]:
        """Return that the study's data seem to be wrong."""
        return ["probable data error in the study"] if results.summary.get("suspected_data_error") else []

    def suspect(self, inputs: TableInputs) -> list[str]:
        """Return what seems to have happened to readings that one slip explains far better than errors do."""
        return [] if inputs.slip is None else [inputs.slip.say()]
