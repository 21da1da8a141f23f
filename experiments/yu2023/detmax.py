"""The paper's methods of pose selection: DETMAX, and the improved DETMAX with a tabu list (section 3.2)."""

from __future__ import annotations

from collections import deque
from typing import Annotated

import numpy as np
from pydantic import Field

from bayescal.config.sections import Section
from bayescal.errors import InputError
from bayescal.pose_selection import SelectedPoses, SelectionMethod, SelectionProblem
from bayescal.pose_selection.methods import GAIN, begin_exchange

type Count = Annotated[int, Field(ge=1, le=100_000)]


class DetmaxConfig(Section):
    """DETMAX."""

    max_iterations: Count = 1000
    """Iterations at which it ends at the latest."""


class Detmax(SelectionMethod):
    """DETMAX with excursions of one pose, from one set: add the best, drop the worst, until the two are the same."""

    name = "detmax"
    title = "DETMAX"
    source = "Mitchell 1974"
    Config = DetmaxConfig

    def __init__(self, config: DetmaxConfig) -> None:
        self.max_iterations = config.max_iterations

    def select(self, problem: SelectionProblem, rng: np.random.Generator) -> SelectedPoses:
        """Return the set where the exchange ends."""
        scorer, value, outside = begin_exchange(problem, rng)
        trace = [value]
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
        return self._from_candidates(
            problem, np.array(scorer.members), trace, scorer.n_evaluations, reason, converged=ended
        )


class TabuDetmaxConfig(Section):
    """The improved DETMAX."""

    list_length: Annotated[int, Field(ge=0, le=100_000)] = 100
    """Length of the tabu list."""
    iterations: Count = 219
    """Number of iterations."""


class TabuDetmax(SelectionMethod):
    """DETMAX with a list of poses that may not come back for a while.

    They are random at the start; the pose dropped joins the end of the list, whose first becomes free. The pose just
    added may be dropped at once: no set is worse than the one before, and the list sees to it that others are tried.
    """

    name = "tabu"
    title = "Improved DETMAX with a tabu list"
    source = "Mitchell 1974, with a tabu list after Glover 1989"
    Config = TabuDetmaxConfig

    def __init__(self, config: TabuDetmaxConfig) -> None:
        self.list_length, self.iterations = config.list_length, config.iterations

    def select(self, problem: SelectionProblem, rng: np.random.Generator) -> SelectedPoses:
        """Return the best set seen."""
        n_distinct = problem.candidates.n_distinct
        if problem.n + self.list_length >= n_distinct:
            raise InputError(
                f"tabu: found a list of {self.list_length} with {problem.n} poses, expected fewer "
                f"than {n_distinct} candidates together"
            )
        scorer, best, outside = begin_exchange(problem, rng)
        best_set, trace = list(scorer.members), [best]
        tabu = deque(rng.permutation(np.flatnonzero(outside))[: self.list_length].tolist())
        outside[list(tabu)] = False
        for _ in range(self.iterations):
            added, _ = scorer.best_added(outside)
            scorer.add(added)
            outside[added] = False
            dropped, value = scorer.best_dropped()
            scorer.drop(dropped)
            tabu.append(dropped)
            outside[tabu.popleft()] = True
            trace.append(value)
            if value > best:
                best, best_set = value, list(scorer.members)
        reason = f"best of {self.iterations} iterations"
        return self._from_candidates(problem, np.array(best_set), trace, scorer.n_evaluations, reason)
