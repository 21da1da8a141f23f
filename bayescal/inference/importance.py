"""Evidence by importance sampling from a heavy-tailed proposal: every draw independent, no chain involved."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayescal.errors import NumericalError
from bayescal.inference.proposal import MixtureProposal
from bayescal.inference.stages import count, stage
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

type LogDensity = Callable[[Array], Array]

BATCH = 256
FEWEST_WEIGHTS = 25  # a fifth of them is a tail that a distribution can be fitted to
NO_PARETO = 1000.0  # beyond every limit, and a number in every file
WORTH_ANOTHER = 0.05  # efficiency below which another proposal is tried

AT_ONCE = 2**14  # points, a multiple of a batch: all those of hundreds of coordinates would take gigabytes


@dataclass(frozen=True)
class ImportanceEvidence:
    """Log-evidence by importance sampling, with its quality."""

    # estimate and its standard error
    log_evidence: float
    standard_error: float
    efficiency: float  # effective over actual number of draws
    pareto_k: float  # shape of the tail of the weights; above 0.7 the standard error is not to be trusted
    n_draws: int  # number of draws used

    @property
    def is_doubtful(self) -> bool:
        """Whether the weights have so heavy a tail, or so few of them count, that another proposal is worth a try."""
        return not (self.pareto_k <= PARETO_K_LIMIT and self.efficiency >= WORTH_ANOTHER)

    def is_better_than(self, other: ImportanceEvidence) -> bool:
        """Return whether more of its draws count, with a tail that is light or lighter."""
        return self.efficiency > other.efficiency and self.pareto_k <= max(other.pareto_k, PARETO_K_LIMIT)


def evaluate_in_batches(log_density: LogDensity, y: Array) -> Array:
    """Return the log-density (B,) of many vectors (B, n), in batches that stay in the cache."""
    found = []
    for k in range(0, len(y), BATCH):
        found.append(log_density(y[k : k + BATCH]))
        count(len(found[-1]))
    return np.concatenate(found)


def smooth_weights(log_weights: Array) -> tuple[Array, float]:
    """Return Pareto-smoothed log-weights (B,), normalised, and the shape k of their tail; all are finite.

    Where they are few, or no Pareto distribution fits so heavy a tail in floats, they are as they were and k is
    `NO_PARETO`.
    """
    from arviz_stats.base import array_stats  # seconds to import, for those who sample

    smoothed, pareto_k = log_weights, NO_PARETO
    if len(log_weights) >= FEWEST_WEIGHTS:
        found, k = log_weights, np.nan
        with np.errstate(all="ignore"), suppress(ValueError):  # of a tail of equal weights
            found, k = array_stats.psislw(-log_weights)  # takes minus them, as log-likelihoods for LOO
        if np.isfinite(k) and np.isfinite(found).all():
            smoothed, pareto_k = found, float(k)
    return np.asarray(smoothed - logsumexp(smoothed)), pareto_k


def estimate_by_importance(
    log_density: LogDensity,
    proposal: MixtureProposal,
    rng: np.random.Generator,
    n_draws: int,
    tolerance_nat: float = 0.0,
    max_draws: int = 0,
) -> ImportanceEvidence:
    """Return the log-evidence from independent draws of the proposal.

    Draws come in blocks of n_draws until the standard error reaches its target or max_draws are used. Stopping on the
    standard error biases the estimate by a small part of it.
    """
    log_weights = np.empty(0)
    while True:
        draws = proposal.draw(n_draws, rng)
        with stage("evidence", n_draws):
            block = evaluate_in_batches(log_density, draws) - proposal.log_density(draws)
        log_weights = np.concatenate([log_weights, block])
        if not np.isfinite(log_weights).any():
            raise NumericalError("importance sampling: no finite density")
        log_evidence = logsumexp(log_weights) - np.log(len(log_weights))
        relative = np.exp(log_weights - log_evidence)
        error = np.std(relative, ddof=1) / np.sqrt(len(relative))
        if error <= tolerance_nat or len(log_weights) + n_draws > max_draws:
            break
    finite = log_weights[np.isfinite(log_weights)]
    _, pareto_k = smooth_weights(finite)
    efficiency = 1.0 / np.mean(relative**2)
    return ImportanceEvidence(float(log_evidence), float(error), float(efficiency), pareto_k, len(log_weights))


@dataclass(frozen=True, eq=False)
class Resampled:
    """Draws of a posterior by resampling those of a proposal."""

    draws: Array  # (T, n)
    # as of `ImportanceEvidence`
    efficiency: float
    pareto_k: float
    log_evidence: float


def resample(
    log_density: LogDensity, proposal: MixtureProposal, rng: np.random.Generator, n_draws: int, n_kept: int
) -> Resampled:
    """Return n_kept draws out of n_draws of the proposal, by their Pareto-smoothed weights."""
    draws = proposal.draw(n_draws, rng)
    with stage("weights", n_draws):
        log_weights = evaluate_in_batches(log_density, draws) - proposal.log_density(draws)
    finite = np.isfinite(log_weights)
    if not finite.any():
        raise NumericalError("importance sampling: no finite density")
    smoothed, pareto_k = smooth_weights(log_weights[finite])
    weights = np.exp(smoothed)
    chosen = rng.choice(np.flatnonzero(finite), n_kept, p=weights / weights.sum())
    log_evidence = float(logsumexp(log_weights[finite]) - np.log(n_draws))
    return Resampled(draws[chosen], float(1.0 / (n_draws * np.sum(weights**2))), pareto_k, log_evidence)


def difference_twice(log_density: LogDensity, centre: Array, factor: Array, step: float) -> tuple[Array, Array]:
    """Return gradient (n,) and Hessian (n, n) in whitened coordinates w, x = centre + factor w, by central differences.

    Both are NaN where the density is not finite at every point.
    """
    _, gradient, hessian = difference_many(log_density, centre[None], factor[None], step)
    return gradient[0], hessian[0]


def difference_many(log_density: LogDensity, centres: Array, factors: Array, step: float) -> tuple[Array, Array, Array]:
    """Return value (L,), gradient (L, k) and Hessian (L, k, k) at L centres (L, n), each along its own k columns.

    Derivatives are by w of x = centre + factor w, with factors (L, n, k), and NaN where the density is not finite at
    every point.
    """
    n_centres, _, k = factors.shape
    first, second = np.triu_indices(k, 1)
    n_points = 1 + 2 * k + 2 * len(first)
    values, at_once = np.empty((n_centres, n_points)), max(1, AT_ONCE // n_centres)
    for start in range(0, n_points, at_once):
        points = _list_points(k, step, first, second, slice(start, min(start + at_once, n_points)))
        x = centres[:, None] + points @ np.swapaxes(factors, 1, 2)
        found = evaluate_in_batches(log_density, x.reshape(-1, x.shape[-1]))
        values[:, start : start + at_once] = found.reshape(n_centres, -1)
    values[~np.isfinite(values).all(axis=1), 1:] = np.nan
    parts = np.split(values, np.cumsum([1, k, k, len(first)]), axis=1)
    middle, up, down, both_up, both_down = parts
    gradient, hessian = (up - down) / (2 * step), np.zeros((n_centres, k, k))
    off = both_up + both_down - (up + down)[:, first] - (up + down)[:, second] + 2 * middle
    hessian[:, first, second] = hessian[:, second, first] = off / (2 * step**2)
    hessian[:, np.arange(k), np.arange(k)] = (up + down - 2 * middle) / step**2
    return middle[:, 0], gradient, hessian


def _list_points(n: int, step: float, first: np.ndarray, second: np.ndarray, part: slice) -> Array:
    """Return some of the points: the centre, steps up and down along each coordinate, then along each pair of them."""
    single, none = np.arange(n), np.full(n, -1)
    one = np.concatenate([[-1], single, single, first, first])[part]
    other = np.concatenate([[-1], none, none, second, second])[part]
    sign = np.repeat([1.0, 1.0, -1.0, 1.0, -1.0], [1, n, n, len(first), len(first)])[part]
    points = np.zeros((len(one), n))
    for which in (one, other):
        rows = np.flatnonzero(which >= 0)
        points[rows, which[rows]] = step * sign[rows]
    return points
