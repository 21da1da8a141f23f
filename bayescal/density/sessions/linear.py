"""Sessions linearised at a state: the state is integrated in closed form, for any model errors and drift scales.

With rows r = c + J u of all poses, u the deviations of the sessions' parameters and the coefficients of expansion, and
the state z standard normal, the density of the data given τ and σ is normal; A = 1 + Jᵀ C⁻¹ J, put together from one
matrix of each session, is all that it takes. The states of all sessions are solved for at once: a chain of them
would take turns of a smoother, but what is shared by all sessions joins every link, and A stays small, since only what
may move stands in it more than once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from bayescal.density.sessions.model import Part, SessionModel
from bayescal.density.sessions.rows import LinearRows
from bayescal.errors import NumericalError
from bayescal.numerics.geometry import Array

STEPS = 30
SMALL = 1e-7  # of a state in prior standard deviations, below which a step no longer matters


@dataclass(frozen=True, eq=False)
class Conditional:
    """The state given model errors and drift scales: normal.

    Attributes
    ----------
    mean : ndarray, shape (n,)
    factor : ndarray, shape (n, n)
        Lower Cholesky factor of its precision A.
    log_marginal : float
        Log-density of the data, the state integrated.
    """

    mean: Array
    factor: Array
    log_marginal: float

    def draw(self, normal: Array) -> Array:
        """Return states (n,) or (n, B) for standard normal numbers of that shape."""
        moved = np.linalg.solve(self.factor.T, normal)
        return moved + (self.mean if moved.ndim == 1 else self.mean[:, None])


@dataclass(frozen=True, eq=False)
class LinearSessions:
    """Sessions linearised at a state.

    Attributes
    ----------
    model : SessionModel
    rows : ndarray, shape (P, R, m + A + 1)
        J by the deviations of the session's parameters and by the coefficients less their means, and c.
    covariance : callable
        Takes what is unknown of the errors to the covariances of the rows, (P, R, R).
    constant : ndarray, shape (P,)
    first : ndarray of int, shape (S,)
        First pose of each session.
    """

    model: SessionModel
    rows: Array
    covariance: Callable[[Array], Array]
    constant: Array
    first: np.ndarray

    def gather(self, errors: Array) -> tuple[Array, float]:
        """Return XᵀC⁻¹X of the rows X of each session, shape (S, M, M), and what else the log-density has."""
        factor = np.linalg.cholesky(self.covariance(errors))
        white = np.linalg.inv(factor) @ self.rows
        log_det = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum()
        of_sessions = [one.reshape(-1, one.shape[-1]) for one in np.split(white, self.first[1:])]
        return np.stack([one.T @ one for one in of_sessions]), float(self.constant.sum() - log_det)

    def condition(self, errors: Array, scales: Array) -> Conditional:
        """Return the state's density given what is unknown of the errors, and σ (U,)."""
        gram, rest = self.gather(errors)
        precision, slope, square = self._assemble(gram, scales)
        precision[np.diag_indices_from(precision)] += 1.0
        try:
            factor, _ = cho_factor(precision, lower=True)
        except np.linalg.LinAlgError as error:
            raise NumericalError("sessions: found no joint density at these drift scales") from error
        mean = -cho_solve((factor, True), slope)
        marginal = rest - 0.5 * (square + slope @ mean) - np.log(np.diag(factor)).sum()
        return Conditional(mean, np.tril(factor), float(marginal))

    def _assemble(self, gram: Array, scales: Array) -> tuple[Array, Array, float]:
        """Return JᵀC⁻¹J and JᵀC⁻¹c by the state, and cᵀC⁻¹c."""
        model, n = self.model, len(self.model.mean) + len(self.model.expansions)
        size = np.concatenate([model.sd, [one.sd for one in model.expansions]])
        moves, scale, loadings = model.drift.index, scales[model.drift.unit], model.drift.loadings
        total = gram.sum(axis=0)
        precision, slope = np.empty((model.size, model.size)), np.empty(model.size)
        precision[:n, :n] = total[:n, :n] * np.outer(size, size)
        slope[:n] = total[:n, n] * size
        by_step = np.tensordot(loadings, gram[:, moves], axes=(0, 0)) * scale[:, None]  # (K, d, M)
        precision[n:, :n] = (by_step[..., :n] * size).reshape(-1, n)
        precision[:n, n:] = precision[n:, :n].T
        slope[n:] = by_step[..., n].ravel()
        among = gram[:, moves[:, None], moves] * np.outer(scale, scale)
        pairs = np.einsum("sk,sl->skl", loadings, loadings)
        steps = np.tensordot(pairs, among, axes=(0, 0))  # (K, K, d, d)
        precision[n:, n:] = steps.transpose(0, 2, 1, 3).reshape(model.size - n, model.size - n)
        return precision, slope, float(total[n, n])

    def log_likelihood(self, z: Array, errors: Array, scales: Array) -> float:
        """Return the linearised log-likelihood of one state (n,)."""
        x, alpha = self.model.split(z, scales)
        means = np.array([one.mean for one in self.model.expansions])
        u = np.concatenate([x, np.broadcast_to(alpha - means, (len(x), len(means))), np.ones((len(x), 1))], axis=1)
        gram, rest = self.gather(errors)
        return rest - 0.5 * float(np.einsum("si,sij,sj->", u, gram, u))


def linearise_sessions(model: SessionModel, z: Array, scales: Array) -> LinearSessions:
    """Return sessions linearised at a state (n,) and drift scales (U,)."""
    x, alpha = model.split(z, scales)
    found = [one.rows.linearise(model.theta(one, x, alpha)) for one in model.parts]
    rows = np.concatenate([_combine(model, *both, x, alpha) for both in zip(model.parts, found, strict=True)])
    counts = np.bincount([one.session for one in model.parts], [one.rows.n_poses for one in model.parts])
    first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(int)

    def covariance(errors: Array) -> Array:
        return np.concatenate([one.covariance(errors) for one in found])

    return LinearSessions(model, rows, covariance, np.concatenate([one.constant for one in found]), first)


def _combine(model: SessionModel, part: Part, found: LinearRows, x: Array, alpha: Array) -> Array:
    """Return the rows of a part, shape (P, R, m + A + 1)."""
    errors, slope = found.errors, found.slope
    by_x, by_alpha = model.slopes(part, x, alpha)
    jacobian = slope @ np.concatenate([by_x, by_alpha], axis=1)
    means = np.array([one.mean for one in model.expansions])
    constant = errors - jacobian @ np.concatenate([x[part.session], alpha - means])
    if not np.isfinite(jacobian).all():
        raise NumericalError(f"sessions: session {part.session + 1} has no machine near the priors' centres")
    return np.concatenate([jacobian, constant[..., None]], axis=2)


def find_state(model: SessionModel, errors: Array, scales: Array, z: Array) -> tuple[LinearSessions, Array]:
    """Return sessions linearised at the most probable state given errors and σ, and that state; from z, shape (n,).

    Raises
    ------
    NumericalError
        Where Gauss and Newton's steps do not settle.
    """
    for _ in range(STEPS):
        linear = linearise_sessions(model, z, scales)
        found = linear.condition(errors, scales).mean
        if np.abs(found - z).max() < SMALL:
            return linear, found
        z = found
    raise NumericalError(f"sessions: Gauss-Newton did not settle in {STEPS} steps")
