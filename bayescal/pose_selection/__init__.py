"""Which poses to measure: candidates, criteria and methods for any machine."""

from __future__ import annotations

from bayescal.pose_selection.criteria import CRITERIA, Criterion
from bayescal.pose_selection.design import Design, SeenPoses
from bayescal.pose_selection.domain import (
    ActuatorBox,
    Candidates,
    PoseDomain,
    WorkspaceBox,
    candidates_at,
    candidates_at_actuators,
    even_candidates,
    factorial_candidates,
    random_candidates,
)
from bayescal.pose_selection.methods import METHODS, SelectedPoses, SelectionMethod, select
from bayescal.pose_selection.observability import compute_observability, identification_rows
from bayescal.pose_selection.problem import SelectionProblem

__all__ = [
    "CRITERIA",
    "METHODS",
    "ActuatorBox",
    "Candidates",
    "Criterion",
    "Design",
    "PoseDomain",
    "SeenPoses",
    "SelectedPoses",
    "SelectionMethod",
    "SelectionProblem",
    "WorkspaceBox",
    "candidates_at",
    "candidates_at_actuators",
    "compute_observability",
    "even_candidates",
    "factorial_candidates",
    "identification_rows",
    "random_candidates",
    "select",
]
