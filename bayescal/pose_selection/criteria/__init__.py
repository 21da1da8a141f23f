"""Criteria of pose selection, by name."""

from __future__ import annotations

from bayescal.pose_selection.criteria.base import Criterion, Purpose, Scorer
from bayescal.pose_selection.criteria.log_det import O1, DOptimality
from bayescal.pose_selection.criteria.spectral import O2, O3, O4, O5
from bayescal.pose_selection.criteria.trace import AOptimality, IOptimality

CRITERIA: dict[str, type[Criterion]] = {
    criterion.name: criterion for criterion in (O1, O2, O3, O4, O5, DOptimality, AOptimality, IOptimality)
}

__all__ = [
    "CRITERIA",
    "O1",
    "O2",
    "O3",
    "O4",
    "O5",
    "AOptimality",
    "Criterion",
    "DOptimality",
    "IOptimality",
    "Purpose",
    "Scorer",
]
