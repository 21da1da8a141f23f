"""Covariances of low rank beside independent errors: of many legs at a pose, and of what all rows have in common.

Many legs need no matrix of all of them: each errs by itself, but for the six of the pose. Of N legs' errors r,
C = D + U Uᵀ with D diagonal, from actuators, deformations and model errors, and U = A⁰ L of six columns, Σ = L Lᵀ, from
the measured pose. By Woodbury's identity and the determinant's lemma with M = 1 + Uᵀ D⁻¹ U,

    rᵀ C⁻¹ r = rᵀ D⁻¹ r - vᵀ M⁻¹ v,   v = Uᵀ D⁻¹ r,   log det C = log det D + log det M,

which grows with N where a factor of C grows with its cube. With six legs nothing is gained, and digits are lost where D
is tiny beside U Uᵀ: then there is no such form, as where actuators' errors are seen by other legs.

Errors that are linear in coefficients common to all rows are integrated out of the density of these rows. With white
rows e (P, m) that are free of the poses, and what coefficients u ~ N(0, 1) do to them, e = A u + ε,

    ∫ N(e; A u, 1) N(u; 0, 1) du = N(e - A û; 0, 1) exp(-½ |û|²) |M|^(-1/2),   M = 1 + AᵀA,   û = M⁻¹ Aᵀ e

(Woodbury's identity and the determinant's lemma): exact, and its cost is that of M, whose size is the number of
coefficients. Given the rows u is N(û, M⁻¹).

Where single rows may be wrong, rows are independent given u, and u is integrated out by Laplace's method: û is the mode
of Σ log t(|e - A u|²) - ½ |u|², found by iteratively reweighted least squares with the rows' mean precisions w as
weights, and M the curvature there, 1 + Σ Aᵀ(w - c r rᵀ)A with r = e - A û and c = 2 w² / (ν + m). What that leaves out
of the log-density is of the order of 1 / P for each coefficient that the rows determine, and nothing for those that
they do not: against quadrature at most 0.6 / P nats a coefficient for ν = 2, 0.3 / P for ν = 4, 0.08 / P for ν = 30.
Without outliers it is nothing at all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.density.outliers import Outliers
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array
from bayescal.numerics.scratch import Scratch

FEWEST_LEGS = 10
SMALLEST = 1e-5
"""Share of the covariance that D has to have: five of sixteen digits may be lost."""
DIAGONAL = 1e-12
"""Share that may stand beside the diagonal."""
PAIRS = np.tril_indices(DEGREES_OF_FREEDOM)


def factor_by_columns(
    known: Array, add: Callable[[int], Array], errors: Array, scratch: Scratch
) -> tuple[Array, Array]:
    """Return log-densities but for 2 π, and rᵀ C⁻¹ r; Cholesky factors of all poses and batch entries, by columns.

    The errors are carried along as one more row of the matrix; in the factor that row holds the whitened errors.

    Parameters
    ----------
    known : ndarray, shape (P, N, N)
        Covariance but for the model error.
    add : callable
        From a leg to the variance that its model error adds, shape (P, B).
    errors : ndarray, shape (N, P, B)
    scratch : Scratch

    Returns
    -------
    ndarray, ndarray, shapes (P, B)
    """
    n = len(errors)
    factor = scratch.take("factor", n + 1, n, *errors.shape[1:])
    determinant = np.ones(errors.shape[1:])
    for j in range(n):
        column = factor[j:, j]
        own = known[:, j:, j].T[..., None]
        if j:
            np.einsum("ikpb,kpb->ipb", factor[j:, :j], factor[j, :j], out=column)
            np.subtract(own, column[:-1], out=column[:-1])
            np.subtract(errors[j], column[-1], out=column[-1])
        else:
            column[:-1], column[-1] = own, errors[j]
        column[0] += add(j)
        inverse = 1.0 / np.sqrt(column[0])
        column[1:] *= inverse
        determinant *= inverse
    square = np.einsum("kpb,kpb->pb", factor[n], factor[n])
    return np.log(determinant) - 0.5 * square, square


@dataclass(frozen=True, eq=False)
class LowRank:
    """Covariances of the legs' errors at P poses, but for the model error."""

    own: Array  # (P, N): D, mm²
    columns: Array  # (P, 6, N): Uᵀ, mm
    products: Array  # (P, 21, N): products of two of the columns, those of the lower triangle row by row

    def select(self, part: slice) -> LowRank:
        """Return those of some of the poses."""
        return LowRank(self.own[part], self.columns[part], self.products[part])

    def evaluate(self, add: Callable[[int], Array], errors: Array, scratch: Scratch) -> tuple[Array, Array]:
        """Return log-densities but for 2 π, and rᵀ C⁻¹ r, both (P, B); arguments as of `factor_by_columns`."""
        n_legs, n_poses, n_batch = errors.shape
        inverse = scratch.take("inverse", n_poses, n_legs, n_batch)
        for leg in range(n_legs):
            np.add(self.own[:, leg, None], add(leg), out=inverse[:, leg])
        log_det = np.log(inverse).sum(axis=1)
        np.reciprocal(inverse, out=inverse)
        seen = errors.transpose(1, 0, 2)
        scaled = np.multiply(seen, inverse, out=scratch.take("scaled", n_poses, n_legs, n_batch))
        square = np.einsum("pib,pib->pb", seen, scaled)
        factor = scratch.take("small", DEGREES_OF_FREEDOM + 1, DEGREES_OF_FREEDOM, n_poses, n_batch)
        inner = scratch.take("inner", n_poses, len(PAIRS[0]), n_batch)
        np.matmul(self.products, inverse, out=inner)
        factor[PAIRS] = inner.transpose(1, 0, 2)
        factor[-1] = (self.columns @ scaled).transpose(1, 0, 2)
        determinant = _factorise(factor)
        square -= np.einsum("kpb,kpb->pb", factor[-1], factor[-1])
        return np.log(determinant) - 0.5 * log_det - 0.5 * square, square


