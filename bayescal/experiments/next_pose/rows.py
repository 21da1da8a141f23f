"""Tables of the question for the next pose, each declared once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bayescal.experiments.shared.rows import N_POSES, P_ALL_MET, REQUIREMENT, VARIANT
from bayescal.files.rows import TableRow, column

OVER_LIMIT = "_over_limit"
"""End of the columns of the history that start with the name of a requirement: its error over its limit."""


@dataclass(frozen=True, kw_only=True)
class NextPoseRow(TableRow, table="next_poses"):
    """A pose to measure, with columns of its actuator displacements, coordinates and readings."""

    order: int = column("place in the order of measurement")
    candidate: int = column("number of the candidate")
    touching: str | None = column("instrument that is touched there", default=None)
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RequirementForecastRow(TableRow, table="requirements"):
    """A requirement now, after the next pose and with all parameters known; errors are those that no pose exceeds."""

    requirement: str = column(REQUIREMENT)
    unit: str = column("unit of the errors")
    limit: float = column("largest error allowed")
    error: float = column("error bound at the stated probability")
    error_after_next: float = column("expected error after the next pose")
    error_parameters_known: float = column("error, all parameters known")
    probability: float = column("probability that no pose exceeds the limit")
    probability_after_next: float = column("expected probability after the next pose")


@dataclass(frozen=True, kw_only=True)
class PoseHistoryRow(TableRow, table="history"):
    """A number of poses, with a column per requirement: the error that no pose exceeds over the limit."""

    n_poses: int = column(N_POSES)
    measured_or_planned: Literal["measured", "planned"] = column("whether all are measured")
    probability: float = column(P_ALL_MET)
    standard_error: float = column("standard error of the probability")
    approximate: bool = column("whether importance weights are heavy-tailed")
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class ComparedVariantRow(TableRow, table="variants"):
    """A variant and its probability."""

    variant: str = column(VARIANT, show="name")
    log_evidence: float = column("log-evidence by Laplace's approximation", "nat", show="fixed 1", title="Log-evidence")
    probability: float = column("posterior probability of the variant", show="percent 1")


ROWS: tuple[type[TableRow], ...] = (NextPoseRow, RequirementForecastRow, PoseHistoryRow, ComparedVariantRow)
"""Tables of the question for the next pose."""
