"""What a criterion of pose selection has to supply, and the bookkeeping of a set of poses that all share.

A criterion turns the poses of a set into one number, larger is better, out of rows: the identification Jacobian of the
set's poses, of those measured already, and the prior where there is one. A scorer keeps a set and says what it would be
worth with one pose more or less, for all candidates at once and without forming their sets.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from bayescal.config.sections import Section
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.design import Design, SeenPoses
from bayescal.pose_selection.observability import JacobianForm, identification_rows

RANK_TOLERANCE = 1e-11


class Purpose(Protocol):
    """What poses are selected for: what a criterion may be made from."""

    @property
    def design(self) -> Design:
        """The machine, its tolerances, sensors and noise."""

    @property
    def form(self) -> JacobianForm:
        """Which derivatives observability indices are of; see `identification_rows`."""

    @property
    def workspace(self) -> SeenPoses:
        """The poses that stand for the workspace, to first order."""

    @property
    def limits(self) -> Array:
        """What errors of a pose are measured by, shape (6,), mm and rad."""


class Criterion(ABC):
    """An objective of pose selection.

    One of somebody else's is named in a config, ``criteria = ["own.py:Own"]``; its ``Config`` checks its options, and
    `__init__(self, config, purpose)` makes it.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    source: ClassVar[str]
    """Author, year and equation."""
    Config: ClassVar[type[Section]] = Section

    @classmethod
    def from_config(cls, config: Any, purpose: Purpose) -> Self:
        """Return a built-in criterion for a purpose."""
        del config, purpose
        return cls()

    @abstractmethod
    def rows(self, seen: SeenPoses) -> Array:
        """Return what each pose contributes, shape (P, k, L), in the criterion's units."""

    def prior_rows(self, n_parameters: int) -> Array:
        """Return what is known without any pose, shape (b, L)."""
        return np.zeros((0, n_parameters))

    @abstractmethod
    def value(self, rows: Array, n_poses: int) -> Array:
        """Return the criterion of stacked rows (..., R, L), those of the prior included, shape (...)."""

    @abstractmethod
    def gradient(self, rows: Array, n_poses: int) -> Array:
        """Return the derivative by the information RᵀR of stacked rows (R, L), shape (L, L), symmetric.

        A change dR of the rows changes the criterion by 2 tr(Γ Rᵀ dR).
        """

    @abstractmethod
    def scorer(self, blocks: Array, base: Array, n_base: int) -> Scorer:
        """Return a scorer for candidates.

        Parameters
        ----------
        blocks : ndarray, shape (C, k, L)
            Rows of each candidate.
        base : ndarray, shape (b, L)
            Rows that belong to every set: prior and poses measured already.
        n_base : int
            Number of poses among the latter.
        """


@dataclass(frozen=True)
class ObservabilityCriterion(Criterion):
    """An observability index: neither prior nor noise counts."""

    form: JacobianForm = "pose"  # which derivatives count; see `identification_rows`

    @classmethod
    def from_config(cls, config: Any, purpose: Purpose) -> Self:
        """Return the index of the purpose's derivatives."""
        del config
        return cls(form=purpose.form)

    def rows(self, seen: SeenPoses) -> Array:
        """Return J_b, shape (P, 6, L), mm and rad by the parameters' units, or J_2, shape (P, N, L)."""
        return identification_rows(seen, self.form)


class BayesianCriterion(Criterion):
    """A criterion that counts prior and noise."""

    def rows(self, seen: SeenPoses) -> Array:
        """Return the identification Jacobian in units of noise and tolerances, shape (P, k, L)."""
        return seen.rows

    def prior_rows(self, n_parameters: int) -> Array:
        """Return the identity: in units of the tolerances the prior is a standard normal."""
        return np.eye(n_parameters)


class Scorer(ABC):
    """A set of candidates with what it is worth.

    Attributes
    ----------
    members : list of int
        The set.
    n_evaluations : int
        How many sets have been judged.
    """

    def __init__(self, criterion: Criterion, blocks: Array, base: Array, n_base: int) -> None:
        self.criterion, self.blocks, self.base, self.n_base = criterion, blocks, base, n_base
        self.members: list[int] = []
        self.n_evaluations = 0

    @property
    def n_poses(self) -> int:
        """Poses of the set and those measured already."""
        return self.n_base + len(self.members)

    def start(self, members: Sequence[int]) -> None:
        """Begin with a set."""
        self.members = [int(k) for k in members]

    def add(self, candidate: int) -> None:
        """Add a candidate to the set."""
        self.members.append(candidate)

    def drop(self, candidate: int) -> None:
        """Remove a member from the set."""
        self.members.remove(candidate)

    def stack(self) -> Array:
        """Return the rows of the set, shape (R, L)."""
        return self._stack_of(self.members, self.blocks, self.base)

    @staticmethod
    def _stack_of(members: Sequence[int] | np.ndarray, blocks: Array, base: Array) -> Array:
        return np.concatenate([base, blocks[members].reshape(-1, blocks.shape[-1])])

    def value(self) -> float:
        """Return the criterion of the set, computed again."""
        return float(self.criterion.value(self.stack(), self.n_poses))

    @abstractmethod
    def values_added(self) -> Array:
        """Return the criterion of the set with each candidate added, shape (C,)."""

    @abstractmethod
    def values_dropped(self) -> Array:
        """Return the criterion of the set without each member, in the order of ``members``, shape (n,)."""

    def best_added(self, allowed: np.ndarray) -> tuple[int, float]:
        """Return the best candidate to add of those allowed (C,), the first of equals, and the criterion with it."""
        values = np.where(allowed, self.values_added(), -np.inf)
        self.n_evaluations += int(allowed.sum())
        best = int(np.argmax(values))
        return best, float(values[best])

    def best_dropped(self) -> tuple[int, float]:
        """Return the member without which the set is best, the first of equal ones, and the criterion without it."""
        values = self.values_dropped()
        self.n_evaluations += len(values)
        place = int(np.argmax(values))
        return self.members[place], float(values[place])


def whiten(blocks: Array, base: Array) -> tuple[Array, Array]:
    """Return the root R of everything that could be measured, (L, L), and the blocks in its coordinates, (C, k, L).

    Squares of Jacobians in mm and rad lose half of the digits; in these coordinates sets of poses are well conditioned.
    InputError where all candidates together do not determine the parameters.
    """
    n = blocks.shape[-1]
    root = np.linalg.qr(np.concatenate([base, blocks.reshape(-1, n)]), mode="r")
    check_rank(root)
    return root, blocks @ np.linalg.inv(root)


def check_rank(rows: Array) -> None:
    """Raise InputError where rows (R, L) leave parameters undetermined, columns scaled to one."""
    n = rows.shape[-1]
    length = np.linalg.norm(rows, axis=0)
    values = np.linalg.svd(rows / np.where(length > 0.0, length, 1.0), compute_uv=False)
    rank = int(np.sum(values > RANK_TOLERANCE * values[0])) if values.size else 0
    if rank < n:
        raise InputError(
            f"candidates: found {rank} of {n} parameters determined, expected all; fix some, or use a "
            "Bayesian criterion"
        )
