"""Poses that may be measured, with the identification blocks J_b of each (Yu, Wu and Wang 2023 eq. 23).

"Evenly distributed" candidates may mean several things, and the optimum depends on which: far corners of the workspace
tell most. There are uniformly random ones; points of a low-discrepancy sequence moved to the nodes of a grid whose
outer nodes lie on the boundary; and the nodes of a coarse full factorial, topped up with such points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy.stats import qmc

from bayescal.errors import InputError
from bayescal.identifiability.design import describe_move
from bayescal.identifiability.sensitivity import Sensitivity
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.domain import PlacedPoses, PoseDomain

DIGITS = 9  # of shares of the box: poses that agree so far are the same
ATTEMPTS = 100
LEVELS = 11
AT_ONCE = 10_000  # candidates whose derivatives are held at once


@dataclass(frozen=True, eq=False)
class Candidates:
    """Poses that may be measured.

    Attributes
    ----------
    domain : PoseDomain
        The machine and where its poses may lie.
    shares : ndarray, shape (C, d)
        Coordinates in the domain's unit box.
    placed : PlacedPoses
        Displacements from home and actuator positions.
    """

    domain: PoseDomain
    shares: Array
    placed: PlacedPoses

    def __len__(self) -> int:
        """Return the number of candidates C."""
        return len(self.shares)

    def linearise_in_parts(self) -> Iterator[Sensitivity]:
        """Yield the derivatives of some candidates after the others: those of all at once take memory."""
        if len(self) <= AT_ONCE:
            yield self.sensitivity
            return
        for k in range(0, len(self), AT_ONCE):
            yield self.domain.linearise(self.placed.select(slice(k, k + AT_ONCE)), first=k + 1)

    @cached_property
    def sensitivity(self) -> Sensitivity:
        """Derivatives at all candidates; its ``slope`` is J_b, shape (C, 6, L), mm and rad by the parameters' units."""
        return self.domain.linearise(self.placed)

    @cached_property
    def distinct(self) -> np.ndarray:
        """Which candidates differ from all before them, bool, shape (C,)."""
        _, first = np.unique(np.round(self.shares, DIGITS) + 0.0, axis=0, return_index=True)  # + 0.0: no minus zero
        mask = np.zeros(len(self), dtype=bool)
        mask[first] = True
        return mask

    @property
    def n_distinct(self) -> int:
        """Number of different poses among the candidates."""
        return int(self.distinct.sum())


def candidates_at(domain: PoseDomain, shares: Array) -> Candidates:
    """Return candidates at given points of the domain's unit box.

    Parameters
    ----------
    domain : PoseDomain
    shares : ndarray, shape (C, d)

    Raises
    ------
    InputError
        Names the first candidate that is not finite, outside the box, out of the machine's reach, or that breaks the
        domain's constraints.
    """
    if shares.ndim != 2 or shares.shape[1] != domain.n_coordinates or not len(shares):
        raise InputError(f"candidates: found an array {shares.shape}, expected rows of {domain.n_coordinates} numbers")
    _check_finite(shares)
    _name_first(np.abs(shares).max(axis=1) > 1.0 + 1e-9, "found it outside the box, expected coordinates within it")
    placed = domain.place(shares)
    _check_allowed(domain, placed)
    return Candidates(domain, shares, placed)


def candidates_at_actuators(domain: PoseDomain, actuators: Array) -> Candidates:
    """Return candidates at actuator positions (C, N), mm, anywhere in an `ActuatorBox`; errors as `candidates_at`."""
    mechanism = domain.knowledge.machine.mechanism
    _check_finite(actuators)
    return candidates_at(domain, (actuators - mechanism.initial_actuator_positions) / mechanism.actuator_range)


def random_candidates(domain: PoseDomain, n: int, rng: np.random.Generator) -> Candidates:
    """Return n uniformly random candidates, those that break a constraint drawn again."""
    return _collect(domain, n, lambda size: rng.uniform(-1.0, 1.0, (size, domain.n_coordinates)))


