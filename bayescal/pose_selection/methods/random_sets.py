"""Random sets of candidates, and the best of them: what every other method is measured against."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayescal.errors import InputError
from bayescal.pose_selection.methods.base import Selection, SelectionMethod
from bayescal.pose_selection.problem import SelectionProblem

CHUNK = 100


@dataclass(frozen=True)
class RandomSets(SelectionMethod):
    """The best of random sets; its trace holds what each is worth (Yu, Wu and Wang 2023, figure 7).

    Attributes
    ----------
    n_sets : int
        How many; 1 for a single random set.
    """

    n_sets: int = 1000

    name: ClassVar[str] = "random"
    title: ClassVar[str] = "Best of random sets"
    source: ClassVar[str] = "Random sampling"

    def select(self, problem: SelectionProblem, rng: np.random.Generator) -> Selection:
        """Return the best of the sets."""
        if self.n_sets < 1:
            raise InputError(f"random: found {self.n_sets} sets, expected at least 1")
        sets = np.stack([problem.draw_set(rng) for _ in range(self.n_sets)])
        values = np.concatenate([self._judge(problem, part) for part in np.split(sets, range(CHUNK, len(sets), CHUNK))])
        best = sets[int(np.argmax(values))]
        return self._from_candidates(problem, best, values.tolist(), len(sets), f"{len(sets)} sets judged")

    @staticmethod
    def _judge(problem: SelectionProblem, sets: np.ndarray) -> np.ndarray:
        rows = problem.blocks[sets].reshape(len(sets), -1, problem.n_parameters)
        base = np.broadcast_to(problem.base, (len(sets), *problem.base.shape))
        return problem.criterion.value(np.concatenate([base, rows], axis=1), problem.n_measured + problem.n)
