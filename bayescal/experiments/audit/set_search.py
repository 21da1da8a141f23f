"""The best sets of sensors of every number: all sets judged where they are few, else found by adding and exchanging."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations
from math import comb

import numpy as np

from bayescal.experiments.audit.sensor_sets import SensorSets, SetAccuracy, judge_set
from bayescal.numerics.geometry import Array

MOST_ROUNDS = 20  # of exchanges


@dataclass(frozen=True, eq=False)
class FoundSets:
    """Sets of sensors that were judged.

    Attributes
    ----------
    sets : ndarray of bool, shape (S, C)
        By their numbers of choices, then in the order in which they were tried.
    accuracy : list of SetAccuracy
    exhaustive : bool
        Whether these are all there are.
    probability : ndarray, shape (S,)
        That all requirements are kept, of the best set of every number and of those on the front against the price;
        NaN of others and without requirements.
    """

    sets: np.ndarray
    accuracy: list[SetAccuracy]
    exhaustive: bool
    probability: Array

    def best_of(self, number: int) -> int | None:
        """Return where the best set of a number of choices stands; None where none is any good."""
        places = np.flatnonzero(self.sets.sum(axis=1) == number)
        goals = np.array([self.accuracy[k].goal for k in places])
        return int(places[goals.argmin()]) if np.isfinite(goals).any() else None


@dataclass(frozen=True, eq=False)
class _Judge:
    """Judges every set once."""

    sets: SensorSets
    known: dict[tuple[int, ...], SetAccuracy] = field(default_factory=dict)

    def __call__(self, chosen: tuple[int, ...]) -> tuple[int, float]:
        """Return what is not told, and the goal, of a set of choices: less is better."""
        if chosen not in self.known:
            mask = np.zeros(len(self.sets.members), dtype=bool)
            mask[list(chosen)] = True
            self.known[chosen] = judge_set(self.sets, mask)
        return self.known[chosen].missing, self.known[chosen].goal


def search_sets(sets: SensorSets, largest: int, exhaustive: int) -> FoundSets:
    """Return all sets of at most some number of choices, or those tried on the way to the best ones.

    Parameters
    ----------
    sets : SensorSets
    largest : int
        Choices of a set, at most.
    exhaustive : int
        Sets, up to which all are judged.
    """
    judge, n = _Judge(sets), len(sets.members)
    every = sum(comb(n, number) for number in range(largest + 1)) <= exhaustive
    for chosen in _list_all(n, largest) if every else ():
        judge(chosen)
    if not every:
        _add_and_exchange(judge, n, largest)
    found = sorted(judge.known, key=len)
    masks = np.array([np.isin(np.arange(n), one) for one in found]).reshape(-1, n)
    return FoundSets(masks, [judge.known[one] for one in found], every, np.full(len(masks), np.nan))


def _list_all(n: int, largest: int) -> Iterator[tuple[int, ...]]:
    for number in range(largest + 1):
        yield from combinations(range(n), number)


def _add_and_exchange(judge: _Judge, n: int, largest: int) -> None:
    """Add the best choice, then exchange chosen ones for others while that helps, for every number of them."""
    chosen: tuple[int, ...] = ()
    judge(chosen)
    for _ in range(largest):
        chosen = min((_with(chosen, k) for k in range(n) if k not in chosen), key=judge)
        for _ in range(MOST_ROUNDS):
            other = min(_exchange(chosen, n), key=judge, default=chosen)
            if not judge(other) < judge(chosen):
                break
            chosen = other


def _with(chosen: tuple[int, ...], one: int) -> tuple[int, ...]:
    return tuple(sorted((*chosen, one)))


def _exchange(chosen: tuple[int, ...], n: int) -> Iterator[tuple[int, ...]]:
    """Yield the sets that have another choice in place of one of theirs."""
    for out in chosen:
        left = tuple(k for k in chosen if k != out)
        yield from (_with(left, k) for k in range(n) if k not in chosen)


def find_hopeless(found: FoundSets) -> list[int]:
    """Return the largest sets that are no good: their parts, which tell less, are no good either."""
    places = np.array([k for k, one in enumerate(found.accuracy) if one.reason], dtype=int)
    some = found.sets[places]
    within = (some.astype(np.int64) @ (~some).T.astype(np.int64)) == 0  # a set of the row within that of the column
    np.fill_diagonal(within, val=False)
    return [int(k) for k in places[~within.any(axis=1)]]
