"""What is known of a machine after some poses, and what a further pose does: what the next pose is found from.

A machine on legs and a machine of any readings differ in their rows, in what has to be accurate and in how a pose is
commanded; everything above that is the same.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.identifiability.remaining import Remaining, Standing
from bayescal.identifiability.requirements import Requirement, find_limits
from bayescal.inference.target import Target
from bayescal.inference.updating import Belief, update
from bayescal.numerics.geometry import Array


@dataclass(frozen=True)
class Shown:
    """A column of the poses to come, as the page shows it.

    Attributes
    ----------
    column, heading, unit, group : str
    decimals : int
    """

    column: str
    heading: str
    unit: str
    group: str
    decimals: int


class Subject(ABC):
    """One variant of a machine with the poses measured so far, and those that may be measured."""

    requirements: list[Requirement]

    @property
    @abstractmethod
    def posterior(self) -> Target:
        """Of the poses measured so far."""

    @property
    @abstractmethod
    def n_poses(self) -> int:
        """How many these are."""

    @property
    @abstractmethod
    def n_workspace(self) -> int:
        """Number of poses that stand for the workspace."""

    @property
    @abstractmethod
    def allowed(self) -> np.ndarray:
        """Which candidates have not been measured, shape (C,)."""

    @abstractmethod
    def first(self, n: int) -> Subject:
        """Return the same after the first n of its poses."""

    @abstractmethod
    def know(self, belief: Belief, seed: int) -> State:
        """Return what is known by a belief."""

    @abstractmethod
    def list_arrays(self, n_draws: int) -> list[Sequence[float]]:
        """Return what it holds of candidates, workspace and so many draws; see `estimate_arrays`."""

    @abstractmethod
    def list_shown(self) -> list[Shown]:
        """Return what the page shows of the poses to come."""


@dataclass(frozen=True, eq=False)
class State(ABC):
    """A variant after the poses measured so far; S draws, m parameters, C candidates.

    Attributes
    ----------
    belief : Belief
    seed : int
    """

    belief: Belief
    seed: int

    @property
    @abstractmethod
    def subject(self) -> Subject:
        """The variant."""

    @property
    @abstractmethod
    def theta(self) -> Array:
        """Draws of the true machine, shape (S, D)."""

    @property
    @abstractmethod
    def covariance(self) -> Array:
        """Of the parameters, in the units of the rows, shape (m, m)."""

    @property
    @abstractmethod
    def rows(self) -> Array:
        """What each candidate says of the parameters, in units of the noise, shape (C, k, m)."""

    @property
    @abstractmethod
    def slope(self) -> Array:
        """What has to be accurate at the workspace's poses, by the parameters, shape (W, c, m)."""

    @property
    @abstractmethod
    def remaining(self) -> Remaining:
        """Errors over the workspace."""

    @property
    @abstractmethod
    def stays(self) -> str:
        """What errs where the geometry is known exactly, in words that end a sentence."""

    @abstractmethod
    def move(self, covariance: Array) -> Array:
        """Return the draws (S, D) as they would be with another covariance of the parameters, (m, m)."""

    @abstractmethod
    def predict(self, reference: State) -> tuple[Array, Array]:
        """Return what this variant predicts at the candidates against another one, (C, d), and its covariance."""

    @abstractmethod
    def list_poses(self, chosen: np.ndarray) -> dict[str, Array]:
        """Return the columns of the table of poses to come, for some of the candidates."""

    @abstractmethod
    def describe_pose(self, candidate: int) -> str:
        """Return in a sentence how to go to a candidate."""

    @cached_property
    def calibrated(self) -> Array:
        """The machine as calibrated, the posterior mean, shape (D,)."""
        return np.asarray(self.theta.mean(axis=0))

    @cached_property
    def weight(self) -> Array:
        """W (m, m): tr(W C) is the mean square of the workspace's errors in units of the limits (I-optimality)."""
        shares = self.slope / find_limits(self.subject.requirements, self.slope)[:, None]
        return np.asarray(np.einsum("wci,wcj->ij", shares, shares, optimize=True) / len(shares))

    @cached_property
    def standing(self) -> Standing:
        """How the requirements stand."""
        return self._judge(self.theta)

    @cached_property
    def at_best(self) -> Standing:
        """How they would stand were the geometry known exactly."""
        return self._judge(np.broadcast_to(self.calibrated, self.theta.shape))

    def after(self, covariance: Array) -> Standing:
        """Return how they are expected to stand with another covariance of the parameters, (m, m)."""
        return self._judge(self.move(covariance))

    def _judge(self, theta: Array) -> Standing:
        return Standing(self.remaining.find_largest(self.subject.requirements, theta))


def find_state(subject: Subject, start: Array | None, n_draws: int, seed: int, *, anew: bool = True) -> State:
    """Return what is known after a variant's poses, updated from the mode before the last of them; see `update`."""
    return subject.know(update(subject.posterior, start, n_draws, seed, anew=anew), seed)