def _factorise(factor: Array) -> Array:
    """Take 1 + M (6, 6, ...) to its Cholesky factor, and one more row along; return the inverse of its determinant."""
    determinant = np.ones(factor.shape[2:])
    for j in range(DEGREES_OF_FREEDOM):
        column = factor[j:, j]
        column[0] += 1.0
        if j:
            column -= np.einsum("ikpb,kpb->ipb", factor[j:, :j], factor[j, :j])
        inverse = 1.0 / np.sqrt(column[0])
        column[1:] *= inverse
        determinant *= inverse
    return determinant


def find_low_rank(pose: Array, measured: Array, known: Array) -> LowRank | None:
    """Return a covariance in terms of six columns, None where it is not worth it or loses digits.

    Parameters
    ----------
    pose : ndarray, shape (P, N, 6)
        A⁰.
    measured : ndarray, shape (P, 6, 6)
        Σ, mm and rad.
    known : ndarray, shape (P, N, N)
        C but for the model error, mm².
    """
    if pose.shape[1] < FEWEST_LEGS:
        return None
    try:
        columns = np.swapaxes(pose @ np.linalg.cholesky(measured), -1, -2)
    except np.linalg.LinAlgError:
        return None
    rest = known - np.swapaxes(columns, -1, -2) @ columns
    own = np.diagonal(rest, axis1=-2, axis2=-1)
    largest = np.diagonal(known, axis1=-2, axis2=-1).max()
    beside = rest * ~np.eye(pose.shape[1], dtype=bool)
    if own.min() < SMALLEST * largest or np.abs(beside).max() > DIAGONAL * largest:
        return None
    return LowRank(own.copy(), columns, columns[:, PAIRS[0]] * columns[:, PAIRS[1]])


BUDGET = 1 << 17  # numbers of the columns of all machines that are worked on together
STEP_TOLERANCE = 1e-7  # of a coefficient's prior standard deviation: what it leaves enters the density squared
MAX_ITERATIONS = 200
SMALLEST_SHARE = 1e-10
"""Of the largest variance by columns, that rows have beside, so that their covariance is definite."""


