"""Normal rows whose covariance is a sum of known matrices, each times a variance that is not known.

Rows e of P poses, n of each, white but for what is unknown, have the covariance (variance components: Patterson and
Thompson 1971)

    S = K + Σ_g v_g B_g + Σ_t v_t E_t

with K and B_g block diagonal, a block a pose, and E_t (P n, P n) whole: errors that are functions of the pose or of
time. Its Cholesky factor is the density's cost. Given the variances, geometry about which rows are linear is normal in
closed form (`LinearGeometry`), and so is the density of the variances alone.

With many poses E_t = Φ_t Φ_tᵀ + l_t F Fᵀ, functions that rows see by F being made of few columns each, and what these
leave out, l_t, being independent from pose to pose (`bayescal.density.sorts`). With D = K + Σ v_g B_g + Σ v_t l_t F Fᵀ,
s the root of each column's variance and A = 1 + s ΦᵀD⁻¹Φ s (Woodbury's identity and the determinant's lemma)

    S⁻¹ = D⁻¹ - D⁻¹Φ s A⁻¹ s ΦᵀD⁻¹,    log |S| = log |D| + log |A|,

whose cost is linear in the poses but for the Gram matrix ΦᵀD⁻¹Φ. Where Σ B_g = F Fᵀ and all v_g are equal, so that
D = K + v F Fᵀ, rows of each pose are turned once so that D is diagonal with entries 1 + v λ. Then (1 + v Λ) ΦᵀD⁻¹Φ, Λ
the largest λ, is a smooth function of x = log(1 + v Λ), all of whose singularities are at a distance of π from the real
line or farther: it is interpolated, entry by entry, by polynomials between Chebyshev nodes, without loss of digits that
matter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.linalg import cho_solve, cholesky, solve_triangular

from bayescal.numerics.geometry import Array

AT_ONCE: Final = 300_000  # numbers of the covariances that are factorised together: they stay in the cache


MOST_ROWS: Final = 900
"""Rows of all poses together up to which S is factorised as a whole; with more functions are made of few columns."""


class Factorised(Protocol):
    """S of one vector of variances, factorised."""

    def rows(self, seen: Array) -> Array:
        """Return white rows of (M, ...)."""

    def square(self, seen: Array) -> Array:
        """Return XᵀS⁻¹X of X (M, m), shape (m, m)."""

    def solve(self, seen: Array) -> Array:
        """Return S⁻¹ times (M, ...)."""

    @property
    def half_log_det(self) -> float:
        """½ log |S|."""


@dataclass(frozen=True, eq=False)
class White:
    """`Factorised` as a whole."""

    factor: Array  # (M, M): lower Cholesky factor, M = P n

    def rows(self, seen: Array) -> Array:
        """Return white rows of (M, ...)."""
        return np.asarray(solve_triangular(self.factor, seen, lower=True, check_finite=False))

    def square(self, seen: Array) -> Array:
        """Return XᵀS⁻¹X of X (M, m), shape (m, m)."""
        white = self.rows(seen)
        return np.asarray(white.T @ white)

    def solve(self, seen: Array) -> Array:
        """Return S⁻¹ times (M, ...)."""
        return np.asarray(cho_solve((self.factor, True), seen, check_finite=False))

    @property
    def half_log_det(self) -> float:
        """½ log |S|."""
        return float(np.log(np.diag(self.factor)).sum())


@dataclass(frozen=True, eq=False)
class Components:
    """Covariances of P poses with n rows each.

    Attributes
    ----------
    known : ndarray, shape (P, n, n)
        K.
    blocks : ndarray, shape (G, P, n, n)
        B_g.
    parts : ndarray, shape (C, M, M)
        E_t, with M = P n.
    """

    known: Array
    blocks: Array
    parts: Array

    @property
    def size(self) -> int:
        """Number M of rows."""
        return self.known.shape[0] * self.known.shape[1]

    def covariances(self, variances: Array, more: int = 0) -> Array:
        """Return S of variances (B, G + C), shape (B, M + more, M + more), with room for more rows."""
        g = len(self.blocks)
        own = self.known + (variances[:, :g] @ self.blocks.reshape(g, -1)).reshape(-1, *self.known.shape)
        return assemble(own, self.parts, variances[:, g:], more)

    def factorise(self, variances: Array) -> White:
        """Return S of variances (G + C,)."""
        return White(cholesky(self.covariances(variances[None])[0], lower=True, check_finite=False))

    def weigh(self, variances: Array, rows: Array) -> Array:
        """Return normal log-densities of rows (B, M) but for 2 π, shape (B,), for variances (B, G + C)."""
        found = np.empty(len(rows))
        for part in batches(len(rows), self.size):
            found[part] = weigh(self.covariances(variances[part], 1), rows[part])
        return found

    def weigh_each(self, variances: Array, rows: Array) -> tuple[Array, Array]:
        """Return log p(e_n | all other rows) but for 2 π of each pose and its squared deviation, shapes (B, P)."""
        return weigh_left_out(*self.leave_out(variances, rows))

    def leave_out(self, variances: Array, rows: Array) -> tuple[Array, Array]:
        """Return by how much each pose's rows deviate from what all others predict, (B, P, n), and their precision."""
        return leave_out(self.covariances(variances), rows, len(self.known))

    def act(self, alpha: Array) -> Array:
        """Return B_g α and E_t α, (M,) to (G + C, M)."""
        own = np.einsum("gpij,pj->gpi", self.blocks, alpha.reshape(self.known.shape[:2]))
        return np.concatenate([own.reshape(len(own), -1), self.parts @ alpha])

    def traces(self, variances: Array) -> tuple[Array, Array]:
        """Return tr S⁻¹ E_k of all K = G + C parts, B_g and E_t, and tr S⁻¹ E_k S⁻¹ E_l, shapes (K,) and (K, K)."""
        inverse, shape = self.factorise(variances).solve(np.eye(self.size)), self.known.shape[:2]
        own = np.einsum("mpi,gpij->gmpj", inverse.reshape(-1, *shape), self.blocks, optimize=True)
        both = np.concatenate([own.reshape(len(own), *inverse.shape), inverse @ self.parts])
        return np.einsum("kii->k", both), np.einsum("kij,lji->kl", both, both, optimize=True)


