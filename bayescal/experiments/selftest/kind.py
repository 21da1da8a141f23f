"""Self-tests as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.config.load import check_section
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.memory import MemoryEstimate, estimate_arrays
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.experiments.selftest.inputs import SelftestInputs, read_selftest
from bayescal.experiments.selftest.rows import ROWS
from bayescal.experiments.selftest.schema import SelftestConfig
from bayescal.experiments.shared.derived import DerivedExperiment
from bayescal.report.blocks import Page

DRAWS, RANKS = 6, 4
"""Arrays of all draws of a posterior, and of all ranks."""


class Selftest(DerivedExperiment[SelftestConfig, SelftestInputs]):
    """A study's config, checked by simulation and against its data."""

    schema = SelftestConfig
    rows = ROWS
    tables_in = "tables"

    read = staticmethod(read_selftest)

    def compute(self, inputs: SelftestInputs, run: Run) -> Results:
        """Return what simulations of the study and its data find."""
        from bayescal.experiments.selftest.compute import compute_selftest  # with pandas, for those who compute

        return compute_selftest(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        from bayescal.experiments.selftest.page import build_page  # with matplotlib, for those who make pages

        return build_page(results)

    def estimate_memory(self, inputs: SelftestInputs) -> MemoryEstimate:
        """Return what one data set's posterior takes, two data sets in one where the truth is of the posterior."""
        subject = max(inputs.subjects.values(), key=lambda one: one.posterior.n_parameters)
        n, config = subject.posterior.n_parameters, inputs.config
        return estimate_arrays(
            {"parameters": n, "draws": config.draws, "data sets": 2 * config.data_sets},
            [(DRAWS, config.draws, n), *((2, *one) for one in subject.list_arrays())],
            "fewer poses or draws",
            kept=[(RANKS, 2 * config.data_sets, n)],
        )

    def list_failures(self, results: Results) -> list[str]:
        """Return the faults by their names."""
        found = {name: one["faults"] for name, one in results.summary["variants"].items() if not one["passed"]}
        return [f"{name} fails the self-test ({', '.join(faults)})" for name, faults in found.items()]


def configure_selftest(study: Path, variants: list[str], data_sets: int | None, seed: int | None) -> SelftestConfig:
    """Return the config of a self-test of a study; its own seed where none is given."""
    found = load(study)[1]
    content = {
        "kind": "selftest",
        "name": f"{found.name}_selftest",
        "title": f"Self-test: {found.title}",
        "seed": found.seed if seed is None else seed,
        "study": study.name,
        "variants": variants,
    }
    return check_section(
        SelftestConfig, content if data_sets is None else content | {"data_sets": data_sets}, study, ""
    )
