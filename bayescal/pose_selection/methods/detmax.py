"""DETMAX: add the best pose, drop the worst, until the two are the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayescal.pose_selection.methods.base import GAIN, Selection, SelectionMethod, start_set
from bayescal.pose_selection.problem import SelectionProblem


@dataclass(frozen=True)
class Detmax(SelectionMethod):
    """DETMAX with excursions of one pose, from one set.

    Attributes
    ----------
    max_iterations : int
    start : tuple of int, optional
        Candidates to start from in place of random ones.
    """

    max_iterations: int = 1000
    start: tuple[int, ...] | None = None

    name: ClassVar[str] = "detmax"
    title: ClassVar[str] = "DETMAX"
    source: ClassVar[str] = "Mitchell 1974"

    def select(self, problem: SelectionProblem, rng: np.random.Generator) -> Selection:
        """Return the set where the exchange ends."""
        scorer = problem.scorer()
        trace = [start_set(problem, scorer, self.start, rng)]
        outside = problem.candidates.distinct.copy()
        outside[scorer.members] = False
        for _ in range(self.max_iterations if outside.any() else 0):
            added, _ = scorer.best_added(outside)
            scorer.add(added)
            outside[added] = False
            dropped, value = scorer.best_dropped()
            better = dropped != added and value > trace[-1] + GAIN * abs(trace[-1])
            if not better:  # the same, or one as good: it would go round for ever
                scorer.drop(added)
                break
            scorer.drop(dropped)
            outside[dropped] = True
            trace.append(value)
        ended = len(trace) <= self.max_iterations
        reason = "the pose added is the pose dropped" if ended else f"{self.max_iterations} iterations"
        index = np.array(scorer.members)
        return self._from_candidates(problem, index, trace, scorer.n_evaluations, reason, converged=ended)