def batches(size: int, n_rows: int) -> list[slice]:
    """Return which of so many covariances of M rows are taken together."""
    most = max(1, AT_ONCE // n_rows**2)
    return [slice(k, k + most) for k in range(0, size, most)]


def assemble(own: Array, parts: Array, weights: Array, more: int = 0) -> Array:
    """Return block diagonal matrices plus weighted parts, with room for more rows.

    Parameters
    ----------
    own : ndarray, shape (B, P, n, n)
    parts : ndarray, shape (C, M, M)
        M = P n.
    weights : ndarray, shape (B, C)
    more : int

    Returns
    -------
    ndarray, shape (B, M + more, M + more)
    """
    n_poses, n, m = own.shape[1], own.shape[2], parts.shape[-1]
    total = np.zeros((len(weights), m + more, m + more))
    inner = total[:, :m, :m]
    inner[:] = (weights @ parts.reshape(-1, m * m)).reshape(-1, m, m)
    for p in range(n_poses):
        inner[:, p * n : (p + 1) * n, p * n : (p + 1) * n] += own[:, p]
    return total


CORNER: Final = 1e200  # larger than any square of white rows; what comes before it in a factor does not depend on it


def carry(covariance: Array, rows: Array) -> tuple[Array, Array]:
    """Return ½ log |S| and eᵀS⁻¹e of rows e (B, M), shapes (B,); covariances (B, M + 1, M + 1) are used up.

    The rows are carried along as one more row of the matrix; in the factor it holds the white ones.
    """
    m = rows.shape[1]
    covariance[:, m, :m], covariance[:, :m, m], covariance[:, m, m] = rows, rows, CORNER
    factor = np.linalg.cholesky(covariance)
    white = factor[:, m, :m]
    half_log_det = np.log(np.diagonal(factor, axis1=1, axis2=2)[:, :m]).sum(axis=1)
    return half_log_det, np.einsum("bm,bm->b", white, white)


def weigh(covariance: Array, rows: Array) -> Array:
    """Return normal log-densities of rows (B, M) but for 2 π, shape (B,); covariances (B, M + 1, M + 1) are used up."""
    half_log_det, square = carry(covariance, rows)
    return np.asarray(-half_log_det - 0.5 * square)


def leave_out(covariance: Array, rows: Array, n_poses: int) -> tuple[Array, Array]:
    """Return by how much each pose's rows deviate from what all others predict, and their precision then.

    With A = S⁻¹ and α = A e the density of e_n given the others is normal with precision A_nn, shape (B, P, n, n), and
    its deviation from its mean is A_nn⁻¹ α_n, shape (B, P, n).
    """
    shape = n_poses, rows.shape[1] // n_poses
    inverse = np.linalg.inv(covariance)
    alpha = (inverse @ rows[..., None]).reshape(-1, *shape)
    precision = np.einsum("bpipj->bpij", inverse.reshape(-1, *shape, *shape))
    return np.linalg.solve(precision, alpha[..., None])[..., 0], precision


def weigh_left_out(deviation: Array, precision: Array) -> tuple[Array, Array]:
    """Return log-densities but for 2 π of what `leave_out` finds of each pose, and squared deviations, (B, P)."""
    square = np.einsum("bpi,bpij,bpj->bp", deviation, precision, deviation)
    return 0.5 * np.linalg.slogdet(precision)[1] - 0.5 * square, square


# --- few columns -----------------------------------------------------------------------------------------------------

WIDTH: Final = 4.0  # of x, over which one polynomial interpolates
NODES: Final = 24  # which leave 1e-12 of the Gram matrix there
GRAMS: Final = 3_000_000  # numbers of Gram matrices that are factorised together


def list_gram_arrays(n_rows: int, n_columns: int) -> list[tuple[float, ...]]:
    """Return what is held of M rows and R columns beside these: how many arrays alike, then their shape."""
    return [(3.0 * NODES, n_columns, n_columns), (3.0, GRAMS), (3.0, GRAMS / n_columns**2, n_rows)]


@dataclass(frozen=True, eq=False)
class Thin:
    """`Factorised` by few columns beside a block diagonal.

    Attributes
    ----------
    turn : ndarray, shape (P, n, n)
        What makes rows white but for the functions.
    seen : ndarray, shape (P, n, N)
        What such rows see of N functions.
    basis : ndarray, shape (N, P, A)
        What each function is made of.
    scale : ndarray, shape (R,)
        s, with R = N A.
    gram : ndarray, shape (R, R)
        ΦᵀD⁻¹Φ.
    half_log_det_of_noise : float
        ½ log |D|.
    """

    turn: Array
    seen: Array
    basis: Array
    scale: Array
    gram: Array
    half_log_det_of_noise: float

    @cached_property
    def _inner(self) -> Array:
        return self.scale[:, None] * self.gram * self.scale

    @cached_property
    def _factor(self) -> Array:
        return np.asarray(cholesky(np.eye(len(self.scale)) + self._inner, lower=True, check_finite=False))

    @cached_property
    def root(self) -> Array:
        """U (R, R) with U Uᵀ the covariance of the coefficients given rows."""
        both = solve_triangular(self._factor, np.diag(self.scale), lower=True, check_finite=False)
        return np.ascontiguousarray(both.T)

    @property
    def half_log_det(self) -> float:
        """½ log |S|."""
        return self.half_log_det_of_noise + float(np.log(np.diag(self._factor)).sum())

    def _whiten(self, seen: Array) -> Array:
        return np.asarray(self.turn @ seen.reshape(*self.turn.shape[:2], -1))

    def project(self, white: Array) -> Array:
        """Return ΦᵀD⁻¹ times rows that are white but for the functions, (P, n, m) to (R, m)."""
        return project(self.seen, self.basis, white)

    def _spread(self, coefficients: Array) -> Array:
        values = self.basis @ coefficients.reshape(len(self.basis), self.basis.shape[-1], -1)
        return np.asarray(self.seen @ values.transpose(1, 0, 2))

    def expect(self, seen: Array) -> Array:
        """Return the mean of the coefficients given rows (M, m), shape (R, m)."""
        return self._expect(self._whiten(seen))

    def _expect(self, white: Array) -> Array:
        told = self.scale[:, None] * self.project(white)
        return self.scale[:, None] * np.asarray(cho_solve((self._factor, True), told, check_finite=False))

    @cached_property
    def _shrink(self) -> Array:
        """What a symmetric root takes from white rows, (R, R): with values μ of s G s 1 / (r (r + 1)), r² = 1 + μ."""
        values, vectors = np.linalg.eigh(self._inner)
        size = np.sqrt(1.0 + np.maximum(values, 0.0))
        spread = self.scale[:, None] * vectors
        return (spread / (size * (size + 1.0))) @ spread.T

    def rows(self, seen: Array) -> Array:
        """Return white rows of (M, ...), by a symmetric root of S⁻¹ between those that are white but for functions."""
        white = self._whiten(seen)
        return np.asarray((white - self._spread(self._shrink @ self.project(white))).reshape(seen.shape))

    def square(self, seen: Array) -> Array:
        """Return XᵀS⁻¹X of X (M, m), shape (m, m)."""
        white = self._whiten(seen)
        flat = white.reshape(-1, white.shape[-1])
        told = solve_triangular(self._factor, self.scale[:, None] * self.project(white), lower=True, check_finite=False)
        return np.asarray(flat.T @ flat - told.T @ told)

    def solve(self, seen: Array) -> Array:
        """Return S⁻¹ times (M, ...)."""
        white = self._whiten(seen)
        left = white - self._spread(self._expect(white))
        return np.asarray((np.swapaxes(self.turn, -1, -2) @ left).reshape(seen.shape))

    def precision(self) -> Array:
        """Return the blocks of S⁻¹, shape (P, n, n)."""
        inner = spread_at_poses(self.basis, self.root @ self.root.T)
        left = np.eye(self.turn.shape[1]) - self.seen @ inner @ np.swapaxes(self.seen, -1, -2)
        return np.asarray(np.swapaxes(self.turn, -1, -2) @ left @ self.turn)


def project(seen: Array, basis: Array, white: Array) -> Array:
    """Return Φᵀ times rows (P, n, m), with Φ what rows see, (P, n, N), of functions made of bases (N, P, A): (R, m)."""
    by_function = (np.swapaxes(seen, -1, -2) @ white).transpose(1, 0, 2)
    return np.asarray(np.swapaxes(basis, -1, -2) @ by_function).reshape(-1, white.shape[-1])


def find_gram(basis: Array, weights: Array) -> Array:
    """Return Σ_p w_pij φ_ipa φ_jpb of bases (N, P, A) with symmetric weights (P, N, N), shape (N A, N A)."""
    n, _, a = basis.shape
    found = np.empty((n, a, n, a))
    for i in range(n):
        for j in range(i + 1):
            found[i, :, j] = (basis[i] * weights[:, i, j, None]).T @ basis[j]
            found[j, :, i] = found[i, :, j].T
    return found.reshape(n * a, n * a)


def spread_at_poses(basis: Array, covariance: Array) -> Array:
    """Return the covariance of N functions at each pose, (P, N, N), from that of coefficients (N A, N A)."""
    n, n_poses, a = basis.shape
    blocks, found = covariance.reshape(n, a, n, a), np.empty((n_poses, n, n))
    for i in range(n):
        for j in range(i + 1):
            found[:, i, j] = np.einsum("pb,pb->p", basis[i] @ blocks[i, :, j], basis[j])
            found[:, j, i] = found[:, i, j]
    return found


@dataclass(frozen=True, eq=False)
class LowRankComponents:
    """`Components` whose E_t are of few columns: rows see N functions of the pose, each made of a basis.

    Attributes
    ----------
    known : ndarray, shape (P, n, n)
        K.
    blocks : ndarray, shape (G, P, n, n)
        B_g.
    shown : ndarray, shape (P, n, N)
        What rows see of each function.
    basis : ndarray, shape (N, P, A)
        What each function is made of at the poses.
    sorts : ndarray of int, shape (A,)
        Which of the C variances each entry of the basis has.
    left : ndarray, shape (C,)
        l.
    """

    known: Array
    blocks: Array
    shown: Array
    basis: Array
    sorts: np.ndarray
    left: Array

    @property
    def size(self) -> int:
        """Number M of rows."""
        return self.known.shape[0] * self.known.shape[1]

    @property
    def n_columns(self) -> int:
        """Number R of columns."""
        return self.basis.shape[0] * self.basis.shape[2]

    def _scales(self, variances: Array) -> Array:
        """Return s of variances (..., C), shape (..., R)."""
        return np.tile(np.sqrt(variances)[..., self.sorts], len(self.basis))

    # --- noise -------------------------------------------------------------------------------------------------------

    @cached_property
    def _every(self) -> Array:
        """F Fᵀ, shape (P, n, n)."""
        return np.asarray(self.shown @ np.swapaxes(self.shown, -1, -2))

    @cached_property
    def _adds_up(self) -> bool:
        """Whether Σ B_g is F Fᵀ."""
        return bool(np.allclose(self.blocks.sum(axis=0), self._every, rtol=1e-9, atol=0.0)) or not len(self.blocks)

    def _find_equal(self, variances: Array) -> Array:
        """Return v of variances (B, G + C), shape (B,); NaN where D is not K + v F Fᵀ."""
        own, weights = np.split(variances, [len(self.blocks)], axis=1)
        first = own[:, :1].sum(axis=1)
        equal = self._adds_up & (own == first[:, None]).all(axis=1)
        return np.where(equal, first + weights @ self.left, np.nan)

    @cached_property
    def _turned(self) -> tuple[Array, Array, Array]:
        """What makes K + v F Fᵀ diagonal, (P, n, n), λ (P, n), and what turned rows see of functions (P, n, N)."""
        inverse = np.linalg.inv(np.linalg.cholesky(self.known))
        values, vectors = np.linalg.eigh(inverse @ self._every @ np.swapaxes(inverse, -1, -2))
        turn = np.swapaxes(vectors, -1, -2) @ inverse
        return turn, np.maximum(values, 0.0), turn @ self.shown

    @cached_property
    def _half_log_det_of_known(self) -> float:
        return 0.5 * float(np.linalg.slogdet(self.known)[1].sum())

    @cached_property
    def _polynomials(self) -> dict[int, Array]:
        return {}

    def _interpolate(self, v: Array) -> Array:
        """Return ΦᵀD⁻¹Φ, (B, R, R), of v (B,)."""
        x, n = np.log1p(v * self._largest), self.n_columns
        number, found = (x / WIDTH).astype(int), np.empty((len(v), n, n))
        for k in np.unique(number):
            some = number == k
            place = chebvander(2.0 * (x[some] / WIDTH - k) - 1.0, NODES - 1)
            found[some] = (place @ self._find_polynomial(int(k))).reshape(-1, n, n)
        return np.asarray(np.exp(-x)[:, None, None] * found)

    @property
    def _largest(self) -> float:
        """Λ."""
        return float(self._turned[1].max())

    def _find_polynomial(self, number: int) -> Array:
        """Return coefficients of Chebyshev polynomials of (1 + v Λ) ΦᵀD⁻¹Φ, (NODES, R²), over a range of x."""
        if number not in self._polynomials:
            _, values, seen = self._turned
            place = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
            found = np.empty((NODES, self.n_columns**2))
            for k, x in enumerate(WIDTH * (number + 0.5 * (place + 1.0))):
                weight = 1.0 if self._largest == 0.0 else 1.0 / (1.0 + np.expm1(x) / self._largest * values)
                weighed = np.exp(x) * np.broadcast_to(weight, values.shape)[..., None] * seen
                found[k] = find_gram(self.basis, np.swapaxes(seen, -1, -2) @ weighed).ravel()
            change = 2.0 / NODES * chebvander(place, NODES - 1).T
            change[0] *= 0.5
            self._polynomials[number] = change @ found
        return self._polynomials[number]

    # --- density -----------------------------------------------------------------------------------------------------

    def factorise(self, variances: Array) -> Thin:
        """Return S of variances (G + C,)."""
        own, weights = np.split(variances, [len(self.blocks)])
        v = float(self._find_equal(variances[None])[0])
        if np.isnan(v):
            return self.factorise_beside(self.known + np.tensordot(own, self.blocks, 1), weights)
        turn, values, seen = self._turned
        size = 1.0 / np.sqrt(1.0 + v * values)[..., None]
        return Thin(
            size * turn,
            size * seen,
            self.basis,
            self._scales(weights),
            self._interpolate(np.array([v]))[0],
            self._half_log_det_of_known + 0.5 * float(np.log1p(v * values).sum()),
        )

    def factorise_beside(self, noise: Array, weights: Array) -> Thin:
        """Return S where K + Σ v_g B_g is as given, (P, n, n), for the functions' variances (C,)."""
        factor = np.linalg.cholesky(noise + float(weights @ self.left) * self._every)
        turn = np.linalg.inv(factor)
        seen = turn @ self.shown
        gram = find_gram(self.basis, np.swapaxes(seen, -1, -2) @ seen)
        half_log_det = float(np.log(np.diagonal(factor, axis1=1, axis2=2)).sum())
        return Thin(turn, seen, self.basis, self._scales(weights), gram, half_log_det)

    def weigh(self, variances: Array, rows: Array) -> Array:
        """Return normal log-densities of rows (B, M) but for 2 π, shape (B,), for variances (B, G + C)."""
        found, v = np.empty(len(rows)), self._find_equal(variances)
        for k in np.flatnonzero(np.isnan(v)):
            found[k] = weigh_by(self.factorise(variances[k]), rows[k])
        index, most = np.flatnonzero(~np.isnan(v)), max(1, GRAMS // self.n_columns**2)
        for some in (index[k : k + most] for k in range(0, len(index), most)):
            scale = self._scales(variances[some, len(self.blocks) :])
            found[some] = self._weigh_turned(v[some], scale, rows[some])
        return found

    def _weigh_turned(self, v: Array, scale: Array, rows: Array) -> Array:
        """Return log-densities of rows (B, M) where D is K + v F Fᵀ, for v (B,) and s (B, R)."""
        turn, values, seen = self._turned
        turned = turn @ rows.T.reshape(*turn.shape[:2], -1)
        ratio = 1.0 + v * values[..., None]
        weighed = turned / ratio
        n = self.n_columns
        inner = np.zeros((len(v), n + 1, n + 1))
        inner[:, :n, :n] = scale[:, :, None] * self._interpolate(v) * scale[:, None]
        np.einsum("bii->bi", inner)[:] += 1.0
        half_log_det, told = carry(inner, scale * project(seen, self.basis, weighed).T)
        square = np.einsum("pib,pib->b", turned, weighed) - told
        half_log_det += self._half_log_det_of_known + 0.5 * np.log(ratio).sum(axis=(0, 1))
        return np.asarray(-half_log_det - 0.5 * square)

    def weigh_given(self, root: Array, row: Array) -> float:
        """Return the log-density of rows (M,) but for 2 π, for coefficients of covariance U Uᵀ, U (R, R), D being K."""
        white = self.factorise_beside(self.known, np.zeros(len(self.left)))
        turned = white.turn @ row.reshape(*self.known.shape[:2], 1)
        factor = cholesky(np.eye(len(root)) + root.T @ white.gram @ root, lower=True, check_finite=False)
        told = solve_triangular(factor, root.T @ white.project(turned)[:, 0], lower=True, check_finite=False)
        half_log_det = white.half_log_det_of_noise + float(np.log(np.diag(factor)).sum())
        return -half_log_det - 0.5 * float((turned**2).sum() - told @ told)

    def leave_out(self, variances: Array, rows: Array) -> tuple[Array, Array]:
        """Return by how much each pose's rows deviate from what all others predict, (B, P, n), and their precision."""
        found = [leave_out_by(self.factorise(one), row) for one, row in zip(variances, rows, strict=True)]
        return np.stack([one for one, _ in found]), np.stack([one for _, one in found])

    def weigh_each(self, variances: Array, rows: Array) -> tuple[Array, Array]:
        """Return log p(e_n | all other rows) but for 2 π of each pose and its squared deviation, shapes (B, P)."""
        return weigh_left_out(*self.leave_out(variances, rows))

    # --- derivatives -------------------------------------------------------------------------------------------------

    def act(self, alpha: Array) -> Array:
        """Return B_g α and E_t α, (M,) to (G + C, M)."""
        shape, (n, _, a) = self.known.shape[:2], self.basis.shape
        rows = alpha.reshape(*shape, 1)
        told = project(self.shown, self.basis, rows).reshape(n, a)
        found, beside = [(self.blocks @ rows).reshape(-1, self.size)], (self._every @ rows)[..., 0]
        for sort, left in enumerate(self.left):
            values = np.einsum("ipa,ia->pi", self.basis, told * (self.sorts == sort))
            own = np.einsum("pki,pi->pk", self.shown, values) + left * beside
            found.append(own.reshape(1, -1))
        return np.concatenate(found)

    def traces(self, variances: Array) -> tuple[Array, Array]:
        """Return tr S⁻¹ E_k of all K = G + C parts, B_g and E_t, and tr S⁻¹ E_k S⁻¹ E_l, shapes (K,) and (K, K)."""
        white, c = self.factorise(variances), len(self.left)
        g = len(self.blocks) + 1  # F Fᵀ behind the blocks
        of_sort = (np.tile(self.sorts, len(self.basis))[:, None] == np.arange(c)).astype(float)  # (R, C)
        first, second = np.zeros(g + c), np.zeros((g + c, g + c))
        covariance = white.root @ white.root.T
        reduced = np.eye(self.n_columns) - covariance @ white.gram  # S⁻¹Φ = D⁻¹Φ times it
        through = white.gram @ reduced
        first[g:] = np.diag(through) @ of_sort
        second[g:, g:] = of_sort.T @ through**2 @ of_sort
        blocks = np.concatenate([self.blocks, self._every[None]])
        own = white.turn @ blocks @ np.swapaxes(white.turn, -1, -2)  # B_g where D is one
        first[:g] = np.einsum("pij,gpji->g", white.precision(), blocks, optimize=True)
        seen_by = own @ white.seen
        grams = np.stack([find_gram(self.basis, np.swapaxes(white.seen, -1, -2) @ one) for one in seen_by])
        second[:g, g:] = np.einsum("ri,gru,ui->gi", reduced, grams, reduced, optimize=True) @ of_sort
        second[g:, :g] = second[:g, g:].T
        pulled = grams @ covariance
        second[:g, :g] = np.einsum("gpij,hpji->gh", own, own, optimize=True)
        second[:g, :g] += np.einsum("gij,hji->gh", pulled, pulled, optimize=True)
        for i in range(g):
            for j in range(i + 1):
                weights = np.swapaxes(seen_by[i], -1, -2) @ seen_by[j]
                gram = find_gram(self.basis, 0.5 * (weights + np.swapaxes(weights, -1, -2)))
                second[i, j] -= 2.0 * np.sum(gram * covariance)
                second[j, i] = second[i, j]
        change = np.delete(np.eye(g + c), g - 1, axis=0)
        change[g - 1 :, g - 1] = self.left
        return change @ first, change @ second @ change.T


def weigh_by(white: Factorised, row: Array) -> float:
    """Return the log-density of rows (M,) but for 2 π."""
    return -white.half_log_det - 0.5 * float(white.square(row[:, None])[0, 0])


def leave_out_by(white: Thin, row: Array) -> tuple[Array, Array]:
    """Return what `leave_out` finds of rows (M,), shapes (P, n) and (P, n, n)."""
    precision = white.precision()
    alpha = white.solve(row).reshape(precision.shape[:2])
    return np.linalg.solve(precision, alpha[..., None])[..., 0], precision


class LinearRows(NamedTuple):
    """Rows as a linear model of the geometry, with a covariance S that depends on the errors."""

    residual: Array  # (M,)
    slope: Array  # (M, m)
    information: Array  # (m, m): of rows that do not depend on the errors
    pull: Array  # (m,): their gradient
    factorise: Callable[[Array], Factorised]  # from coordinates ζ (k,) of the errors to S


class GeometryGiven(NamedTuple):
    """Geometry given what is unknown of the errors, to first order about a machine: normal."""

    mean: Array  # (m,)
    covariance: Array  # (m, m)
    log_mass: float  # density of the errors' unknowns alone, their prior included, but for a constant


@dataclass(frozen=True, eq=False)
class LinearGeometry:
    """Geometry whose rows and prior are linear about a machine.

    Attributes
    ----------
    centre : ndarray, shape (m,)
        The machine's coordinates.
    rows : LinearRows
    precision, pull : ndarray, shapes (m, m) and (m,)
        Minus the Hessian and the gradient there of the prior and of all rows that do not depend on the errors.
    log_prior : callable
        The log-prior of coordinates ζ (k,) of the errors.
    sizes : callable
        From ζ (B, k) to the errors in their own units.
    """

    centre: Array
    rows: LinearRows
    precision: Array
    pull: Array
    log_prior: Callable[[Array], float]
    sizes: Callable[[Array], Array]

    def given(self, zeta: Array) -> GeometryGiven:
        """Return the geometry given ζ (k,): with J of the white rows e, H = P + JᵀJ and mean H⁻¹ (p - Jᵀ e)."""
        white, m = self.rows.factorise(zeta), len(self.pull)
        both = white.square(np.column_stack([self.rows.slope, self.rows.residual]))
        factor = cholesky(self.precision + both[:m, :m], lower=True, check_finite=False)
        inverse = solve_triangular(factor, np.eye(m), lower=True, check_finite=False)
        step = inverse @ (self.pull - both[:m, m])
        log_mass = 0.5 * (step @ step - both[m, m]) - white.half_log_det - np.log(np.diag(factor)).sum()
        mean = self.centre + inverse.T @ step
        return GeometryGiven(mean, inverse.T @ inverse, float(log_mass) + self.log_prior(zeta))

    def log_mass(self, zeta: Array) -> float:
        """Return the density of the errors' unknowns alone at ζ (k,), but for a constant."""
        return self.given(zeta).log_mass