@dataclass(frozen=True, eq=False)
class Coefficients:
    """The N coefficients of B machines given their rows: normal about a mean."""

    mean: Array  # (B, N): û
    precision: Array  # (B, N, N): M
    log_volume: Array  # (B,): -½ log |M|
    residual: Array  # (B, P, m): e - A û
    trust: Array  # (B, P): w; one without outliers
    columns: Array  # (B, P, m, N): A

    @cached_property
    def inverse(self) -> Array:
        """M⁻¹, shape (B, N, N)."""
        return np.linalg.inv(self.precision)

    @property
    def square(self) -> Array:
        """Squares of the residuals, shape (B, P)."""
        return np.einsum("bpk,bpk->bp", self.residual, self.residual)

    @property
    def penalty(self) -> Array:
        """-½ |û|² - ½ log |M|, what coefficients add to the density of the residuals, shape (B,)."""
        return np.asarray(self.log_volume - 0.5 * np.einsum("bi,bi->b", self.mean, self.mean))

    def draw(self, rng: np.random.Generator) -> Array:
        """Return one draw for each machine, (B, N)."""
        spread = np.linalg.cholesky(self.inverse)
        return np.asarray(self.mean + (spread @ rng.standard_normal((*self.mean.shape, 1)))[..., 0])

    def reduce(self, rows: Array) -> Array:
        """Return S⁻¹ x for x (B, P, m, n), S = W⁻¹ + A Aᵀ being the rows' covariance by noise and coefficients."""
        weighed = self.trust[..., None, None] * rows
        flat = _flatten(self.columns)
        curvature = _accumulate(self.columns, self.residual, self.trust)[0]
        back = flat @ np.linalg.solve(curvature, np.swapaxes(flat, -1, -2) @ _flatten(weighed))
        return np.asarray(weighed - self.trust[..., None, None] * back.reshape(weighed.shape))

    def inform(self, noise: Array, seen: Array, moved: Array) -> Array:
        """Return the expected information on n unknowns of the errors, (n, n), but for that of the noise alone.

        With S = W⁻¹ + A Aᵀ and dS = dR + dA Aᵀ + A dAᵀ it is ½ tr S⁻¹ dS S⁻¹ dS; left out is ½ tr W dR W dR.

        Parameters
        ----------
        noise, seen : ndarray, shape (n, P, m, m)
            dR of the first machine, and W dR.
        moved : ndarray, shape (n, P, m, N)
            dA.
        """
        n, size = len(moved), moved.shape[-1]
        side_by_side = np.moveaxis(moved, 0, 2).reshape(1, *moved.shape[1:3], -1)
        reduced = np.moveaxis(self.reduce(side_by_side)[0].reshape(*moved.shape[1:3], n, size), 2, 0)
        flat, columns, own = moved.reshape(n, -1, size), self.columns[0], self.reduce(self.columns)[0]
        across = own.reshape(-1, size).T @ flat
        found = np.einsum("nuv,ovu->no", across, across, optimize=True)
        found += (flat @ (columns.reshape(-1, size).T @ own.reshape(-1, size))).reshape(n, -1) @ reduced.reshape(
            n, -1
        ).T
        if not noise.any():
            return np.asarray(found)
        mixed = (noise @ own).reshape(n, -1) @ reduced.reshape(n, -1).T
        weighed = self.trust[0, :, None, None] * columns
        inverse = np.linalg.inv(_accumulate(self.columns, self.residual, self.trust)[0][0])
        pulled, through = (one.reshape(n, -1, size) for one in (noise @ weighed, seen @ weighed))
        inner = inverse @ (weighed.reshape(-1, size).T @ pulled)
        found += 0.5 * np.einsum("nuv,ovu->no", inner, inner, optimize=True)
        found -= (pulled @ inverse).reshape(n, -1) @ through.reshape(n, -1).T
        return np.asarray(found + mixed + mixed.T)

    def condition_each(self, outliers: Outliers, spare: np.ndarray) -> Array:
        """Return the log-density of each pose's rows given all others, (B, P); in Laplace's approximation.

        Taking a pose's own curvature S = w - c r rᵀ from M leaves the others', which expect of its rows A û_others with
        covariance G = A M_others⁻¹ Aᵀ.
        """
        own = self._spread(self.columns)
        soft = outliers.soften(self.square, spare)[..., None, None]
        outer = self.residual[..., :, None] * self.residual[..., None, :]
        identity = np.eye(own.shape[-1])
        curvature = self.trust[..., None, None] * identity - soft * outer
        spread = np.linalg.solve(identity - own @ curvature, own)
        left = self.residual + self.trust[..., None] * (spread @ self.residual[..., None])[..., 0]
        return _weigh(left, spread, outliers, spare)

    def condition_others(self, error: Array, columns: Array, outliers: Outliers, spare: np.ndarray) -> Array:
        """Return the log-density of each of Q other poses' rows given these, (B, Q), from e and A of theirs."""
        left = error - np.einsum("bqkn,bn->bqk", columns, self.mean)
        return _weigh(left, self._spread(columns), outliers, spare)

    def _spread(self, columns: Array) -> Array:
        """Return A M⁻¹ Aᵀ, shape (B, P, m, m)."""
        return np.asarray(columns @ self.inverse[:, None] @ np.swapaxes(columns, -1, -2))


def _weigh(left: Array, spread: Array, outliers: Outliers, spare: np.ndarray) -> Array:
    good = np.isfinite(left).all(axis=-1) & np.isfinite(spread).all(axis=(-1, -2))
    symmetric = 0.5 * (spread + np.swapaxes(spread, -1, -2))
    variance, axes = np.linalg.eigh(np.where(good[..., None, None], symmetric, 0.0))
    size = np.einsum("...ki,...k->...i", axes, np.where(good[..., None], left, 0.0))
    found = outliers.weigh_spread(size, np.maximum(variance, 0.0), spare)
    return np.where(good, found, -np.inf)


