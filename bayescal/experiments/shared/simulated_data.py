"""Simulations as kinds of experiment: data files of a machine whose truth is known, with a page that says which."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayescal.config.sections import ExperimentConfig
from bayescal.data.truth import round_as_written
from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.report.blocks import Column, Page, Section, Statement, make_table
from bayescal.report.numbers import format_count, format_fixed

KIND = "Simulation"
TEXT = 30
"""Doubles that a simulated number takes, with the text of its line."""


@dataclass(frozen=True, eq=False)
class Simulated:
    """Data of a machine whose truth is known.

    Attributes
    ----------
    files : dict of str to str
        Texts of the data files by their names.
    truth : DataFrame
        ``parameter``, ``unit``, ``nominal`` and ``true`` of every parameter that is off its nominal value.
    origin : str
        What the files say of where the data come from.
    n_calibration, n_verification : int
        Poses.
    """

    files: dict[str, str]
    truth: pd.DataFrame
    origin: str
    n_calibration: int
    n_verification: int


class SimulatedData[C: ExperimentConfig, I](Experiment[C, I]):
    """A kind of experiment that makes data files; `simulate` is all that it supplies."""

    digits = 12

    @abstractmethod
    def simulate(self, inputs: I, rng: np.random.Generator) -> Simulated:
        """Return the data and the truth behind them."""

    @abstractmethod
    def count(self, inputs: I) -> tuple[int, int]:
        """Return the number of poses, and how many numbers are simulated of each."""

    def estimate_memory(self, inputs: I) -> Need:
        """Return what the data and their texts take."""
        n_poses, each = self.count(inputs)
        counts = {"poses": n_poses, "readings of each": each}
        return estimate_arrays(counts, [(TEXT, n_poses, each)], "fewer poses or targets")

    @abstractmethod
    def seed(self, inputs: I) -> int:
        """Return the seed of the random numbers."""

    def compute(self, inputs: I, run: Run) -> Results:
        """Return the data files and the truth."""
        del run
        made = self.simulate(inputs, np.random.default_rng(self.seed(inputs)))
        summary = {
            "data_origin": made.origin,
            "n_poses": {"calibration": made.n_calibration, "verification": made.n_verification},
            "files": list(made.files),
        }
        return Results(summary, {"truth": made.truth}, made.files)

    def page(self, results: Results) -> Page:
        """Return the page: what was simulated, and the truth."""
        count, provenance = results.summary["n_poses"], results.provenance
        poses = f"{count['calibration']} poses for calibration and {count['verification']} for verification"
        columns = [Column("Parameter", kind="name"), Column("Unit", kind="text"), Column("Nominal"), Column("True")]
        rows = [
            [str(row["parameter"]), str(row["unit"]), format_fixed(row["nominal"], 6), format_fixed(row["true"], 6)]
            for row in results.table("truth").to_dict("records")
        ]
        files = ", ".join(results.summary["files"])
        return Page(
            KIND,
            str(provenance.get("name", "")),
            str(provenance.get("title", "")),
            results.summary["data_origin"],
            f"{poses} were simulated; nothing was measured.",
            (Statement(f"{format_count(len(rows))} parameters are off their nominal values.", lead="Truth"),),
            (
                Section("Files", (f"The data are in {files}.",)),
                Section("Truth", (make_table("Parameters that are off their nominal values.", columns, rows),)),
            ),
        )


def tabulate_truth(
    names: tuple[str, ...], units: tuple[str, ...], nominal: np.ndarray, true: np.ndarray
) -> pd.DataFrame:
    """Return the parameters that are off their nominal values, as far as files of the truth have digits."""
    table = pd.DataFrame({"parameter": names, "unit": units, "nominal": nominal, "true": true})
    return table[round_as_written(nominal) != true].reset_index(drop=True)
