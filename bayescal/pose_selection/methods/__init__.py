"""Methods of pose selection, by name."""

from __future__ import annotations

from bayescal.pose_selection.methods.base import Selection, SelectionMethod
from bayescal.pose_selection.methods.continuous import Continuous
from bayescal.pose_selection.methods.detmax import Detmax
from bayescal.pose_selection.methods.exchange import Exchange
from bayescal.pose_selection.methods.random_sets import RandomSets
from bayescal.pose_selection.methods.tabu import TabuDetmax

METHODS: dict[str, type[SelectionMethod]] = {
    method.name: method for method in (RandomSets, Detmax, TabuDetmax, Exchange, Continuous)
}

__all__ = ["METHODS", "Continuous", "Detmax", "Exchange", "RandomSets", "Selection", "SelectionMethod", "TabuDetmax"]