def split(n_machines: int, n_poses: int, n_rows: int, n_columns: int) -> Iterator[slice]:
    """Yield slices of machines whose columns are held together."""
    size = max(1, BUDGET // max(1, n_poses * n_rows * n_columns))
    yield from (slice(k, k + size) for k in range(0, n_machines, size))


def find_coefficients(error: Array, columns: Array, outliers: Outliers, spare: np.ndarray) -> Coefficients:
    """Return the coefficients given the rows.

    Parameters
    ----------
    error : ndarray, shape (B, P, m)
        White rows, free of the poses; NaN where there is no machine.
    columns : ndarray, shape (B, P, m, N)
        A.
    outliers : Outliers
    spare : ndarray, shape (P,)
        Degrees of freedom of each pose's rows: m, or less where rows lie in a subspace.
    """
    shape = columns.shape
    good = np.isfinite(error).all(axis=(1, 2)) & np.isfinite(columns).all(axis=(1, 2, 3))
    safe = np.where(good[:, None, None], error, 0.0)
    columns = np.where(good[:, None, None, None], columns, 0.0)
    if not outliers.expected:
        curvature, told = _accumulate(columns, safe, np.ones(shape[:2]))
        mean = np.linalg.solve(curvature, told[..., None])[..., 0]
        return _conclude(error, columns, mean, curvature, np.ones(shape[:2]))
    mean = _reweight(safe, columns, outliers, spare)
    residual = safe - _act(columns, mean)
    square = np.einsum("bpk,bpk->bp", residual, residual)
    trust = outliers.trust(square, spare)
    curvature = _accumulate(columns, residual, trust)[0]
    pulled = np.einsum("bpkn,bpk->bpn", columns, residual, optimize=True)
    softer = curvature - np.swapaxes(pulled, -1, -2) @ (outliers.soften(square, spare)[..., None] * pulled)
    definite = np.linalg.eigvalsh(softer)[:, 0] > 0.0  # as at every mode; elsewhere the weights' own curvature
    curvature = np.where(definite[:, None, None], softer, curvature)
    return _conclude(error, columns, mean, curvature, trust)


def _conclude(error: Array, columns: Array, mean: Array, curvature: Array, trust: Array) -> Coefficients:
    factor = np.linalg.cholesky(curvature)
    log_volume = -np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
    return Coefficients(mean, curvature, log_volume, error - _act(columns, mean), trust, columns)


def _reweight(error: Array, columns: Array, outliers: Outliers, spare: np.ndarray) -> Array:
    """Return û, shape (B, N), by iteratively reweighted least squares."""
    mean = np.zeros((len(error), columns.shape[-1]))
    going = np.arange(len(error))
    for _ in range(MAX_ITERATIONS):
        own = columns[going]
        residual = error[going] - _act(own, mean[going])
        trust = outliers.pick(going).trust(np.einsum("bpk,bpk->bp", residual, residual), spare)
        curvature, told = _accumulate(own, residual, trust)
        step = np.linalg.solve(curvature, (told - mean[going])[..., None])[..., 0]
        mean[going] += step
        going = going[np.abs(step).max(axis=-1, initial=0.0) > STEP_TOLERANCE]
        if not len(going):
            break
    return mean


def _accumulate(columns: Array, rows: Array, trust: Array) -> tuple[Array, Array]:
    """Return 1 + AᵀWA and AᵀW times rows (B, P, m)."""
    if (trust != 1.0).any():
        root = np.sqrt(trust)[..., None]
        columns, rows = root[..., None] * columns, root * rows
    flat = _flatten(columns)
    turned = np.swapaxes(flat, -1, -2)
    curvature = turned @ flat
    curvature[..., *np.diag_indices(flat.shape[-1])] += 1.0
    return curvature, (turned @ rows.reshape(len(rows), -1, 1))[..., 0]


def _flatten(rows: Array) -> Array:
    """Return rows (B, P, m, n) of all poses below each other, (B, P m, n)."""
    return rows.reshape(len(rows), -1, rows.shape[-1])


def _act(columns: Array, mean: Array) -> Array:
    """Return A u, (B, P, m)."""
    return (_flatten(columns) @ mean[..., None]).reshape(columns.shape[:-1])


def gather_columns(columns: Array) -> Array:
    """Return columns (..., P, m, N') of the covariance of others (..., P, m, N), where these are more than rows."""
    shape, n_rows = columns.shape[:-1], columns.shape[-3] * columns.shape[-2]
    if columns.shape[-1] <= n_rows:
        return columns
    flat = columns.reshape(*shape[:-2], n_rows, -1)
    covariance = flat @ np.swapaxes(flat, -1, -2)
    own = np.einsum("...ii->...i", covariance)
    own += SMALLEST_SHARE * own.max(axis=-1, keepdims=True)
    return np.linalg.cholesky(covariance).reshape(*shape, -1)
