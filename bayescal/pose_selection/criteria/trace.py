"""Criteria by the posterior covariance: Bayesian A-optimality of parameters, I-optimality of predicted poses."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from bayescal.errors import InputError
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.criteria.base import BayesianCriterion, Purpose, Scorer
from bayescal.pose_selection.criteria.updates import UpdateScorer, solve_last


@dataclass(frozen=True, eq=False)
class BayesianTrace(BayesianCriterion):
    """Minus a weighted trace of the posterior covariance, tr(Q (1 + Λ)⁻¹)."""

    @abstractmethod
    def weight_root(self, n_parameters: int) -> Array:
        """Return W with Q = WᵀW, shape (q, L), in units of the tolerances."""

    def value(self, rows: Array, n_poses: int) -> Array:
        """Return minus the trace for stacked rows (..., R, L), shape (...)."""
        del n_poses
        inverse = np.linalg.inv(np.linalg.qr(rows, mode="r"))
        return np.asarray(-np.sum((self.weight_root(rows.shape[-1]) @ inverse) ** 2, axis=(-2, -1)))

    def gradient(self, rows: Array, n_poses: int) -> Array:
        """Return the derivative by the information, P Q P with P its inverse, shape (L, L)."""
        del n_poses
        root = np.linalg.inv(np.linalg.qr(rows, mode="r"))
        half = self.weight_root(rows.shape[-1]) @ root @ root.T
        return half.T @ half

    def scorer(self, blocks: Array, base: Array, n_base: int) -> Scorer:
        """Return a scorer by Woodbury's formula."""
        return TraceScorer(self, blocks, base, n_base)


class TraceScorer(UpdateScorer):
    """Scores by tr(Q P) ∓ tr(Q P Bᵀ (1 ± G)⁻¹ B P)."""

    criterion: BayesianTrace

    def __init__(self, criterion: BayesianTrace, blocks: Array, base: Array, n_base: int) -> None:
        super().__init__(criterion, blocks, base, n_base)
        self._weights = criterion.weight_root(blocks.shape[-1]) @ np.linalg.inv(self.reference)

    def value(self) -> float:
        """Return the criterion of the set."""
        return -float(np.sum((self._weights @ self.inverse_root) ** 2))

    def _with_added(self, factor: Array) -> Array:
        half = self._weights @ self.inverse_root @ self.inverse_root.T
        seen = solve_last(factor, half @ self._columns)  # (k, q, C)
        return np.asarray(self.value() + np.einsum("kqc,kqc->c", seen, seen))

    def _with_dropped(self, values: Array, seen: Array) -> Array:
        moved = seen @ (self._weights @ self.inverse_root).T  # (n, k, q)
        return np.asarray(self.value() - np.sum(moved**2 / values[..., None], axis=(-2, -1)))


@dataclass(frozen=True, eq=False)
class AOptimality(BayesianTrace):
    """Minus the mean posterior variance of parameters, in shares of the prior's."""

    chosen: tuple[int, ...] = ()  # which free parameters count; all where it is empty

    name: ClassVar[str] = "A"
    title: ClassVar[str] = "Mean posterior variance / prior variance, negative"
    source: ClassVar[str] = "Bayesian A-optimality (Chaloner 1984)"

    def weight_root(self, n_parameters: int) -> Array:
        """Return the rows of the identity that count, over the root of their number."""
        if any(not 0 <= k < n_parameters for k in self.chosen):
            raise InputError(f"criterion A: found parameters {self.chosen}, expected 0 to {n_parameters - 1}")
        picked = list(self.chosen) or list(range(n_parameters))
        return np.eye(n_parameters)[picked] / np.sqrt(len(picked))


@dataclass(frozen=True, eq=False)
class IOptimality(BayesianTrace):
    """Minus the mean over the workspace of the predicted pose's weighted variance that the parameters cause."""

    workspace: Array  # (W, 6, L): pose by parameters at W poses that stand for the workspace, mm and rad by tolerances
    # (6,): what errors of the pose's components are measured by, mm and rad; infinite where one does not matter
    limits: Array

    name: ClassVar[str] = "I"
    title: ClassVar[str] = "Mean pose variance / limits, negative"
    source: ClassVar[str] = "Box and Draper 1959; Chaloner 1984 (prior)"

    @classmethod
    def from_config(cls, config: Any, purpose: Purpose) -> Self:
        """Return the criterion of the purpose's workspace and limits."""
        del config
        return cls(purpose.workspace.located.tool, purpose.limits)

    def __post_init__(self) -> None:
        """Check the limits."""
        if self.limits.shape != (6,) or not np.all(self.limits > 0.0) or not np.any(np.isfinite(self.limits)):
            listed = ", ".join(f"{x:g}" for x in self.limits.ravel())
            raise InputError(f"criterion I: found limits {listed}, expected six > 0, one finite")

    @cached_property
    def _root(self) -> Array:
        slope = self.workspace / self.limits[:, None]
        return np.linalg.qr(slope.reshape(-1, slope.shape[-1]) / np.sqrt(len(slope)), mode="r")

    def weight_root(self, n_parameters: int) -> Array:
        """Return the root of the mean of S_wᵀ diag(limits)⁻² S_w, S_w the slopes at the workspace's poses."""
        del n_parameters
        return self._root
