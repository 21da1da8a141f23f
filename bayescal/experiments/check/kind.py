"""Checks as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.config.load import check_section
from bayescal.experiments.check.compute import compute_check
from bayescal.experiments.check.inputs import CheckInputs, read_check
from bayescal.experiments.check.page import build_page
from bayescal.experiments.check.schema import CheckConfig
from bayescal.experiments.frame.load import load
from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.of_another import OfAnother

DRAWS, RANKS = 6, 4
"""Arrays of all draws of a posterior, and of all ranks."""


class Check(OfAnother[CheckConfig, CheckInputs]):
    """A study's config, checked by simulation and against its data."""

    schema = CheckConfig
    tables_in = "tables"

    read = staticmethod(read_check)
    compute = staticmethod(compute_check)
    page = staticmethod(build_page)

    def estimate_memory(self, inputs: CheckInputs) -> Need:
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
        return [f"{name} does not pass the check ({', '.join(faults)})" for name, faults in found.items()]


def configure_check(study: Path, variants: list[str], data_sets: int | None, seed: int | None) -> CheckConfig:
    """Return the config of a check of a study; its own seed where none is given."""
    found = load(study)[1]
    content = {
        "kind": "check",
        "name": f"{found.name}_check",
        "title": f"Check: {found.title}",
        "seed": found.seed if seed is None else seed,
        "study": study.name,
        "variants": variants,
    }
    return check_section(CheckConfig, content if data_sets is None else content | {"data_sets": data_sets}, study, "")
