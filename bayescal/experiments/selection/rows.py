"""Tables of an experiment on pose selection, each declared once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bayescal.experiments.shared.rows import CRITERION, N_POSES, SD_OVER_REPEATS, SELECTION, STANDARD_ERROR
from bayescal.files.rows import TableRow, column


@dataclass(frozen=True, kw_only=True)
class SelectionKeyRow(TableRow):
    """Columns that name a selection."""

    label: str = column(SELECTION)
    criterion: str = column(CRITERION)
    n_poses: int = column(N_POSES)
    repeat: int = column("number of the repeat")


@dataclass(frozen=True, kw_only=True)
class SelectionClassRow(TableRow, table="classes"):
    """A user-defined criterion or method."""

    role: Literal["criterion", "method"] = column("what the class is")
    name: str = column("name of the class")
    title: str = column("title of the class")
    source: str = column("source of the class")


@dataclass(frozen=True, kw_only=True)
class SelectionRow(SelectionKeyRow, table="selections"):
    """A selection, with a column per observability index of its poses."""

    method: str = column("method of the selection")
    value: float = column("criterion of the poses")
    others: Mapping[str, float] = field(default_factory=dict)
    n_evaluations: int = column("evaluations of the criterion")
    n_iterations: int = column("iterations of the method")
    converged: bool = column("whether the method converged")
    reason: str = column("why it stopped")
    boundary_fraction: float = column("fraction of poses at the boundary, or NaN")


@dataclass(frozen=True, kw_only=True)
class SelectionSummaryRow(TableRow, table="selection_summary"):
    """All repeats of a selection."""

    label: str = column(SELECTION)
    criterion: str = column(CRITERION)
    n_poses: int = column(N_POSES)
    best: float = column("largest criterion")
    mean: float = column("mean of the criterion")
    sd: float = column("its standard deviation, or NaN")
    n_repeats: int = column("number of repeats")


@dataclass(frozen=True, kw_only=True)
class SelectedPlanRow(SelectionKeyRow, table="poses"):
    """A pose of a selection, with columns of its displacement from home and of the actuators' displacements."""

    pose: int = column("number of the pose")
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class SelectionTraceRow(SelectionKeyRow, table="traces"):
    """An iteration of a selection."""

    iteration: int = column("number of the iteration")
    value: float = column("criterion after the iteration")


@dataclass(frozen=True, kw_only=True)
class RandomSetRow(SelectionKeyRow, table="random_sets"):
    """A random set of poses."""

    set: int = column("number of the set")
    value: float = column("criterion of the set")


@dataclass(frozen=True, kw_only=True)
class SelectionTimeRow(SelectionKeyRow, table="timings"):
    """The time of a selection."""

    seconds: float = column("wall time", "s")


@dataclass(frozen=True, kw_only=True)
class CalibrationErrorRow(TableRow, table="errors"):
    """Pose errors over the workspace after simulated calibrations with the poses of a selection, rms over machines."""

    name: str = column("way to choose poses")
    label: str = column(SELECTION)
    criterion: str = column(CRITERION)
    n_poses: int = column(N_POSES)
    repeat: int = column("number of the repeat")
    predicted_position_um: float = column("predicted position error, first order", "µm")
    simulated_position_um: float = column("simulated position error", "µm")
    simulated_position_um_se: float = column(STANDARD_ERROR, "µm")
    predicted_rotation_arcsec: float = column("predicted rotation error, first order", "arcsec")
    simulated_rotation_arcsec: float = column("simulated rotation error", "arcsec")
    simulated_rotation_arcsec_se: float = column(STANDARD_ERROR, "arcsec")
    predicted_over_limits: float = column("predicted error / limit")
    simulated_over_limits: float = column("simulated error / limit")
    simulated_over_limits_se: float = column(STANDARD_ERROR)
    mean_position_um: float = column("mean simulated position error", "µm")
    parameters_rms: float = column("parameter error / prior sd, rms")
    n_machines: int = column("machines whose fit converged")
    n_failed: int = column("machines whose fit failed")


@dataclass(frozen=True, kw_only=True)
class CalibrationErrorSummaryRow(TableRow, table="error_summary"):
    """Pose errors of a way to choose poses, mean over repeats."""

    name: str = column("way to choose poses")
    label: str = column(SELECTION)
    criterion: str = column(CRITERION)
    n_poses: int = column(N_POSES)
    n_repeats: int = column("number of repeats")
    predicted_position_um: float = column("predicted position error, first order", "µm")
    simulated_position_um: float = column("simulated position error", "µm")
    simulated_position_um_sd: float = column(SD_OVER_REPEATS, "µm")
    simulated_position_um_se: float = column(STANDARD_ERROR, "µm")
    predicted_rotation_arcsec: float = column("predicted rotation error, first order", "arcsec")
    simulated_rotation_arcsec: float = column("simulated rotation error", "arcsec")
    simulated_rotation_arcsec_sd: float = column(SD_OVER_REPEATS, "arcsec")
    simulated_rotation_arcsec_se: float = column(STANDARD_ERROR, "arcsec")
    predicted_over_limits: float = column("predicted error / limit")
    simulated_over_limits: float = column("simulated error / limit")
    simulated_over_limits_sd: float = column(SD_OVER_REPEATS)
    simulated_over_limits_se: float = column(STANDARD_ERROR)
    mean_position_um: float = column("mean simulated position error", "µm")
    mean_position_um_sd: float = column(SD_OVER_REPEATS, "µm")
    parameters_rms: float = column("parameter error / prior sd, rms")
    n_failed: int = column("machines whose fit failed")


ROWS: tuple[type[TableRow], ...] = (
    *(SelectionClassRow, SelectionRow, SelectionSummaryRow, SelectedPlanRow, SelectionTraceRow, RandomSetRow),
    *(SelectionTimeRow, CalibrationErrorRow, CalibrationErrorSummaryRow),
)
"""Tables of an experiment on pose selection."""
