"""Where poses may be measured: a box of pose displacements or of actuator displacements, the other one as constraint.

A pose is a point of the unit box [-1, 1]^d. In a `WorkspaceBox` its coordinates are the displacement and the rotation
vector about home, in shares of the half widths, and the actuators' range is the constraint; in an `ActuatorBox` they
are the actuators' displacements in shares of their range, and the constraint is a workspace, where there is one.

"Evenly distributed" candidates may mean several things, and the optimum depends on which: far corners of the workspace
tell most. There are uniformly random ones; points of a low-discrepancy sequence moved to the nodes of a grid whose
outer nodes lie on the boundary; and the nodes of a coarse full factorial, topped up with such points.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from bayescal.errors import InputError
from bayescal.identifiability.pose_volume import SLACK, describe_move
from bayescal.machines.kinematics import (
    ForwardKinematics,
    check_home_pose,
    solve_forward_kinematics,
    solve_inverse_kinematics,
)
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector, rotation_vector_from_matrix
from bayescal.pose_selection.design import Design, PlacedPoses, SeenPoses

DIGITS = 9  # of shares of the box: poses that agree so far are the same
ATTEMPTS = 100
LEVELS = 11
AT_ONCE = 5_000  # candidates whose derivatives are held at once


@dataclass(frozen=True, eq=False)
class PoseDomain(ABC):
    """The poses that may be measured with a machine."""

    design: Design  # the machine as expected, its free parameters, and what measures it

    @property
    @abstractmethod
    def n_coordinates(self) -> int:
        """Number of coordinates d."""

    @abstractmethod
    def place(self, shares: Array) -> PlacedPoses:
        """Return the poses at points (P, d) of the unit box."""

    @abstractmethod
    def margins(self, placed: PlacedPoses) -> Array:
        """Return what is left of each constraint, shape (P, m), in shares of its limit; negative where it is broken."""

    @cached_property
    def home(self) -> ForwardKinematics:
        """The expected machine's pose at the initial actuator positions."""
        check_home_pose(self.design.machine)
        start = self.design.machine.mechanism.initial_actuator_positions
        return solve_forward_kinematics(self.design.machine, self.design.theta, start)

    def allows(self, placed: PlacedPoses) -> np.ndarray:
        """Return which poses exist and keep the constraints, shape (P,)."""
        margins = self.margins(placed)
        return np.asarray(placed.found & np.all(margins >= -SLACK, axis=1))

    def at_moves(self, moves: Array) -> PlacedPoses:
        """Return poses at displacements (P, 6) from home, mm and rad."""
        position = self.home.position + moves[:, :3]
        rotation = matrix_from_rotation_vector(moves[:, 3:]) @ self.home.rotation
        inverse = solve_inverse_kinematics(self.design.machine, self.design.theta, position, rotation, check=False)
        return PlacedPoses(moves, position, rotation, inverse.actuators, inverse.converged)

    def at_actuators(self, actuators: Array) -> PlacedPoses:
        """Return poses at actuator positions (P, N), mm."""
        pose = solve_forward_kinematics(self.design.machine, self.design.theta, actuators, check=False)
        turned = pose.rotation @ self.home.rotation.T
        moves = np.concatenate([pose.position - self.home.position, rotation_vector_from_matrix(turned)], axis=-1)
        return PlacedPoses(moves, pose.position, pose.rotation, actuators, pose.converged)


@dataclass(frozen=True, eq=False)
class WorkspaceBox(PoseDomain):
    """A box of displacements and rotation vectors about home."""

    half: Array  # (6,): half widths, mm and rad; zero where an axis stays

    def __post_init__(self) -> None:
        """Check the half widths."""
        _check_half(self.half)

    @cached_property
    def _used(self) -> np.ndarray:
        return np.flatnonzero(self.half > 0.0)

    @property
    def n_coordinates(self) -> int:
        """Number of axes that move."""
        return len(self._used)

    def place(self, shares: Array) -> PlacedPoses:
        """Return the poses at points (P, d) of the unit box."""
        moves = np.zeros((len(shares), 6))
        moves[:, self._used] = shares * self.half[self._used]
        return self.at_moves(moves)

    def margins(self, placed: PlacedPoses) -> Array:
        """Return what is left of the actuators' range on both sides, shape (P, 2 N)."""
        mechanism = self.design.machine.mechanism
        moved = (placed.actuators - mechanism.initial_actuator_positions) / mechanism.actuator_range
        return np.concatenate([1.0 - moved, 1.0 + moved], axis=1)


