"""Criteria by the determinant of the information: O1, and Bayesian D-optimality."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayescal.numerics.geometry import Array
from bayescal.pose_selection.criteria.base import BayesianCriterion, Criterion, ObservabilityCriterion, Scorer
from bayescal.pose_selection.criteria.updates import UpdateScorer
from bayescal.pose_selection.observability import singular_values


class LogDet(Criterion):
    """A criterion that grows with log det of the information."""

    @abstractmethod
    def from_log_det(self, log_det: Array, n_poses: int, n_parameters: int) -> Array:
        """Return the criterion of log det of the information, shape (...)."""

    @abstractmethod
    def _slope(self, value: float, n_parameters: int) -> float:
        """Return the criterion's derivative by log det of the information."""

    def value(self, rows: Array, n_poses: int) -> Array:
        """Return the criterion of stacked rows (..., R, L), shape (...), by their singular values."""
        with np.errstate(divide="ignore"):
            log_det = 2.0 * np.log(singular_values(rows)).sum(axis=-1)
        return self.from_log_det(np.asarray(log_det), n_poses, rows.shape[-1])

    def gradient(self, rows: Array, n_poses: int) -> Array:
        """Return the derivative by the information, a multiple of its inverse, shape (L, L)."""
        root = np.linalg.inv(np.linalg.qr(rows, mode="r"))
        slope = self._slope(float(self.value(rows, n_poses)), rows.shape[-1])
        return np.asarray(slope * root @ root.T)

    def scorer(self, blocks: Array, base: Array, n_base: int) -> Scorer:
        """Return a scorer by the matrix determinant lemma."""
        return LogDetScorer(self, blocks, base, n_base)


class LogDetScorer(UpdateScorer):
    """Scores by log det(1 ± G)."""

    criterion: LogDet

    @property
    def _log_det(self) -> float:
        size = np.abs(np.diagonal(self.root)) * np.abs(np.diagonal(self.reference))
        return 2.0 * float(np.log(size).sum())

    @property
    def _worthless(self) -> float:
        return float(self._from(np.array(-np.inf), 1))

    def _from(self, log_det: Array, n_poses: int) -> Array:
        return self.criterion.from_log_det(log_det, n_poses, self.blocks.shape[-1])

    def value(self) -> float:
        """Return the criterion of the set."""
        return float(self._from(np.array(self._log_det), self.n_poses)) if self.regular else self._worthless

    def _with_added(self, factor: Array) -> Array:
        gain = 2.0 * np.log(np.prod([factor[i, i] for i in range(len(factor))], axis=0))
        return self._from(self._log_det + gain, self.n_poses + 1)

    def _with_dropped(self, values: Array, seen: Array) -> Array:
        return self._from(self._log_det + np.log(values).sum(axis=-1), self.n_poses - 1)


@dataclass(frozen=True)
class O1(ObservabilityCriterion, LogDet):
    """O1 = (σ_1 … σ_L)^(1/L) / √n."""

    name: ClassVar[str] = "O1"
    title: ClassVar[str] = "Geometric mean of singular values"
    source: ClassVar[str] = "Menq, Borm and Lai 1989"

    def from_log_det(self, log_det: Array, n_poses: int, n_parameters: int) -> Array:
        """Return O1."""
        return np.asarray(np.exp(log_det / (2 * n_parameters)) / np.sqrt(n_poses))

    def _slope(self, value: float, n_parameters: int) -> float:
        return value / (2 * n_parameters)


@dataclass(frozen=True, eq=False)
class DOptimality(BayesianCriterion, LogDet):
    """½ log det(1 + Λ): what the poses tell of the parameters, in nats, prior and noise counted."""

    name: ClassVar[str] = "D"
    title: ClassVar[str] = "Information gained, nats"
    source: ClassVar[str] = "Bayesian D-optimality (Lindley 1956)"

    def from_log_det(self, log_det: Array, n_poses: int, n_parameters: int) -> Array:
        """Return half of log det(1 + Λ)."""
        del n_poses, n_parameters
        return np.asarray(0.5 * log_det)

    def _slope(self, value: float, n_parameters: int) -> float:
        del value, n_parameters
        return 0.5
