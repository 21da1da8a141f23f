"""The comparison of RR-8096 figure 5 as a kind of experiment: two methods of pose extraction on simulated targets."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from bayescal.experiments.frame.experiment import Experiment
from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.numerics.units import MICROMETRE
from bayescal.report.blocks import Column, Figure, Page, Section, Statement, Table, make_table
from bayescal.report.numbers import MICROMETRES, format_estimate, format_fixed, format_significant
from bayescal.reproductions.rr8096.pose_methods.comparison import compare_pose_methods, summarise_comparison
from bayescal.reproductions.rr8096.pose_methods.figure import STYLES, draw_pose_methods
from bayescal.reproductions.rr8096.pose_methods.schema import PoseMethodsConfig

TARGETS, ROWS = 60, 40
"""Doubles of a target in both methods, and of a row of the table with its names."""
ERRORS = ("position_error_mm", "orientation_error_deg", "axis_error_deg")


class PoseMethods(Experiment[PoseMethodsConfig, PoseMethodsConfig]):
    """A line through the targets against a robust rigid-body fit, by the number of targets."""

    schema = PoseMethodsConfig

    def read(self, config: PoseMethodsConfig, folder: Path) -> PoseMethodsConfig:
        """Return the config: there are no files."""
        del folder
        return config

    def estimate_memory(self, inputs: PoseMethodsConfig) -> Need:
        """Return what one body's targets take, and the table of all repeats."""
        counts = {"targets at most": max(inputs.n_targets), "repeats": inputs.repeats}
        held = [(TARGETS, max(inputs.n_targets)), (ROWS, 2 * len(inputs.n_targets), inputs.repeats)]
        return estimate_arrays(counts, held, "fewer repeats")

    def compute(self, inputs: PoseMethodsConfig, run: Run) -> Results:
        """Return the errors of both methods in every repeat, and over the repeats."""
        repeats: pd.DataFrame = run.once("cylinders", compare, inputs)
        means = repeats.groupby("method")[list(ERRORS)].mean()
        found = {str(method): {name: float(row[name]) for name in ERRORS} for method, row in means.iterrows()}
        return Results({"mean_errors": found}, {"repeats": repeats, "summary": summarise_comparison(repeats)})

    def page(self, results: Results) -> Page:
        """Return the page."""
        config, summary = self.config_of(results), results.table("summary")
        found = results.summary["mean_errors"]
        ratio = found["line"]["orientation_error_deg"] / found["robust"]["orientation_error_deg"]
        length, radius = (format_fixed(x, 0) for x in (config.length_mm, config.radius_mm))
        caption = (
            f"Errors on a cylinder of {length} mm with a radius of {radius} mm, mean and standard deviation over "
            f"{config.repeats} repeats, after RR-8096 figure 5."
        )
        verdict = [Statement(_describe_errors(errors), lead=STYLES[name]["label"]) for name, errors in found.items()]
        return Page(
            "Pose extraction",
            config.name,
            config.title,
            "Simulated; nothing was measured",
            "Fit the targets as a rigid body: by a line through them the whole orientation errs "
            f"{format_significant(ratio)} times as much as by the robust rigid-body fit.",
            tuple(verdict),
            (
                Section(
                    "Errors",
                    (
                        Figure("figure5", caption, partial(draw_pose_methods, summary)),
                        _tabulate(summary),
                    ),
                ),
            ),
        )


def compare(config: PoseMethodsConfig) -> pd.DataFrame:
    """Return the errors of both methods, a row for each method, number of targets and repeat."""
    return compare_pose_methods(
        config.n_targets,
        config.repeats,
        config.length_mm,
        config.radius_mm,
        config.target_noise_um * MICROMETRE,
        np.random.default_rng(config.seed),
    )


def _describe_errors(errors: dict[str, float]) -> str:
    position = format_fixed(MICROMETRES * errors["position_error_mm"], 2)
    whole, axis = (format_fixed(errors[name], 4) for name in ("orientation_error_deg", "axis_error_deg"))
    return f"mean errors: position {position} µm, orientation {whole}°, axis {axis}°."


def _tabulate(summary: pd.DataFrame) -> Table:
    columns = [
        Column("Method", kind="text"),
        Column("Targets"),
        Column("Position", "µm, mean ± sd"),
        Column("Orientation", "deg, mean ± sd"),
        Column("Axis", "deg, mean ± sd"),
    ]
    rows = []
    for row in summary.to_dict("records"):
        scales = zip(ERRORS, (MICROMETRES, 1.0, 1.0), strict=True)
        cells = [format_estimate(scale * row[f"{name}_mean"], scale * row[f"{name}_sd"]) for name, scale in scales]
        rows.append([STYLES[row["method"]]["label"], str(row["n_targets"]), *cells])
    return make_table("Errors over the repeats.", columns, rows)
