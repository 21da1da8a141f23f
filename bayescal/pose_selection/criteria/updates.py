"""Scorers of criteria that follow from the inverse information: updates of rank k instead of new decompositions.

With P the inverse information of the set and G = B P Bᵀ of a pose with the rows B (k, L),

    log det(A ± BᵀB) = log det A + log det(1 ± G)                          (matrix determinant lemma)
    (A ± BᵀB)⁻¹ = P ∓ P Bᵀ (1 ± G)⁻¹ B P                                   (Woodbury)

G of all candidates is kept and follows each change of the set by its rank k too; it is computed again after
`REFRESH` changes, so that rounding cannot pile up. Arrays over all candidates have these in their last axis.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_triangular

from bayescal.numerics.geometry import Array
from bayescal.pose_selection.criteria.base import Criterion, Scorer, whiten

REFRESH = 20
LEAST = 1e-3
"""Of the eigenvalues of 1 - G: below, a pose tells something almost alone, and dropping it by update loses digits."""


class UpdateScorer(Scorer):
    """A set with its inverse information P = U Uᵀ, in whitened coordinates.

    Attributes
    ----------
    regular : bool
        Whether the set determines the parameters.
    root, inverse_root : ndarray, shape (L, L)
        R with A = RᵀR, and U = R⁻¹; the latter only where the set is regular.
    reference : ndarray, shape (L, L)
        Root of all candidates and the base together: takes whitened coordinates to the parameters' own.
    """

    def __init__(self, criterion: Criterion, blocks: Array, base: Array, n_base: int) -> None:
        super().__init__(criterion, blocks, base, n_base)
        self.reference, white = whiten(blocks, base)
        self._white_base = base @ np.linalg.inv(self.reference)
        self._columns = np.ascontiguousarray(white.transpose(1, 2, 0))  # (k, L, C); of many candidates held only so
        self._pending: list[tuple[float, Array]] = []
        self._since_refresh = REFRESH
        self._gram = np.empty(0)

    def start(self, members: Sequence[int]) -> None:
        """Begin with a set."""
        super().start(members)
        self._since_refresh = REFRESH
        self._find_inverse()

    def add(self, candidate: int) -> None:
        """Add a candidate to the set."""
        self._change(candidate, 1.0)
        super().add(candidate)
        self._find_inverse()

    def drop(self, candidate: int) -> None:
        """Remove a member from the set."""
        self._change(candidate, -1.0)
        super().drop(candidate)
        self._find_inverse()

    def values_added(self) -> Array:
        """Return the criterion of the set with each candidate added, shape (C,)."""
        if not self.regular:  # nothing to update: judge each set by itself
            sets = np.concatenate(
                [np.broadcast_to(self.stack(), (len(self.blocks), *self.stack().shape)), self.blocks], 1
            )
            return self.criterion.value(sets, self.n_poses + 1)
        gram = self._find_gram().copy()
        for i in range(len(gram)):
            gram[i, i] += 1.0
        return self._with_added(factor_last(gram))

    def values_dropped(self) -> Array:
        """Return the criterion of the set without each member, in the order of ``members``, shape (n,)."""
        if not self.regular:  # nor is any part of it
            return np.full(len(self.members), self._worthless)
        seen = self._whiten_some(self.members) @ self.inverse_root  # (n, k, L)
        values, vectors = np.linalg.eigh(np.eye(seen.shape[1]) - seen @ np.swapaxes(seen, -1, -2))
        alone = values[:, 0] < LEAST
        result = self._with_dropped(np.where(alone[:, None], 1.0, values), np.swapaxes(vectors, -1, -2) @ seen)
        for place in np.flatnonzero(alone):
            rows = self._stack_of(np.delete(self.members, place), self.blocks, self.base)
            result[place] = self.criterion.value(rows, self.n_poses - 1)
        return result

    @property
    def _worthless(self) -> float:
        return -np.inf

    @abstractmethod
    def _with_added(self, factor: Array) -> Array:
        """Return the criterion with each candidate, given the factors of 1 + G, shape (k, k, C)."""

    @abstractmethod
    def _with_dropped(self, values: Array, seen: Array) -> Array:
        """Return the criterion without each member, given eigenvalues of 1 - G (n, k) and vᵀ B U of each (n, k, L)."""

    def _whiten_some(self, candidates: Sequence[int]) -> Array:
        """Return the rows of some candidates in whitened coordinates, shape (n, k, L)."""
        return np.ascontiguousarray(self._columns[:, :, candidates].transpose(2, 0, 1))

    def _find_inverse(self) -> None:
        n = len(self.reference)
        rows = np.concatenate([self._white_base, self._whiten_some(self.members).reshape(-1, n)])
        self.root = np.linalg.qr(rows, mode="r")
        size = np.abs(np.diagonal(self.root))
        self.regular = len(self.root) == n and bool(size.min() > 1e-12 * size.max())
        if self.regular:
            self.inverse_root = solve_triangular(self.root, np.eye(n))
        else:
            self._since_refresh = REFRESH

    def _change(self, candidate: int, sign: float) -> None:
        """Note how the inverse will change: by -sign Z Zᵀ."""
        self._since_refresh += 1
        if not self.regular or self._since_refresh >= REFRESH:
            return
        half = self.inverse_root.T @ self._whiten_some([candidate])[0].T  # (L, k)
        small = np.eye(half.shape[1]) + sign * half.T @ half
        values, vectors = np.linalg.eigh(small)
        if values[0] < LEAST:
            self._since_refresh = REFRESH
            return
        self._pending.append((-sign, self.inverse_root @ half @ vectors / np.sqrt(values)))

    def _find_gram(self) -> Array:
        """Return G of all candidates, shape (k, k, C)."""
        if self._since_refresh >= REFRESH:
            self._gram = outer_last(self.inverse_root.T @ self._columns)
            self._since_refresh = 0
        elif self._pending:
            signs = np.concatenate([np.full(part.shape[1], sign) for sign, part in self._pending])
            seen = np.concatenate([part for _, part in self._pending], axis=1).T @ self._columns  # (k, changes, C)
            self._gram += outer_last(seen, signs)
        self._pending.clear()
        return self._gram


def outer_last(seen: Array, signs: Array | None = None) -> Array:
    """Return Σ_m s_m z_im z_jm of arrays (k, M, C), shape (k, k, C)."""
    k, _, count = seen.shape
    result = np.empty((k, k, count))
    signed = seen if signs is None else seen * signs[:, None]
    for i in range(k):
        for j in range(i + 1):
            np.einsum("mc,mc->c", signed[i], seen[j], out=result[i, j])
            result[j, i] = result[i, j]
    return result


def factor_last(matrix: Array) -> Array:
    """Return the lower Cholesky factors of matrices (k, k, C); what is above the diagonal is left undefined."""
    k = len(matrix)
    factor = np.empty_like(matrix)
    for j in range(k):
        for i in range(j, k):
            total = matrix[i, j].copy()
            for m in range(j):
                total -= factor[i, m] * factor[j, m]
            factor[i, j] = np.sqrt(total) if i == j else total / factor[j, j]
    return factor


def solve_last(factor: Array, right: Array) -> Array:
    """Return L⁻¹ X of factors (k, k, C) and X of shape (k, q, C), written over X."""
    for i in range(len(factor)):
        for m in range(i):
            right[i] -= factor[i, m] * right[m]
        right[i] /= factor[i, i]
    return right
