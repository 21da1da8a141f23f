"""What to free and what to fix: the largest set of parameters that the measurements determine together.

Rank-revealing selection in units of the tolerances: the symbol that the measurements tell most of, given what is
already chosen, is taken next. That is a pivoted Cholesky factorisation of Λ by blocks, its pivot the information in
nats per parameter. The legs of a machine get the same parameters. A symbol is taken where every chosen parameter
remains identifiable with it, all chosen ones unknown together.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from bayescal.identifiability.information import Information
from bayescal.limits import IDENTIFIABLE_CONTRACTION, NINETY
from bayescal.numerics.geometry import Array

MAX_TIE_NAT = 0.1
"""Nats per parameter, a tenth of a standard deviation, within which of two symbols the earlier one is taken, unless the
later one is told better on every leg."""


@dataclass(frozen=True)
class SelectionStep:
    """A symbol as it was looked at: taken or left."""

    symbol: str
    nats: float  # what is learnt of it per parameter, what was taken before being unknown
    contraction: float  # the least of all parameters taken, with it
    taken: bool


@dataclass(frozen=True)
class ParameterSelection:
    """Which parameters to free."""

    free: tuple[int, ...]  # positions among the audited parameters, in their order
    fixed: tuple[int, ...]  # all others, those that are known least first
    extra: tuple[int, ...]  # single parameters of symbols left out that could be freed too, on some legs
    steps: tuple[SelectionStep, ...]  # in the order of the selection


def select_parameters(
    information: Information, symbols: tuple[str, ...], last: Container[str] = ()
) -> ParameterSelection:
    """Return which of n parameters, each of a symbol, to free.

    The ``last`` symbols are looked at after all others: frames, which rather define than describe a machine.
    """
    matrix = information.matrix
    everything = {symbol: np.flatnonzero(np.array(symbols) == symbol) for symbol in dict.fromkeys(symbols)}
    taken = np.empty(0, dtype=int)
    steps: list[SelectionStep] = []
    for late in (False, True):
        left = {symbol: places for symbol, places in everything.items() if (symbol in last) == late}
        taken = _select(matrix, left, taken, steps)
    fixed = [int(k) for step in reversed(steps) if not step.taken for k in everything[step.symbol]]
    return ParameterSelection(tuple(sorted(taken.tolist())), tuple(fixed), _extend(matrix, taken), tuple(steps))


def _select(matrix: Array, left: dict[str, np.ndarray], taken: np.ndarray, steps: list[SelectionStep]) -> np.ndarray:
    """Return the parameters taken with those of further symbols; each look is added to the steps."""
    while left:
        rest = _condition(matrix, taken)
        gains = {}
        for symbol, places in left.items():
            values = np.linalg.eigvalsh(rest[np.ix_(places, places)])
            gains[symbol] = 0.5 * float(np.log1p(np.maximum(values, 0.0)).sum()) / len(places)
        symbol = _choose(np.diagonal(rest), left, gains)
        places = left.pop(symbol)
        together = np.concatenate([taken, places])
        contraction = float(_contraction(matrix, together).min())
        good = contraction >= IDENTIFIABLE_CONTRACTION
        taken = together if good else taken
        steps.append(SelectionStep(symbol, gains[symbol], contraction, good))
    return taken


def _choose(told: Array, left: dict[str, np.ndarray], gains: dict[str, float]) -> str:
    """Return the symbol that is told best; of several alike the first in the layout."""
    best = max(left, key=lambda symbol: gains[symbol])
    for symbol, places in left.items():
        alike = gains[symbol] >= gains[best] - MAX_TIE_NAT and len(places) == len(left[best])
        if symbol == best or (alike and not np.all(told[left[best]] > told[places])):
            return symbol
    return best


def _extend(matrix: Array, taken: np.ndarray) -> tuple[int, ...]:
    """Return single parameters that may be added, the best known first."""
    chosen = taken
    others = np.setdiff1d(np.arange(len(matrix)), chosen)
    while len(others):
        gains = np.diagonal(_condition(matrix, chosen))[others]
        place = int(others[np.argmax(gains)])
        others = others[others != place]
        together = np.append(chosen, place)
        if _contraction(matrix, together).min() >= IDENTIFIABLE_CONTRACTION:
            chosen = together
    return tuple(chosen[len(taken) :].tolist())


def _contraction(matrix: Array, places: np.ndarray) -> Array:
    part = matrix[np.ix_(places, places)]
    return 1.0 - np.diagonal(np.linalg.inv(part + np.eye(len(places))))


def _condition(matrix: Array, taken: np.ndarray) -> Array:
    """Return the information on all parameters when those taken are unknown within their tolerances, (n, n)."""
    if not len(taken):
        return matrix
    across = matrix[:, taken]
    inner = matrix[np.ix_(taken, taken)] + np.eye(len(taken))
    return np.asarray(matrix - across @ np.linalg.solve(inner, across.T))


# --- what a reduced set errs by ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ReducedSet:
    """What a calibration of m parameters claims, and how far it really errs, to first order.

    It takes all others o for nominal, claims what the measurements would leave were they so, and errs by more: the
    others are off by their tolerances, and what is fitted takes up what it can of that. In units of the tolerances,
    with K = (1 + Λ_ff)⁻¹ for the set f, it claims K and errs by K + K Λ_fo Λ_of K.
    """

    free: np.ndarray  # (m,): positions among the audited parameters
    # (m,) each: standard deviation that its calibration claims, and rms of its true error, in tolerances
    claimed: Array
    error: Array

    @property
    def coverage(self) -> Array:
        """Probability that a 90 % interval holds the truth, shape (m,)."""
        return np.asarray(erf(NINETY * self.claimed / self.error / np.sqrt(2.0)))

    @property
    def rms_z(self) -> float:
        """Root mean square of the true errors in claimed standard deviations: one where the claims are true."""
        return float(np.sqrt(np.mean((self.error / self.claimed) ** 2)))


def judge_reduced(information: Information, free: tuple[int, ...]) -> ReducedSet | None:
    """Return what a calibration of some parameters claims and errs by; None where there are none, or it is all."""
    chosen = np.array(free, dtype=int)
    if not 0 < len(chosen) < information.root.shape[1]:
        return None
    part = information.matrix[np.ix_(chosen, chosen)] + np.eye(len(chosen))
    errors = information.errors_of_reduced(free)
    return ReducedSet(chosen, np.sqrt(np.diagonal(np.linalg.inv(part))), np.sqrt(np.diagonal(errors)[chosen]))
