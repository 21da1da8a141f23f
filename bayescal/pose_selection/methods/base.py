"""What a selection method has to supply, and what it returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from bayescal.config.sections import Section
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.criteria import Scorer
from bayescal.pose_selection.domain import PlacedPoses
from bayescal.pose_selection.problem import SelectionProblem

ATTEMPTS = 100
GAIN = 1e-12
"""Of the criterion's size: less is rounding, no improvement."""


@dataclass(frozen=True, eq=False)
class Selection:
    """Poses to measure.

    Attributes
    ----------
    method, criterion : str
        Names.
    index : ndarray of int, shape (n,), or None
        Which candidates; None where poses lie between them.
    shares : ndarray, shape (n, d)
        Coordinates in the domain's unit box.
    placed : PlacedPoses
        Displacements from home and actuator positions.
    value : float
        The criterion, found anew from the poses' rows; larger is better.
    trace : ndarray, shape (T,)
        The criterion after each iteration, that of the start first.
    n_evaluations : int
        How many sets were judged.
    converged : bool
        Whether the method ended by itself.
    reason : str
        Why it ended.
    """

    method: str
    criterion: str
    index: np.ndarray | None
    shares: Array
    placed: PlacedPoses
    value: float
    trace: Array
    n_evaluations: int
    converged: bool
    reason: str

    @property
    def actuators(self) -> Array:
        """Actuator positions to command, shape (n, N), mm."""
        return self.placed.actuators


class SelectionMethod(ABC):
    """A method of pose selection; its options are its fields.

    One of somebody else's is named in a config, ``method = "own.py:Own"``; what its table says beside the keys of every
    choice is checked by its ``Config``.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    source: ClassVar[str]
    Config: ClassVar[type[Section]] = Section

    @classmethod
    def from_config(cls, config: Any) -> Self:
        """Return the method with the options of a section of a config."""
        return cls(**dict(config))

    @abstractmethod
    def select(self, problem: SelectionProblem, rng: np.random.Generator) -> Selection:
        """Return the poses that the method selects."""

    def _from_candidates(
        self,
        problem: SelectionProblem,
        index: np.ndarray,
        trace: list[float],
        n_evaluations: int,
        reason: str,
        converged: bool = True,
    ) -> Selection:
        index = np.sort(index)
        candidates = problem.candidates
        return Selection(
            self.name,
            problem.criterion.name,
            index,
            candidates.shares[index],
            candidates.domain.place(candidates.shares[index]),
            problem.value_of(problem.blocks[index]),
            np.array(trace),
            n_evaluations,
            converged,
            reason,
        )


def start_set(
    problem: SelectionProblem, scorer: Scorer, start: tuple[int, ...] | None, rng: np.random.Generator
) -> float:
    """Put a given set, or a random one that determines the parameters, into a scorer; return what it is worth.

    Raises
    ------
    InputError
        Where the given set is not one of n distinct candidates, or no random one determines the parameters.
    """
    if start is not None:
        within = all(0 <= k < len(problem.candidates) for k in start)
        if len(set(start)) != problem.n or len(start) != problem.n or not within:
            raise InputError(f"start: found candidates {list(start)}, expected {problem.n} different ones")
        scorer.start(start)
        return scorer.value()
    for _ in range(ATTEMPTS):
        scorer.start(problem.draw_set(rng).tolist())
        value = scorer.value()
        if np.isfinite(value) and value != 0.0:
            return value
    raise InputError(
        f"candidates: found no set of {problem.n} in {ATTEMPTS} random ones that determines the parameters, "
        "expected more poses or other candidates"
    )
