"""Simulated measurements as a kind of experiment: data files of a machine whose truth is known, and a page of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayescal.data.truth import round_as_written
from bayescal.experiments.runner.experiment import Experiment
from bayescal.experiments.runner.memory import MemoryEstimate, estimate_arrays
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.experiments.shared.readings.machine_kind import MachineExperiment, look_at_machine
from bayescal.experiments.simulation.compute import ReadingPlan, Twin, build_twin, plan_readings
from bayescal.experiments.simulation.rows import ROWS, TruthRow
from bayescal.experiments.simulation.schema import SimulationConfig
from bayescal.files.rows import check_tables
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array
from bayescal.report.blocks import KeyFigure, Page, PageSection, Statement
from bayescal.report.numbers import format_count
from bayescal.report.row_tables import tabulate_rows

if TYPE_CHECKING:
    import pandas as pd

KIND = "Simulation"
MOST_TRIED = 100_000  # readings that are drawn before a run, to see that they can be
TEXT = 30
"""Doubles that a simulated number takes, with the text of its line."""

type Plan = Twin | ReadingPlan


class Simulation(MachineExperiment[SimulationConfig, Plan]):
    """Readings of any machine, or what an instrument sees of a platform on legs, with the truth beside them."""

    schema = SimulationConfig
    rows = ROWS
    digits = 12

    def machines(self, config: SimulationConfig) -> list[str]:
        """Return the machine's file."""
        return [config.machine]

    def read(self, config: SimulationConfig, folder: Path) -> Plan:
        """Return the machine, its truth, its noise and where it is measured; InputError for poses out of reach."""
        found = build_twin(config, folder) if config.is_planned else plan_readings(config, folder)
        if found.n_poses * found.width <= MOST_TRIED:
            found.simulate(np.random.default_rng(config.seed))  # drawn once more to be written: what fails shows now
        return found

    def list_file_faults(self, content: Mapping[str, object], folder: Path) -> list[str]:
        """Return what is wrong with the machine's file by itself."""
        return look_at_machine(content, folder)[1]

    def estimate_memory(self, inputs: Plan) -> MemoryEstimate:
        """Return what the data and their texts take."""
        n_poses, each = inputs.n_poses, inputs.width
        counts = {"poses": n_poses, "readings of each": each}
        return estimate_arrays(counts, [(TEXT, n_poses, each)], "fewer poses or targets")

    def compute(self, inputs: Plan, run: Run) -> Results:
        """Return the data files and the truth."""
        del run
        config, rng = inputs.config, np.random.default_rng(inputs.config.seed)
        files, theta = inputs.simulate(rng)
        count = {"calibration": inputs.n_poses - inputs.n_held_back, "verification": inputs.n_held_back}
        summary = {"data_origin": config.provenance.text, "n_poses": count, "files": list(files)}
        return Results(summary, {"truth": _tabulate(inputs.layout, theta)}, files)

    def page(self, results: Results) -> Page:
        """Return the page: what was simulated, and the truth."""
        check_tables(ROWS, results.tables, results.folder or Path())
        count, provenance = results.summary["n_poses"], results.provenance
        poses = f"{count['calibration']} poses for calibration and {count['verification']} for verification"
        rows = TruthRow.read(results.table("truth"))
        files = ", ".join(results.summary["files"])
        return Page(
            KIND,
            str(provenance.get("name", "")),
            str(provenance.get("title", "")),
            results.summary["data_origin"],
            f"{poses} were simulated.",
            (Statement(f"{format_count(len(rows))} parameters deviate from nominal.", lead="Truth", value=len(rows)),),
            (
                PageSection("Files", (f"The data are in {files}.",)),
                PageSection("Truth", (tabulate_rows("Deviations from nominal.", rows),)),
            ),
            key_figures=(
                KeyFigure("Calibration poses", str(count["calibration"])),
                KeyFigure("Verification poses", str(count["verification"])),
                KeyFigure("Parameters off nominal", format_count(len(rows))),
                KeyFigure("Files", str(len(results.summary["files"]))),
            ),
        )


def _tabulate(layout: ParameterLayout, true: Array) -> pd.DataFrame:
    """Return the parameters that are off their nominal values, as far as files of the truth have digits.

    Nominal values have the digits of a study's tables, so that both merge by them.
    """
    nominal = [float(f"{one:.{Experiment.digits}g}") for one in layout.nominal]
    table = TruthRow.tabulate(parameter=layout.names, unit=layout.units, nominal=nominal, true=true)
    return table[round_as_written(layout.nominal) != true].reset_index(drop=True)
