"""Errors that rows have in common beside independent ones: coefficients integrated out of the density of all rows.

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

from bayescal.density.linear_gaussian import factorise, half_log_det
from bayescal.density.outliers import Outliers
from bayescal.numerics.geometry import Array
from bayescal.numerics.scratch import Scratch


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
    signs: Array | float = 1.0  # (N,): of what columns add to the covariance, u ~ N(0, signs)

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
        return np.asarray(self.log_volume - 0.5 * np.einsum("bi,bi->b", self.mean, self.signs * self.mean))

    def draw(self, rng: np.random.Generator) -> Array:
        """Return one draw for each machine, (B, N).

        Columns that are taken away from the covariance are those of noise that depends on the others, and are not
        drawn. The others are normal about their part of û with their part of M⁻¹: with W and D = diag(signs), what
        rows tell of A₊ is A₊ᵀ (W⁻¹ + A D Aᵀ)⁻¹ = (M⁻¹)₊ Aᵀ W, and what that leaves of the prior is (M⁻¹)₊₊.
        """
        normal = rng.standard_normal((*self.mean.shape, 1))
        adds = np.flatnonzero(np.broadcast_to(self.signs, self.mean.shape[-1:]) > 0.0)
        drawn, own = np.zeros(self.mean.shape), self.inverse[:, adds[:, None], adds]
        drawn[:, adds] = self.mean[:, adds] + (np.linalg.cholesky(own) @ normal[:, adds])[..., 0]
        return drawn

    def reduce(self, rows: Array) -> Array:
        """Return S⁻¹ x for x (B, P, m, n), S = W⁻¹ + A Aᵀ being the rows' covariance by noise and coefficients."""
        weighed = self.trust[..., None, None] * rows
        flat = _flatten(self.columns)
        curvature = _accumulate(self.columns, self.residual, self.trust, self.signs)[0]
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
        inverse = np.linalg.inv(_accumulate(self.columns, self.residual, self.trust, self.signs)[0][0])
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
        return self._weigh(left, spread, outliers, spare)

    def condition_others(self, error: Array, columns: Array, outliers: Outliers, spare: np.ndarray) -> Array:
        """Return the log-density of each of Q other poses' rows given these, (B, Q), from e and A of theirs."""
        left = error - np.einsum("bqkn,bn->bqk", columns, self.mean)
        return self._weigh(left, self._spread(columns), outliers, spare)

    def _spread(self, columns: Array) -> Array:
        """Return A M⁻¹ Aᵀ, shape (B, P, m, m)."""
        return np.asarray(columns @ self.inverse[:, None] @ np.swapaxes(columns, -1, -2))

    def _weigh(self, left: Array, spread: Array, outliers: Outliers, spare: np.ndarray) -> Array:
        """Return log-densities of rows by what they err, (B, P, m), and by how much more than the noise they vary.

        Noise that depends on coefficients is told by these, too, so that rows may vary less.
        """
        good = np.isfinite(left).all(axis=-1) & np.isfinite(spread).all(axis=(-1, -2))
        symmetric = 0.5 * (spread + np.swapaxes(spread, -1, -2))
        variance, axes = np.linalg.eigh(np.where(good[..., None, None], symmetric, 0.0))
        size = np.einsum("...ki,...k->...i", axes, np.where(good[..., None], left, 0.0))
        least = SMALLEST_SHARE - 1.0 if np.ndim(self.signs) and not outliers.expected else 0.0
        found = outliers.weigh_spread(size, np.maximum(variance, least), spare)
        return np.where(good, found, -np.inf)


def split(n_machines: int, n_poses: int, n_rows: int, n_columns: int) -> Iterator[slice]:
    """Yield slices of machines whose columns are held together."""
    size = max(1, BUDGET // max(1, n_poses * n_rows * n_columns))
    yield from (slice(k, k + size) for k in range(0, n_machines, size))


def find_coefficients(
    error: Array, columns: Array, outliers: Outliers, spare: np.ndarray, signs: Array | None = None
) -> Coefficients:
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
    signs : ndarray, shape (N,), optional
        Of what each column adds to the covariance.
    """
    shape, prior = columns.shape, 1.0 if signs is None else signs
    good = np.isfinite(error).all(axis=(1, 2)) & np.isfinite(columns).all(axis=(1, 2, 3))
    safe = np.where(good[:, None, None], error, 0.0)
    columns = np.where(good[:, None, None, None], columns, 0.0)
    if not outliers.expected:
        curvature, told = _accumulate(columns, safe, np.ones(shape[:2]), prior)
        mean = np.linalg.solve(curvature, told[..., None])[..., 0]
        return _conclude(error, columns, mean, curvature, np.ones(shape[:2]), prior)
    mean = _reweight(safe, columns, outliers, spare, prior)
    residual = safe - _act(columns, mean)
    square = np.einsum("bpk,bpk->bp", residual, residual)
    trust = outliers.trust(square, spare)
    curvature = _accumulate(columns, residual, trust, prior)[0]
    pulled = np.einsum("bpkn,bpk->bpn", columns, residual, optimize=True)
    softer = curvature - np.swapaxes(pulled, -1, -2) @ (outliers.soften(square, spare)[..., None] * pulled)
    # as at every mode; elsewhere the weights' own curvature
    definite = np.linalg.eigvalsh(softer)[:, 0] > 0.0 if signs is None else np.zeros(len(softer), dtype=bool)
    curvature = np.where(definite[:, None, None], softer, curvature)
    return _conclude(error, columns, mean, curvature, trust, prior)


def _conclude(
    error: Array, columns: Array, mean: Array, curvature: Array, trust: Array, signs: Array | float
) -> Coefficients:
    if np.ndim(signs):  # the curvature is that of no maximum; the determinant of the prior is one or minus one
        log_volume = -0.5 * np.linalg.slogdet(curvature)[1]
    else:
        log_volume = -half_log_det(factorise(curvature.copy()))
    return Coefficients(mean, curvature, log_volume, error - _act(columns, mean), trust, columns, signs)


def _reweight(error: Array, columns: Array, outliers: Outliers, spare: np.ndarray, signs: Array | float) -> Array:
    """Return û, shape (B, N), by iteratively reweighted least squares."""
    mean = np.zeros((len(error), columns.shape[-1]))
    going = np.arange(len(error))
    for _ in range(MAX_ITERATIONS):
        own = columns[going]
        residual = error[going] - _act(own, mean[going])
        trust = outliers.pick(going).trust(np.einsum("bpk,bpk->bp", residual, residual), spare)
        curvature, told = _accumulate(own, residual, trust, signs)
        step = np.linalg.solve(curvature, (told - signs * mean[going])[..., None])[..., 0]
        mean[going] += step
        going = going[np.abs(step).max(axis=-1, initial=0.0) > STEP_TOLERANCE]
        if not len(going):
            break
    return mean


def _accumulate(columns: Array, rows: Array, trust: Array, signs: Array | float = 1.0) -> tuple[Array, Array]:
    """Return 1 + AᵀWA and AᵀW times rows (B, P, m); signs instead of ones."""
    if (trust != 1.0).any():
        root = np.sqrt(trust)[..., None]
        columns, rows = root[..., None] * columns, root * rows
    flat = _flatten(columns)
    turned = np.swapaxes(flat, -1, -2)
    curvature = turned @ flat
    curvature[..., *np.diag_indices(flat.shape[-1])] += signs
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
    try:
        root = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:  # of rows whose scales lie further apart than the share, or that are not finite
        root = np.swapaxes(np.linalg.qr(np.swapaxes(flat, -1, -2), mode="r"), -1, -2)
    return root.reshape(*shape, -1)
