"""A kind of experiment: two ways to find a pose from targets, on simulated ones (RR-8096 section 3.1, figure 5)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib import figure as pictures
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from pydantic import AfterValidator, Field
from scipy.spatial.transform import Rotation

from bayescal.config.sections import ExperimentConfig, Positive, check_once
from bayescal.data.photogrammetry.line_fit import fit_line
from bayescal.data.photogrammetry.rigid_fit import RigidFit, fit_rigid_body
from bayescal.errors import InputError
from bayescal.experiments.runner.experiment import Experiment
from bayescal.experiments.runner.memory import MemoryEstimate, estimate_arrays
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.numerics.geometry import Array, compute_pose_error
from bayescal.numerics.units import MICROMETRE
from bayescal.report.blocks import Column, Figure, Page, PageSection, Statement, Table, make_table
from bayescal.report.numbers import MICROMETRES, format_estimate, format_fixed, format_plain, format_significant

METHODS: dict[str, Callable[[Array, Array, float], RigidFit]] = {"line": fit_line, "robust": fit_rigid_body}
LARGEST_TRANSLATION = 100.0
"""Largest coordinate of a random translation, mm."""


def draw_cylinder_targets(n_targets: int, length: float, radius: float, rng: np.random.Generator) -> Array:
    """Return targets (n, 3) in mm, uniform on the side of a cylinder along z from 0 to its length."""
    angle = rng.uniform(0, 2 * np.pi, n_targets)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, length, n_targets)], axis=-1)


def _simulate_repeat(
    n_targets: int, length: float, radius: float, noise: float, rng: np.random.Generator
) -> list[dict[str, object]]:
    """Return one row per method for one scatter of targets, one displacement and one draw of the noise."""
    reference = draw_cylinder_targets(n_targets, length, radius, rng)
    rotation = Rotation.random(rng=rng).as_matrix()
    position = rng.uniform(-LARGEST_TRANSLATION, LARGEST_TRANSLATION, 3)
    measured = position + reference @ rotation.T + noise * rng.standard_normal(reference.shape)
    barycentre = reference.mean(axis=0)
    rows: list[dict[str, object]] = []
    for method, fit_pose in METHODS.items():
        fit = fit_pose(reference, measured, noise)
        error = compute_pose_error(position, rotation, fit.position, fit.rotation)
        shift = position + rotation @ barycentre - fit.position - fit.rotation @ barycentre
        tilt = np.cross(rotation[:, 2], fit.rotation[:, 2])
        rows.append(
            {
                "method": method,
                "n_targets": n_targets,
                "position_error_mm": np.linalg.norm(shift),
                "orientation_error_deg": np.degrees(np.linalg.norm(error[3:])),
                "axis_error_deg": np.degrees(np.arctan2(np.linalg.norm(tilt), rotation[:, 2] @ fit.rotation[:, 2])),
                "whitened_squared_error": error @ np.linalg.solve(fit.covariance, error),
            }
        )
    return rows


def compare_pose_methods(
    n_targets: Sequence[int], n_repeats: int, length: float, radius: float, noise: float, rng: np.random.Generator
) -> pd.DataFrame:
    """Return the pose errors of both methods on the same simulated cylinders (RR-8096 figure 5).

    Every repeat draws new targets on the cylinder, a displacement with any rotation, and Gaussian noise on the
    displaced targets only.

    Parameters
    ----------
    n_targets : sequence of int
        Numbers of targets; RR-8096 goes from 6 to 20.
    n_repeats : int
        Repeats for each number of targets; 20 in RR-8096.
    length, radius : float
        Of the cylinder, mm; 50 and 1 in RR-8096.
    noise : float
        Standard deviation of each measured coordinate, mm; 0.005 in RR-8096.
    rng : numpy.random.Generator
        Source of all random numbers.

    Returns
    -------
    pandas.DataFrame
        Columns ``method`` (line or robust), ``n_targets``, ``repeat``, ``position_error_mm`` (error of the displaced
        barycentre, the point where both methods determine the position best), ``orientation_error_deg`` (angle of the
        whole rotation), ``axis_error_deg`` (tilt of the cylinder axis alone) and ``whitened_squared_error`` (six
        degrees of freedom, by the method's own covariance).

    Raises
    ------
    InputError
        Where there is no repeat, or the drawn targets do not determine a pose.
    """
    if n_repeats < 1:
        raise InputError(f"pose method comparison: found {n_repeats} repeats, expected at least 1")
    rows = [
        row | {"repeat": repeat}
        for n in n_targets
        for repeat in range(n_repeats)
        for row in _simulate_repeat(n, length, radius, noise, rng)
    ]
    order = ["method", "n_targets", "repeat", "position_error_mm", "orientation_error_deg", "axis_error_deg"]
    return pd.DataFrame(rows)[[*order, "whitened_squared_error"]]


def summarise_comparison(comparison: pd.DataFrame) -> pd.DataFrame:
    """Return mean and standard deviation over the repeats, one row per method and number of targets.

    Columns ``method``, ``n_targets``, and for every error column of `compare_pose_methods` the columns
    ``<error>_mean`` and ``<error>_sd``.
    """
    errors = comparison.drop(columns="repeat").groupby(["method", "n_targets"]).agg(["mean", "std"])
    errors.columns = ["_".join(column).replace("_std", "_sd") for column in errors.columns]
    return errors.reset_index()


class PoseMethodsConfig(ExperimentConfig):
    """The simulation of RR-8096 figure 5: two ways to find a body's pose from its targets."""

    n_targets: Annotated[list[Annotated[int, Field(ge=3, le=1000)]], Field(min_length=1), AfterValidator(check_once)]
    """Numbers of targets."""
    repeats: Annotated[int, Field(ge=2, le=1_000_000)]
    """Draws of the noise for each."""
    length_mm: Positive
    """Length of the body that the targets sit on."""
    radius_mm: Positive
    """Its radius."""
    target_noise_um: Positive
    """Standard deviation of a target's coordinates."""


STYLES: dict[str, dict[str, Any]] = {
    "line": {"color": "tab:red", "marker": "s", "label": "Line through the targets"},
    "robust": {"color": "black", "marker": "o", "label": "Robust rigid fit"},
}
PANELS = (
    ("position_error_mm", 1000.0, "Position error of the barycentre (µm)", False),
    ("orientation_error_deg", 1.0, "Orientation error (degrees)", True),
)


def draw_pose_methods(summary: pd.DataFrame) -> pictures.Figure:
    """Return the figure: position and orientation errors of both methods, mean and standard deviation over repeats.

    Parameters
    ----------
    summary : pandas.DataFrame
        From `summarise_comparison`.
    """
    figure = pictures.Figure(figsize=(9.0, 4.0), layout="constrained")
    for axes, (column, factor, label, logarithmic) in zip(figure.subplots(1, 2), PANELS, strict=True):
        for k, (method, rows) in enumerate(summary.groupby("method", sort=True)):
            _draw_method(axes, str(method), rows, column, factor, logarithmic, shift=0.24 * (k - 0.5))
        if logarithmic:
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
        else:
            axes.set_ylim(bottom=0)
        axes.set_xlabel("Number of targets")
        axes.set_ylabel(label)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(alpha=0.3, which="major")
    figure.axes[0].legend(frameon=False, title="Mean ± sd over repeats", alignment="left")
    return figure


def _draw_method(
    axes: Axes, method: str, rows: pd.DataFrame, column: str, factor: float, logarithmic: bool, shift: float
) -> None:
    """Draw the points of one method; on a logarithmic axis a bar's lower end stays above a tenth of the mean."""
    mean = factor * rows[f"{column}_mean"].to_numpy()
    below = above = factor * rows[f"{column}_sd"].fillna(0.0).to_numpy()
    if logarithmic:
        below = np.minimum(below, 0.9 * mean)
    axes.errorbar(
        rows["n_targets"].to_numpy() + shift,
        mean,
        yerr=np.stack([below, above]),
        linestyle="none",
        markersize=4.5,
        elinewidth=1.0,
        capsize=2.0,
        **STYLES[method],
    )


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

    def estimate_memory(self, inputs: PoseMethodsConfig) -> MemoryEstimate:
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
            "Fit the targets as a rigid body. The orientation error of a line fit is "
            f"{format_significant(ratio)} times as large.",
            tuple(verdict),
            (
                PageSection(
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
    return f"Mean errors: position {position} µm, orientation {whole}°, axis {axis}°."


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
