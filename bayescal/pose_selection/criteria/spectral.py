"""Criteria by single singular values, O2 to O5: no formula updates them, bounds spare most decompositions.

Let A be the information of the set, V its eigenvectors and M = A ± BᵀB that with a pose more or less. By Cauchy's
interlacing, compressing M to some columns of V gives eigenvalues that are not below M's least, and not above M's
largest. By convexity of x^(-1/2), replacing Vᵀ M V by diagonal blocks of it cannot raise tr M^(-1/2) (Peierls).
So cheap compressions bound every index from above. Candidates are judged exactly, by the singular values of the set's
root with the candidate's rows below it, in the order of their bounds, until the best found exceeds every bound left:
what is found is exactly what judging all of them would find.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayescal.numerics.geometry import Array
from bayescal.pose_selection.criteria.base import ObservabilityCriterion, Scorer, check_rank
from bayescal.pose_selection.observability import compute_index, singular_values

ROUGH, FINE = 8, 20
"""Columns of V that belong to the least eigenvalues and are compressed to as one block."""
FIRST = 16
CHUNK = 32
MIN_DETERMINANT = 1e-300
SLACK = 1e-6
"""On bounds, of their size: the eigenvalues behind them are rounded, by condition times 1e-16."""


class Spectral(ObservabilityCriterion):
    """An index that single singular values of J_B determine."""

    def value(self, rows: Array, n_poses: int) -> Array:
        """Return the index of stacked rows (..., R, L), shape (...)."""
        return compute_index(self.name, singular_values(rows), n_poses)

    def gradient(self, rows: Array, n_poses: int) -> Array:
        """Return the derivative by the information, shape (L, L), where the singular values are distinct."""
        _, values, right = np.linalg.svd(rows, full_matrices=False)
        slopes = self._slopes(values) / (2.0 * values)  # by the eigenvalues σ²
        return np.asarray(right.T * slopes @ right)

    def scorer(self, blocks: Array, base: Array, n_base: int) -> Scorer:
        """Return a scorer that judges by bounds."""
        return SpectralScorer(self, blocks, base, n_base)

    @abstractmethod
    def _slopes(self, values: Array) -> Array:
        """Return the derivatives by the singular values (L,), largest first."""

    @abstractmethod
    def bound(self, low: Array, middle: Array, top: Array) -> Array:
        """Return upper bounds of the index from eigenvalues of compressions.

        Parameters
        ----------
        low : ndarray, shape (C, m)
            Of the compression to the lowest columns, ascending.
        middle : ndarray, shape (C, L - m)
            Diagonal of the compression to the others.
        top : ndarray, shape (C,)
            The largest of ``middle``.
        """


class SpectralScorer(Scorer):
    """A set with the root of its information."""

    criterion: Spectral

    def __init__(self, criterion: Spectral, blocks: Array, base: Array, n_base: int) -> None:
        super().__init__(criterion, blocks, base, n_base)
        check_rank(np.linalg.qr(np.concatenate([base, blocks.reshape(-1, blocks.shape[-1])]), mode="r"))

    def values_added(self) -> Array:
        """Return the index of the set with each candidate added, shape (C,), all decomposed."""
        return self._judge_added(np.arange(len(self.blocks)))

    def values_dropped(self) -> Array:
        """Return the index of the set without each member, in the order of ``members``, shape (n,)."""
        return self._judge_dropped(np.arange(len(self.members)))

    def best_added(self, allowed: np.ndarray) -> tuple[int, float]:
        """Return the best candidate to add of those allowed (C,) and the index with it."""
        places = np.flatnonzero(allowed)
        return self._find_best(places, places, 1.0, self._judge_added)

    def best_dropped(self) -> tuple[int, float]:
        """Return the member without which the set is best, and the index without it."""
        places = np.arange(len(self.members))
        place, value = self._find_best(places, np.array(self.members), -1.0, self._judge_dropped)
        return self.members[place], value

    def _judge_added(self, places: np.ndarray) -> Array:
        rows = self.stack()
        root = np.linalg.qr(rows, mode="r") if len(rows) > rows.shape[1] else rows
        roots = np.broadcast_to(root, (len(places), *root.shape))
        return self.criterion.value(np.concatenate([roots, self.blocks[places]], axis=1), self.n_poses + 1)

    def _judge_dropped(self, places: np.ndarray) -> Array:
        left = np.array([np.delete(self.members, place) for place in places])
        rows = self.blocks[left].reshape(len(places), -1, self.blocks.shape[-1])
        base = np.broadcast_to(self.base, (len(places), *self.base.shape))
        return self.criterion.value(np.concatenate([base, rows], axis=1), self.n_poses - 1)

    def _find_best(
        self, places: np.ndarray, candidates: np.ndarray, sign: float, judge: Callable[[np.ndarray], Array]
    ) -> tuple[int, float]:
        """Return the best place and its index, the first of equal ones: rough bounds, then fine ones, then exactly."""
        eigenvalues, vectors = self._decompose()
        bounds = self._bounds(eigenvalues, vectors, candidates, sign, ROUGH)
        first = np.argsort(-bounds, kind="stable")[:FIRST]
        best_place, best = self._best_of(places[first], judge, -1, -np.inf)
        left = np.setdiff1d(np.flatnonzero(bounds >= best), first)
        bounds = self._bounds(eigenvalues, vectors, candidates[left], sign, FINE)
        order = np.argsort(-bounds, kind="stable")
        for start in range(0, len(order), CHUNK):
            chunk = order[start : start + CHUNK]
            chunk = chunk[bounds[chunk] >= best]
            if not len(chunk):
                break
            best_place, best = self._best_of(places[left[chunk]], judge, best_place, best)
        return best_place, best

    def _best_of(
        self, places: np.ndarray, judge: Callable[[np.ndarray], Array], best_place: int, best: float
    ) -> tuple[int, float]:
        """Return the best of some places and of the best so far."""
        self.n_evaluations += len(places)
        for place, value in zip(places, judge(places), strict=True):
            if value > best or (value == best and place < best_place):
                best_place, best = int(place), float(value)
        return best_place, best

    def _decompose(self) -> tuple[Array, Array]:
        """Return eigenvalues (L,) and eigenvectors (L, L) of the set's information, the least first."""
        _, values, right = np.linalg.svd(self.stack(), full_matrices=True)
        eigenvalues = np.zeros(len(right))
        eigenvalues[: len(values)] = values**2
        return eigenvalues[::-1], np.ascontiguousarray(right[::-1].T)

    def _bounds(self, eigenvalues: Array, vectors: Array, candidates: np.ndarray, sign: float, low: int) -> Array:
        """Return upper bounds of the index with each candidate added or dropped, from ``low`` columns as one block."""
        m, n = min(low, len(eigenvalues)), len(eigenvalues)
        seen = (self.blocks[candidates].reshape(-1, n) @ vectors).reshape(len(candidates), self.blocks.shape[1], n)
        block = sign * np.swapaxes(seen[..., :m], -1, -2) @ seen[..., :m]
        block[:, np.arange(m), np.arange(m)] += eigenvalues[:m]
        middle = eigenvalues[m:] + sign * np.einsum("ckl,ckl->cl", seen[..., m:], seen[..., m:])
        lowest = np.maximum(np.linalg.eigvalsh(block), 0.0)
        top = np.maximum(lowest[:, -1], middle.max(axis=1, initial=0.0))
        bound = self.criterion.bound(lowest, np.maximum(middle, MIN_DETERMINANT), np.maximum(top, MIN_DETERMINANT))
        return bound * (1.0 + SLACK) + SLACK * bound.max(initial=0.0)


