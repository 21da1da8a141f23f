"""Normal rows of many poses, whose covariance is block diagonal but for few columns: linear in the poses.

Where poses are many, functions that rows see by F are made of few columns each, and what these leave out, l_t, is
independent from pose to pose (`bayescal.density.pose_kernels`): `bayescal.density.components` with

    S = D + Σ_t v_t Φ_t Φ_tᵀ,    D = K + Σ_g v_g B_g + Σ_t v_t l_t F Fᵀ.

With s the root of each column's variance and A = 1 + s ΦᵀD⁻¹Φ s (Woodbury's identity and the determinant's lemma)

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
from typing import Final

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from bayescal.density.linear_gaussian import ConditionalNormal, condition, half_log_det, weigh_left_out
from bayescal.numerics.geometry import Array

WIDTH: Final = 4.0  # of x, over which one polynomial interpolates
NODES: Final = 24  # which leave 1e-12 of the Gram matrix there
GRAMS: Final = 3_000_000  # numbers of Gram matrices that are factorised together


def list_gram_arrays(n_rows: int, n_columns: int) -> list[tuple[float, ...]]:
    """Return what is held of M rows and R columns beside these: how many arrays alike, then their shape."""
    return [(3.0 * NODES, n_columns, n_columns), (3.0, GRAMS), (3.0, GRAMS / n_columns**2, n_rows)]


@dataclass(frozen=True, eq=False)
class LowRankFactor:
    """S of one vector of variances, factorised by few columns beside a block diagonal."""

    turn: Array  # (P, n, n): what makes rows white but for the functions
    seen: Array  # (P, n, N): what such rows see of N functions
    basis: Array  # (N, P, A): what each function is made of
    scale: Array  # (R,): s, with R = N A
    gram: Array  # (R, R): ΦᵀD⁻¹Φ
    half_log_det_of_noise: float  # ½ log |D|

    def given(self, rows: Array) -> ConditionalNormal:
        """Return the coefficients over s given rows (M, m)."""
        white = self.turn @ rows.reshape(*self.turn.shape[:2], -1)
        flat = white.reshape(-1, white.shape[-1])
        pull = self.scale[:, None] * project(self.seen, self.basis, white)
        inner = add_prior(self.gram.copy(), self.scale)
        return condition(inner, pull, flat.T @ flat, -self.half_log_det_of_noise)

    def square(self, rows: Array) -> tuple[Array, float]:
        """Return XᵀS⁻¹X of X (M, m), shape (m, m), and ½ log |S|."""
        found = self.given(rows)
        return found.square, self.half_log_det_of_noise + float(half_log_det(found.factor))

    def weigh(self, row: Array) -> float:
        """Return the log-density of rows (M,) but for 2 π."""
        return float(self.given(row[:, None]).log_marginal)

    def draw(self, row: Array, normal: Array) -> Array:
        """Return coefficients over s given rows (M,), (R,), from normal numbers (R,): N(0, 1) without rows."""
        return self.given(row[:, None]).draw(normal[:, None])[:, 0]

    def predict(self, row: Array, shown: Array, basis: Array) -> tuple[Array, Array]:
        """Return what functions are expected to do to rows of Q other poses given rows (M,), and the covariance.

        They are (Q, k) and (Q, k, k) for other poses' rows that see functions by (Q, k, N), of bases (N, Q, A).
        """
        found = self.given(row[:, None])
        coefficients = (self.scale * found.mean[:, 0]).reshape(len(basis), -1, 1)
        covariance = spread_at_poses(basis, self.scale[:, None] * found.covariance * self.scale)
        values = (basis @ coefficients)[..., 0]
        return np.einsum("qki,iq->qk", shown, values), shown @ covariance @ np.swapaxes(shown, -1, -2)

    def weigh_left_out(self, row: Array) -> Array:
        """Return log-densities but for 2 π of each pose's rows given all others', (P,), of rows (M,)."""
        expected, covariance = self.predict(row, self.seen, self.basis)
        left = (self.turn @ row.reshape(*self.turn.shape[:2], 1))[..., 0] - expected
        back, known = np.swapaxes(self.turn, -1, -2), np.eye(self.turn.shape[1]) - covariance
        return weigh_left_out(back @ known @ self.turn, (back @ left[..., None])[..., 0])


def add_prior(gram: Array, scale: Array) -> Array:
    """Return 1 + s G s of Gram matrices G (..., R, R), which are used up, and scales s (..., R)."""
    gram *= scale[..., None]
    gram *= scale[..., None, :]
    np.einsum("...ii->...i", gram)[:] += 1.0
    return gram


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
class Interpolated:
    """Sums over rows of something divided by 1 + v λ, as functions of v."""

    values: Array  # (P, n): λ
    find: Callable[[Array], Array]  # from weights of rows (P, n) to the sums (S,), linear

    @cached_property
    def _largest(self) -> float:
        """Λ; any positive number where all λ are zero."""
        return float(self.values.max()) or 1.0

    @cached_property
    def _polynomials(self) -> dict[int, Array]:
        return {}

    def __call__(self, v: Array) -> Array:
        """Return the sums, (B,) to (B, S)."""
        x = np.log1p(v * self._largest)
        number = (x / WIDTH).astype(int)
        found = np.empty((len(v), self._find_polynomial(int(number[0])).shape[1]))
        for k in np.unique(number):
            some = number == k
            found[some] = chebvander(2.0 * (x[some] / WIDTH - k) - 1.0, NODES - 1) @ self._find_polynomial(int(k))
        found *= np.exp(-x)[:, None]
        return found

    def _find_polynomial(self, number: int) -> Array:
        """Return coefficients of Chebyshev polynomials of 1 + v Λ times the sums, (NODES, S), over a range of x."""
        if number not in self._polynomials:
            place = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
            x = WIDTH * (number + 0.5 * (place + 1.0))
            sums = [np.exp(one) * self.find(1.0 / (1.0 + np.expm1(one) / self._largest * self.values)) for one in x]
            change = 2.0 / NODES * chebvander(place, NODES - 1).T
            change[0] *= 0.5
            self._polynomials[number] = change @ np.stack(sums)
        return self._polynomials[number]


@dataclass(frozen=True, eq=False)
class LowRankCovariance:
    """Covariances whose E_t are of few columns: rows see N functions of the pose, each made of a basis."""

    known: Array  # (P, n, n): K
    blocks: Array  # (G, P, n, n): B_g
    shown: Array  # (P, n, N): what rows see of each function
    basis: Array  # (N, P, A): what each function is made of at the poses
    sorts: np.ndarray  # (A,): which of the C variances each entry of the basis has
    left: Array  # (C,): l

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

    def _half_log_det_of_noise(self, v: Array) -> Array:
        """Return ½ log |D| of v (B,), shape (B,)."""
        values = self._turned[1].ravel()
        return self._half_log_det_of_known + 0.5 * np.array([np.log1p(one * values).sum() for one in v])

    @cached_property
    def _grams(self) -> Interpolated:
        """ΦᵀD⁻¹Φ, R² numbers."""
        _, values, seen = self._turned

        def find(weights: Array) -> Array:
            weighed = np.swapaxes(seen, -1, -2) @ (weights[..., None] * seen)
            return find_gram(self.basis, weighed).ravel()

        return Interpolated(values, find)

    # --- density -----------------------------------------------------------------------------------------------------

    def factorise(self, variances: Array) -> LowRankFactor:
        """Return S of variances (G + C,)."""
        own, weights = np.split(variances, [len(self.blocks)])
        v = float(self._find_equal(variances[None])[0])
        if np.isnan(v):
            return self.factorise_beside(self.known + np.tensordot(own, self.blocks, 1), weights)
        turn, values, seen = self._turned
        size = 1.0 / np.sqrt(1.0 + v * values)[..., None]
        return LowRankFactor(
            size * turn,
            size * seen,
            self.basis,
            self._scales(weights),
            self._grams(np.array([v])).reshape(2 * [self.n_columns]),
            float(self._half_log_det_of_noise(np.array([v]))[0]),
        )

    def square(self, seen: Array) -> Callable[[Array], tuple[Array, float]]:
        """Return what takes variances (G + C,) to XᵀS⁻¹X of X (M, m), shape (m, m), and ½ log |S|."""
        (turn, values, shown), m, n = self._turned, seen.shape[1], self.n_columns
        turned = turn @ seen.reshape(*values.shape, m)

        def find(weights: Array) -> Array:
            weighed = weights[..., None] * turned
            own = weighed.reshape(-1, m).T @ turned.reshape(-1, m)
            return np.concatenate([own.ravel(), project(shown, self.basis, weighed).ravel()])

        sums = Interpolated(values, find)

        def evaluate(variances: Array) -> tuple[Array, float]:
            v = self._find_equal(variances[None])
            if np.isnan(v[0]):
                return self.factorise(variances).square(seen)
            own, across = np.split(sums(v)[0], [m * m])
            scale = self._scales(variances[len(self.blocks) :])
            inner, pull = add_prior(self._grams(v).reshape(n, n), scale), scale[:, None] * across.reshape(n, m)
            found = condition(inner, pull, own.reshape(m, m))
            return found.square, float(self._half_log_det_of_noise(v)[0] + half_log_det(found.factor))

        return evaluate

    def factorise_beside(self, noise: Array, weights: Array) -> LowRankFactor:
        """Return S where K + Σ v_g B_g is as given, (P, n, n), for the functions' variances (C,)."""
        factor = np.linalg.cholesky(noise + float(weights @ self.left) * self._every)
        turn = np.linalg.inv(factor)
        seen = turn @ self.shown
        gram = find_gram(self.basis, np.swapaxes(seen, -1, -2) @ seen)
        return LowRankFactor(turn, seen, self.basis, self._scales(weights), gram, float(half_log_det(factor).sum()))

    def weigh(self, variances: Array, rows: Array) -> Array:
        """Return normal log-densities of rows (B, M) but for 2 π, shape (B,), for variances (B, G + C)."""
        found, v = np.empty(len(rows)), self._find_equal(variances)
        for k in np.flatnonzero(np.isnan(v)):
            found[k] = self.factorise(variances[k]).weigh(rows[k])
        index, most = np.flatnonzero(~np.isnan(v)), max(1, GRAMS // self.n_columns**2)
        for some in (index[k : k + most] for k in range(0, len(index), most)):
            turn, values, seen = self._turned
            scale = self._scales(variances[some, len(self.blocks) :])
            turned = turn @ rows[some].T.reshape(*turn.shape[:2], -1)
            weighed = turned / (1.0 + v[some] * values[..., None])
            inner = add_prior(self._grams(v[some]).reshape(len(some), self.n_columns, -1), scale)
            pull = scale * project(seen, self.basis, weighed).T
            square = np.einsum("pib,pib->b", turned, weighed)
            constant = -self._half_log_det_of_noise(v[some])
            found[some] = condition(inner, pull[..., None], square[:, None, None], constant).log_marginal
        return found