def even_candidates(
    domain: PoseDomain, n: int, rng: np.random.Generator | None = None, levels: int | None = LEVELS
) -> Candidates:
    """Return n evenly distributed candidates: a Halton sequence, moved to the nodes of a grid.

    2000 of them in Yu's workspace reproduce the indices printed for random sets and for optimal ones: 11 levels are
    steps of 20 mm and 2 deg. Without a grid the optimum is 3 % lower, and with all nodes of a coarse grid 60 % higher.

    Parameters
    ----------
    domain : PoseDomain
    n : int
    rng : Generator, optional
        Scrambles the sequence.
    levels : int, optional
        Nodes per axis, the outer ones on the boundary; None leaves the points where they are.
    """
    if levels is not None and levels < 2:
        raise InputError(f"candidates: found {levels} levels per axis, expected at least 2")
    halton = qmc.Halton(domain.n_coordinates, scramble=rng is not None, rng=rng)
    halton.fast_forward(1)  # the first point, unscrambled, is a corner

    def draw(size: int) -> Array:
        points = 2.0 * halton.random(size) - 1.0
        if levels is None:
            return np.asarray(points)
        half = 0.5 * (levels - 1)
        return np.asarray((np.round((points + 1.0) * half) - half) / half)

    return _collect(domain, n, draw)


def factorial_candidates(domain: PoseDomain, n: int, rng: np.random.Generator | None = None) -> Candidates:
    """Return n candidates: the nodes of the largest full factorial that reaches the boundary, topped up by a sequence.

    Levels per axis differ by one at most, the first axes having more. Nodes that break a constraint are left out.
    """
    axes = domain.n_coordinates
    levels = [1] * axes
    while np.prod(levels) // levels[k := levels.index(min(levels))] * (levels[k] + 1) <= n:
        levels[k] += 1
    nodes = np.array(list(product(*(np.linspace(-1.0, 1.0, m) if m > 1 else np.zeros(1) for m in levels))))
    kept = nodes[domain.allows(domain.place(nodes))]
    if len(kept) == n:
        return candidates_at(domain, kept)
    return candidates_at(domain, np.concatenate([kept, even_candidates(domain, n - len(kept), rng, None).shares]))


def _collect(domain: PoseDomain, n: int, draw: Callable[[int], Array]) -> Candidates:
    if n < 1:
        raise InputError(f"candidates: found a number of {n}, expected at least 1")
    kept: list[Array] = []
    count = 0
    for _ in range(ATTEMPTS):
        shares = draw(n)
        good = shares[domain.allows(domain.place(shares))]
        kept.append(good)
        count += len(good)
        if count >= n:
            return candidates_at(domain, np.concatenate(kept)[:n])
    raise InputError(
        f"candidates: found {count} of {ATTEMPTS * n} poses within actuator range and workspace, expected {n}"
    )


def _check_finite(values: Array) -> None:
    good = np.isfinite(values)
    if not good.all():
        row = int(np.argmin(good.all(axis=1)))
        value = values[row][~good[row]][0]
        raise InputError(f"candidate {row + 1}: found the coordinate {value:g}, expected finite numbers")


def _name_first(bad: np.ndarray, fault: str) -> None:
    if bad.any():
        raise InputError(f"candidate {int(np.argmax(bad)) + 1}: {fault}")


def _check_allowed(domain: PoseDomain, placed: PlacedPoses) -> None:
    bad = ~domain.allows(placed)
    if bad.any():
        first = int(np.argmax(bad))
        fault = "found it outside actuator range or workspace" if placed.found[first] else "found it out of reach"
        where = describe_move(placed.moves[first]) if placed.found[first] else ""
        raise InputError(
            f"candidate {first + 1}{f' ({where})' if where else ''}: {fault}, expected one the machine can take"
        )
