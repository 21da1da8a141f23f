"""Improved DETMAX: a list of poses that may not come back for a while leads out of local optima."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayescal.errors import InputError
from bayescal.pose_selection.criteria import Scorer
from bayescal.pose_selection.methods.base import Selection, SelectionMethod, start_set
from bayescal.pose_selection.problem import SelectionProblem


@dataclass(frozen=True)
class TabuDetmax(SelectionMethod):
    """DETMAX with a tabu list; the best set seen is kept.

    Attributes
    ----------
    list_length : int
        m: how many poses may not be added. They are random at the start; the pose dropped joins the end, the first of
        the list becomes free.
    iterations : int
    leave : bool
        Whether the pose just added must stay, so that the set may become worse and leave a local optimum. As printed it
        may be dropped at once: then no set is worse than the one before, and the list only sees to it that other
        poses are tried.
    start : tuple of int, optional
        Candidates to start from in place of random ones.
    """

    list_length: int = 100
    iterations: int = 219
    leave: bool = False
    start: tuple[int, ...] | None = None

    name: ClassVar[str] = "tabu"
    title: ClassVar[str] = "Improved DETMAX with a tabu list"
    source: ClassVar[str] = "Mitchell 1974, with a tabu list after Glover 1989"

    def select(self, problem: SelectionProblem, rng: np.random.Generator) -> Selection:
        """Return the best set seen."""
        distinct = problem.candidates.distinct
        if self.list_length < 0 or problem.n + self.list_length >= distinct.sum():
            raise InputError(
                f"tabu: found a list of {self.list_length} beside {problem.n} poses, expected fewer than "
                f"the {distinct.sum()} distinct candidates together"
            )
        scorer = problem.scorer()
        best = start_set(problem, scorer, self.start, rng)
        best_set, trace = list(scorer.members), [best]
        outside = distinct.copy()
        outside[scorer.members] = False
        tabu = deque(rng.permutation(np.flatnonzero(outside))[: self.list_length].tolist())
        outside[list(tabu)] = False
        for _ in range(self.iterations):
            added, _ = scorer.best_added(outside)
            scorer.add(added)
            outside[added] = False
            dropped, value = self._drop(scorer, added)
            scorer.drop(dropped)
            tabu.append(dropped)
            outside[tabu.popleft()] = True
            trace.append(value)
            if value > best:
                best, best_set = value, list(scorer.members)
        reason = f"{self.iterations} iterations, the best set kept"
        return self._from_candidates(problem, np.array(best_set), trace, scorer.n_evaluations, reason)

    def _drop(self, scorer: Scorer, added: int) -> tuple[int, float]:
        """Return the member to drop, and the criterion without it."""
        dropped, value = scorer.best_dropped()
        if not self.leave or dropped != added:
            return dropped, value
        values = scorer.values_dropped()
        values[scorer.members.index(added)] = -np.inf
        place = int(np.argmax(values))
        return scorer.members[place], float(values[place])