@dataclass(frozen=True)
class O2(Spectral):
    """O2 = σ_L / σ_1."""

    name: ClassVar[str] = "O2"
    title: ClassVar[str] = "Inverse condition number"
    source: ClassVar[str] = "Driels and Pathre 1990"

    def _slopes(self, values: Array) -> Array:
        result = np.zeros_like(values)
        result[0] -= values[-1] / values[0] ** 2
        result[-1] += 1.0 / values[0]
        return result

    def bound(self, low: Array, middle: Array, top: Array) -> Array:
        """Return a bound by the least and the largest eigenvalue."""
        del middle
        return np.asarray(np.sqrt(low[:, 0] / top))


@dataclass(frozen=True)
class O3(Spectral):
    """O3 = σ_L."""

    name: ClassVar[str] = "O3"
    title: ClassVar[str] = "Least singular value"
    source: ClassVar[str] = "Nahvi, Hollerbach and Hayward 1994"

    def _slopes(self, values: Array) -> Array:
        result = np.zeros_like(values)
        result[-1] = 1.0
        return result

    def bound(self, low: Array, middle: Array, top: Array) -> Array:
        """Return a bound by the least eigenvalue."""
        del middle, top
        return np.asarray(np.sqrt(low[:, 0]))


@dataclass(frozen=True)
class O4(Spectral):
    """O4 = σ_L² / σ_1."""

    name: ClassVar[str] = "O4"
    title: ClassVar[str] = "Noise amplification index"
    source: ClassVar[str] = "Nahvi and Hollerbach 1996"

    def _slopes(self, values: Array) -> Array:
        result = np.zeros_like(values)
        result[0] -= values[-1] ** 2 / values[0] ** 2
        result[-1] += 2.0 * values[-1] / values[0]
        return result

    def bound(self, low: Array, middle: Array, top: Array) -> Array:
        """Return a bound by the least and the largest eigenvalue."""
        del middle
        return np.asarray(low[:, 0] / np.sqrt(top))


@dataclass(frozen=True)
class O5(Spectral):
    """O5 = 1 / Σ 1/σ_i."""

    name: ClassVar[str] = "O5"
    title: ClassVar[str] = "Harmonic mean of singular values / number"
    source: ClassVar[str] = "Sun and Hollerbach 2008"

    def _slopes(self, values: Array) -> Array:
        return np.asarray(values**-2 / np.sum(1.0 / values) ** 2)

    def bound(self, low: Array, middle: Array, top: Array) -> Array:
        """Return a bound by all eigenvalues of the compressions."""
        del top
        with np.errstate(divide="ignore"):
            total = np.sum(low**-0.5, axis=1) + np.sum(middle**-0.5, axis=1)
        return np.asarray(1.0 / total)