@dataclass(frozen=True, eq=False)
class ActuatorBox(PoseDomain):
    """A box of actuator displacements about the initial positions, for machines of six legs."""

    half: Array | None = None  # (6,): half widths of a workspace that poses must not leave, mm and rad

    def __post_init__(self) -> None:
        """Check that actuators alone determine a pose, and the half widths."""
        if self.n_coordinates != 6:
            raise InputError(f"poses by actuators: found {self.n_coordinates} legs, expected 6")
        if self.half is not None:
            _check_half(self.half)

    @property
    def n_coordinates(self) -> int:
        """Number of actuators."""
        return self.design.machine.mechanism.n_legs

    def place(self, shares: Array) -> PlacedPoses:
        """Return the poses at points (P, N) of the unit box."""
        mechanism = self.design.machine.mechanism
        return self.at_actuators(mechanism.initial_actuator_positions + mechanism.actuator_range * shares)

    def margins(self, placed: PlacedPoses) -> Array:
        """Return what is left of the workspace on both sides, shape (P, 12), or (P, 0) without one."""
        if self.half is None:
            return np.zeros((len(placed.moves), 0))
        shares = placed.moves / np.where(self.half > 0.0, self.half, 1.0)
        return np.concatenate([1.0 - shares, 1.0 + shares], axis=1)


def _check_half(half: Array) -> None:
    if half.shape != (6,) or not np.all(np.isfinite(half)) or np.any(half < 0.0) or not np.any(half > 0.0):
        listed = ", ".join(f"{value:g}" for value in half)
        raise InputError(f"workspace: found half widths {listed}, expected six, finite, ≥ 0, not all 0")


# --- candidates -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Candidates:
    """Poses that may be measured, with the identification blocks J_b of each (Yu, Wu and Wang 2023 eq. 23)."""

    domain: PoseDomain  # the machine and where its poses may lie
    shares: Array  # (C, d): coordinates in the domain's unit box
    placed: PlacedPoses  # displacements from home and actuator positions

    def __len__(self) -> int:
        """Return the number of candidates C."""
        return len(self.shares)

    def see_in_parts(self) -> Iterator[SeenPoses]:
        """Yield some candidates after the others, to first order: derivatives of all at once take memory."""
        if len(self) <= AT_ONCE:
            yield self.seen
            return
        for k in range(0, len(self), AT_ONCE):
            yield self.domain.design.see(self.placed.select(slice(k, k + AT_ONCE)), "candidate", k + 1)

    @cached_property
    def seen(self) -> SeenPoses:
        """All candidates to first order; its ``slope`` is J_b, shape (C, 6, L), mm and rad by the parameters' units."""
        return self.domain.design.see(self.placed, "candidate")

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
    """Return candidates at given points (C, d) of the domain's unit box.

    InputError names the first that is not finite, outside the box, out of the machine's reach, or breaks a constraint.
    """
    if shares.ndim != 2 or shares.shape[1] != domain.n_coordinates or not len(shares):
        raise InputError(f"candidates: found shape {shares.shape}, expected rows of {domain.n_coordinates} numbers")
    _check_finite(shares)
    outside = np.abs(shares).max(axis=1) > 1.0 + 1e-9
    if outside.any():
        raise InputError(f"candidate {np.argmax(outside) + 1}: found outside the box")
    placed = domain.place(shares)
    bad = ~domain.allows(placed)
    if bad.any():
        first = int(np.argmax(bad))
        where, fault = "", "out of reach"
        if placed.found[first]:
            where, fault = f" ({describe_move(placed.moves[first])})", "outside actuator range or workspace"
        raise InputError(f"candidate {first + 1}{where}: {fault}")
    return Candidates(domain, shares, placed)


def candidates_at_actuators(domain: PoseDomain, actuators: Array) -> Candidates:
    """Return candidates at actuator positions (C, N), mm, anywhere in an `ActuatorBox`; errors as `candidates_at`."""
    mechanism = domain.design.machine.mechanism
    _check_finite(actuators)
    return candidates_at(domain, (actuators - mechanism.initial_actuator_positions) / mechanism.actuator_range)


def random_candidates(domain: PoseDomain, n: int, rng: np.random.Generator) -> Candidates:
    """Return n uniformly random candidates, those that break a constraint drawn again."""
    return _collect(domain, n, lambda size: rng.uniform(-1.0, 1.0, (size, domain.n_coordinates)))


def even_candidates(
    domain: PoseDomain, n: int, rng: np.random.Generator | None = None, levels: int | None = LEVELS
) -> Candidates:
    """Return n evenly distributed candidates: a Halton sequence, scrambled or not, moved to the nodes of a grid.

    2000 of them in Yu's workspace reproduce the indices printed for random sets and for optimal ones: 11 levels are
    steps of 20 mm and 2 deg. Without a grid the optimum is 3 % lower, and with all nodes of a coarse grid 60 % higher.

    A generator scrambles the sequence; ``levels`` are nodes per axis, the outer ones on the boundary; None leaves the
    points where they are.
    """
    from scipy.stats import qmc  # half a second to import

    if levels is not None and levels < 2:
        raise InputError(f"candidates: found {levels} levels per axis, expected 2 or more")
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
