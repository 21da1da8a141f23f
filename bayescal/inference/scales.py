"""A few scales by their marginal density in closed form: mode, proposal, and draws by importance.

In coordinates that are standard normal under the prior a scale that the data do not need has nearly the prior's shape,
and one that they need nearly a normal one: a Student t about the mode, mended once by its own weights, covers both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayescal.errors import NumericalError
from bayescal.inference.importance import Resampled, smooth_weights
from bayescal.inference.proposal import MixtureProposal
from bayescal.numerics.geometry import Array

DOF = 8.0
LIMITS = (-6.0, 8.0)  # of the search: beyond them the prior alone speaks
SMALL_STEP = 1e-8  # of first differences, prior standard deviations
SCALE_STEP = 0.05  # of second ones
LEAST_CURVATURE = 0.3  # of the density; that of the prior is 1
PRIOR_SHARE = 0.1  # of the proposal's draws that are the prior's
ROUNDS = 2  # of mending the proposal by weighted draws
MIN_EFFECTIVE_DRAWS = 3.0  # effective draws for each coordinate, as many as Laplace's covariance counts beside theirs

type LogDensity = Callable[[Array], Array]
"""From coordinates (B, n) to log-densities (B,), the standard normal prior included."""


@dataclass(frozen=True, eq=False)
class Scales:
    """What a marginal density of n coordinates says.

    Attributes
    ----------
    mode : ndarray, shape (n,)
    draws : ndarray, shape (T, n)
    log_evidence, standard_error : float
    efficiency, pareto_k : float
        Of the weights, as of `ImportanceEvidence`.
    """

    mode: Array
    draws: Array
    log_evidence: float
    standard_error: float
    efficiency: float
    pareto_k: float


def find_scales_mode(log_density: LogDensity, start: Array, step: float = SMALL_STEP) -> Array:
    """Return where a log-density of n coordinates is largest, from a start (n,).

    Its slopes are differences over a step, which should not be so small that they are those of its rounding.
    """
    from scipy.optimize import minimize  # a tenth of a second to import, for those who search

    if not len(start):
        return start
    if not np.isfinite(log_density(start[None])[0]):
        raise NumericalError("scales: no density at the start")
    steps = np.concatenate([np.zeros((1, len(start))), step * np.eye(len(start))])

    def evaluate(zeta: Array) -> tuple[float, Array]:
        value, *ahead = -log_density(zeta + steps)
        return value, (np.array(ahead) - value) / step

    with np.errstate(invalid="ignore"):  # differences of what is nowhere
        found = minimize(evaluate, start, jac=True, method="L-BFGS-B", bounds=[LIMITS] * len(start))
    if not np.isfinite(found.fun):
        raise NumericalError("scales: no mode found")
    return np.asarray(found.x)


def measure_volume(log_density: LogDensity, mode: Array) -> float:
    """Return Laplace's log-volume about a mode (n,), in that of the standard normal prior."""
    return 0.5 * float(np.linalg.slogdet(_find_covariance(log_density, mode))[1]) if len(mode) else 0.0


def sample_scales(log_density: LogDensity, mode: Array, n_draws: int, n_kept: int, rng: np.random.Generator) -> Scales:
    """Return evidence and draws of scales, from draws of a proposal about their mode.

    Parameters
    ----------
    log_density : callable
        See `LogDensity`.
    mode : ndarray, shape (n,)
    n_draws, n_kept : int
        Draws of the proposal, and how many of them are kept by their weights.
    rng : Generator
    """
    if not len(mode):
        value = float(log_density(mode[None])[0])
        return Scales(mode, np.empty((n_kept, 0)), value, 0.0, 1.0, 0.0)
    laplace = _find_covariance(log_density, mode)
    proposal = _propose(mode, laplace)
    for _ in range(ROUNDS):
        draws = proposal.draw(max(n_draws // 4, 20 * len(mode)), rng)
        log_weights = _evaluate(log_density, draws) - proposal.log_density(draws)
        weights = np.exp(log_weights - logsumexp(log_weights))
        mean, effective, few = weights @ draws, 1.0 / np.sum(weights**2), MIN_EFFECTIVE_DRAWS * len(mode)
        spread = (draws - mean).T * weights @ (draws - mean)  # few effective draws hardly change Laplace's covariance
        proposal = _propose(mean, (effective * spread + few * laplace) / (effective + few))
    draws = proposal.draw(n_draws, rng)
    log_weights = _evaluate(log_density, draws) - proposal.log_density(draws)
    log_evidence = float(logsumexp(log_weights) - np.log(n_draws))
    error = np.std(np.exp(log_weights - log_evidence), ddof=1) / np.sqrt(n_draws)
    kept = keep_by_weight(draws, log_weights, n_kept, rng)
    return Scales(mode, kept.draws, log_evidence, float(error), kept.efficiency, kept.pareto_k)


def _propose(mean: Array, covariance: Array) -> MixtureProposal:
    """Return a density of that mean and covariance with a share of the prior's, which bounds the weights."""
    n = len(mean)
    factors = np.stack([np.linalg.cholesky(covariance + 1e-9 * np.eye(n)), np.eye(n)])
    return MixtureProposal(np.array([1.0 - PRIOR_SHARE, PRIOR_SHARE]), np.stack([mean, np.zeros(n)]), factors, DOF)


def keep_by_weight(draws: Array, log_weights: Array, n_kept: int, rng: np.random.Generator) -> Resampled:
    """Return n_kept out of draws (T, n) by their Pareto-smoothed weights, with efficiency and k of these."""
    finite = np.isfinite(log_weights)
    if finite.sum() < len(draws) / 2:
        raise NumericalError("scales: too few draws with a density")
    if np.ptp(log_weights[finite]) < 1e-12:  # all alike: nothing to smooth
        return Resampled(draws[rng.choice(len(draws), n_kept)], 1.0, 0.0, float(log_weights[finite].mean()))
    smoothed, pareto_k = smooth_weights(log_weights[finite])
    weights = np.exp(smoothed)
    chosen = rng.choice(np.flatnonzero(finite), n_kept, p=weights / weights.sum())
    log_evidence = float(logsumexp(log_weights[finite]) - np.log(len(draws)))
    return Resampled(draws[chosen], float(1.0 / (len(draws) * np.sum(weights**2))), float(pareto_k), log_evidence)


def _evaluate(log_density: LogDensity, draws: Array) -> Array:
    values = log_density(draws)
    return np.where(np.isfinite(values), values, -np.inf)


def _find_covariance(log_density: LogDensity, mode: Array) -> Array:
    """Return minus the inverse Hessian at the mode by differences, kept no wider than tails need."""
    n = len(mode)
    steps, (i, j) = SCALE_STEP * np.eye(n), np.tril_indices(n, -1)
    points = np.concatenate([np.zeros((1, n)), steps, -steps, steps[i] + steps[j]])
    centre, ahead, behind, both = np.split(log_density(mode + points), [1, 1 + n, 1 + 2 * n])
    hessian = np.diag((ahead - 2.0 * centre + behind) / SCALE_STEP**2)
    hessian[i, j] = hessian[j, i] = (both - ahead[i] - ahead[j] + centre) / SCALE_STEP**2
    values, vectors = np.linalg.eigh(-hessian)
    return np.asarray(vectors / np.maximum(values, LEAST_CURVATURE) @ vectors.T)
