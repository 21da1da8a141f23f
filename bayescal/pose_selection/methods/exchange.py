"""Exchange in the manner of IOOPS: eliminate a pose, add the best in its place, until no elimination pays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayescal.pose_selection.criteria import Scorer
from bayescal.pose_selection.methods.base import GAIN, Selection, SelectionMethod, start_set
from bayescal.pose_selection.problem import SelectionProblem


@dataclass(frozen=True)
class Exchange(SelectionMethod):
    """Eliminate and add; where the pose that matters least stays the best choice, the next one is tried.

    IOOPS adds the pose by a local optimisation over the workspace, this over the candidates. What is found cannot be
    improved by exchanging any one pose.

    Attributes
    ----------
    max_iterations : int
        Exchanges.
    start : tuple of int, optional
        Candidates to start from in place of random ones.
    """

    max_iterations: int = 1000
    start: tuple[int, ...] | None = None

    name: ClassVar[str] = "exchange"
    title: ClassVar[str] = "Exchange (eliminate and add, from the candidates)"
    source: ClassVar[str] = "Fedorov 1972; Daney, Papegay and Madeline 2005"

    def select(self, problem: SelectionProblem, rng: np.random.Generator) -> Selection:
        """Return the set where the exchange ends."""
        scorer = problem.scorer()
        trace = [start_set(problem, scorer, self.start, rng)]
        outside = problem.candidates.distinct.copy()
        outside[scorer.members] = False
        ended = False
        while not ended and len(trace) <= self.max_iterations:
            value = _improve(scorer, outside, trace[-1]) if outside.any() else None
            ended = value is None
            if value is not None:
                trace.append(value)
        reason = "no pose can be exchanged for a better one" if ended else f"{self.max_iterations} exchanges"
        index = np.array(scorer.members)
        return self._from_candidates(problem, index, trace, scorer.n_evaluations, reason, converged=ended)


def _improve(scorer: Scorer, outside: np.ndarray, value: float) -> float | None:
    """Exchange one member, the least needed first; return the new value, or None where nothing is better."""
    without = scorer.values_dropped()
    scorer.n_evaluations += len(without)
    members = list(scorer.members)
    for place in np.argsort(-without, kind="stable"):
        dropped = members[place]
        scorer.drop(dropped)
        added, found = scorer.best_added(outside)
        if found > value + GAIN * abs(value):
            scorer.add(added)
            outside[added], outside[dropped] = False, True
            return found
        scorer.start(members)
    return None
