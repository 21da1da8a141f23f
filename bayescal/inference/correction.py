"""Draws and evidence of a density that is too costly to be explored, from those of one close to it.

With p what was explored, q the costly density and T an affine map, moved draws T x have the weights
w(x) = q(T x) |T| / p(x): their mean over draws x of p is the ratio of the evidences (Jarzynski 2002), and where they
hardly differ the moved draws are draws of q. T takes the mean and the covariance of p, in coordinates in which p is
close to a normal, to those of q: the covariance by what the information of q is more than that of p, the mean by the
slope of log q - log p, a regression on some draws. The weights are those of other draws; their scatter is the error.
Where p has several modes T is a translation, which takes all of them along.

Without it the evidence of the telescope's six_pus/matrix is 1.97 nats low and a quantile 0.61 standard deviations off,
unreported (`benchmarks/ablation`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from bayescal.errors import NumericalError
from bayescal.inference.ensemble import run_ensembles
from bayescal.inference.exploration import Exploration
from bayescal.inference.importance import LogDensity, resample, smooth_weights
from bayescal.inference.proposal import MixtureProposal
from bayescal.inference.reparameterisation import Reparameterisation
from bayescal.inference.sampling import Sample
from bayescal.limits import ALIKE_LIMIT, MOVED_LIMIT, PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

PER_COORDINATE = 3  # draws for a regression
GOOD_EFFICIENCY = 0.8
"""Share of effective draws from which on another round is not worth its evaluations."""
ROUNDS = 3
BLOCK = 32  # draws that are weighed between looks at the error, where one is enough
WEIGHED = 256  # draws of a posterior, a round
PROPOSED = 1500
USED = 1024  # at most
WEIGHED_AT_ONCE, PER_COORDINATE_AT_ONCE, PROPOSED_AT_ONCE = 128, 2, 1000
"""The same where only the evidence is wanted, and the draws of a regression."""
KNOWN_ENOUGH = 0.02
"""Standard error in nats that is enough then: evidences under other priors are themselves known to 0.03."""
CORRECTION_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class Move:
    """The affine map T x = mean + matrix (x - centre) of vectors (B, n)."""

    centre: Array
    mean: Array
    matrix: Array

    def __call__(self, x: Array) -> Array:
        """Return T x, shape (B, n)."""
        return np.asarray(self.mean + (x - self.centre) @ self.matrix.T)

    @property
    def log_volume(self) -> float:
        """Logarithm of |T|."""
        return float(np.linalg.slogdet(self.matrix)[1])

    def move_proposal(self, proposal: MixtureProposal) -> MixtureProposal:
        """Return the density of moved draws of a proposal."""
        factors = np.linalg.cholesky(self.matrix @ proposal.factors @ np.swapaxes(self.matrix @ proposal.factors, 1, 2))
        return replace(proposal, means=self(proposal.means), factors=factors)

    def shifted(self, by: Array) -> Move:
        """Return the map that leads on by a vector (n,)."""
        return Move(self.centre, self.mean + by, self.matrix)

    def then(self, other: Move) -> Move:
        """Return the map that leads by this one, and on by another."""
        return Move(self.centre, other(self.mean[None])[0], other.matrix @ self.matrix)


@dataclass(frozen=True, eq=False)
class Correction:
    """What leads from the explored density to the costly one."""

    move: Move  # of draws
    # log of the ratio of the evidences and its standard error
    log_ratio: float
    standard_error: float
    efficiency: float  # effective over actual number of moved draws
    pareto_k: float  # shape of the tail of their weights
    n_draws: int  # number of draws that the weights are of

    @property
    def is_enough(self) -> bool:
        """Whether another round would hardly make moved draws better."""
        return self.efficiency >= GOOD_EFFICIENCY and self.pareto_k <= PARETO_K_LIMIT

    def is_known_to(self, error: float) -> bool:
        """Whether the log-ratio has a standard error that is that small, by weights whose scatter tells it."""
        return 0.0 < error >= self.standard_error and self.pareto_k <= PARETO_K_LIMIT

    @property
    def is_trusted(self) -> bool:
        """Whether moved draws are good for draws of the costly density."""
        is_alike = ALIKE_LIMIT <= self.efficiency <= 1.0 + 1e-9  # more: rounding
        return is_alike or (self.efficiency >= MOVED_LIMIT and self.pareto_k <= PARETO_K_LIMIT)


@dataclass(frozen=True, eq=False)
class CostlyDensity:
    """A density q beside the one p that was explored, in coordinates x of n entries."""

    explored: LogDensity  # log p, (B, n) to (B,)
    excess: LogDensity  # log q - log p, (B, n) to (B,)
    information: Array  # (n, n): of q more than of p, minus the Hessian of the excess, around the main mode

    def log_density(self, x: Array) -> Array:
        """Return log q, shape (B,), for vectors (B, n)."""
        explored = self.explored(x)
        result = np.full(len(x), -np.inf)
        good = np.isfinite(explored)
        if good.any():
            result[good] = explored[good] + self.excess(x[good])
        return result

    def weigh(self, move: Move, x: Array) -> Array:
        """Return the log-weights (B,) of moved draws (B, n)."""
        return self.log_density(move(x)) - self.explored(x) + move.log_volume


def correct(
    density: CostlyDensity,
    draws: Array,
    modes: np.ndarray,
    covariance: Array,
    n_weights: int,
    per_coordinate: int = PER_COORDINATE,
    enough: float = 0.0,
) -> Correction:
    """Return the correction from independent draws of the explored density.

    Parameters
    ----------
    density : CostlyDensity
    draws : ndarray, shape (S, n)
        In random order; at most ROUNDS + 1 parts of them are used, each once.
    modes : ndarray of int, shape (S,)
        Which mode each draw belongs to.
    covariance : ndarray, shape (n, n)
        Of the explored density around a mode.
    n_weights : int
        How many draws are weighed in a round, at most; half as many, or as a regression needs, are used for the first
        one.
    per_coordinate : int
        Draws that a regression needs.
    enough : float
        Standard error of the log-ratio from which on no other draw is weighed. To stop there biases it by a small part
        of that error.

    Raises
    ------
    NumericalError
        Where no draw has a finite weight.
    """
    n = draws.shape[1]
    n_first = min(max(n_weights // 2, per_coordinate * n), len(draws) // 2)
    labels, which = np.unique(modes, return_inverse=True)
    centred = draws - np.stack([draws[which == k].mean(axis=0) for k in range(len(labels))])[which]
    excess, stays = np.empty(0), Move(np.zeros(n), np.zeros(n), np.eye(n))
    for part in np.split(draws[:n_first], range(BLOCK, n_first, BLOCK)) if enough else [draws[:n_first]]:
        excess = np.concatenate([excess, density.excess(part)])
        found = [_summarise(stays, excess)]
        if found[0].is_known_to(enough):
            return found[0]
    move = _fit_move(density, draws.mean(axis=0), centred[:n_first], excess, covariance, bool(np.ptp(modes)))
    for start in range(n_first, min(n_first + ROUNDS * n_weights, len(draws)), n_weights):
        log_weights = _weigh(density, move, draws[start : start + n_weights], enough)
        found.append(_summarise(move, log_weights))
        if found[-1].is_enough or found[-1].is_known_to(enough):
            break
        spread = move.matrix @ covariance @ move.matrix.T
        used = centred[start : start + len(log_weights)]
        move = move.shifted(spread @ _regress(log_weights, used @ move.matrix.T))
    best = max(found, key=lambda correction: correction.efficiency)
    if not np.isfinite(best.log_ratio):
        raise NumericalError("exact density: no finite weight")
    return best


def weigh_both(
    densities: tuple[CostlyDensity, CostlyDensity],
    moves: tuple[Move, Move],
    known: Correction,
    draws: Array,
    enough: float,
) -> Correction:
    """Return the correction to the second of two densities from that to the first, by the same draws of both.

    The ratio of both means has a far smaller error than either, as their weights differ little.

    Parameters
    ----------
    densities, moves
        Densities beside the explored one, with the maps to them.
    known : Correction
        To the first.
    draws : ndarray, shape (B, n)
        Of the explored density. No more of them are weighed than are enough.
    enough : float
        Standard error of the ratio of both, in nats.
    """
    weights, error = np.empty((2, 0)), np.inf
    while weights.shape[1] < min(WEIGHED, len(draws)) and not 0.0 < error <= enough:
        block = draws[weights.shape[1] : weights.shape[1] + BLOCK]
        more = [density.weigh(move, block) for density, move in zip(densities, moves, strict=True)]
        weights = np.concatenate([weights, more], axis=1)
        means = logsumexp(weights, axis=1) - np.log(weights.shape[1])
        with np.errstate(invalid="ignore"):
            first, second = np.exp(weights - means[:, None])
        error = float(np.std(second - first, ddof=1) / np.sqrt(weights.shape[1]))
    own = _summarise(moves[1], weights[1])
    log_ratio = known.log_ratio + float(means[1] - means[0])
    return replace(own, log_ratio=log_ratio, standard_error=float(np.hypot(known.standard_error, error)))


def _weigh(density: CostlyDensity, move: Move, draws: Array, enough: float) -> Array:
    """Return the log-weights of moved draws (B, n), or of as many as are enough for that error."""
    if not enough:
        return density.weigh(move, draws)
    log_weights = np.empty(0)
    while len(log_weights) < len(draws) and not _summarise(move, log_weights).is_known_to(enough):
        block = draws[len(log_weights) : len(log_weights) + BLOCK]
        log_weights = np.concatenate([log_weights, density.weigh(move, block)])
    return log_weights


def _fit_move(
    density: CostlyDensity, centre: Array, x: Array, excess: Array, covariance: Array, translate: bool
) -> Move:
    """Return the map between the normals nearest to both densities, from draws (B, n) about their modes' centres."""
    old = np.linalg.inv(covariance)
    new = old + density.information
    if not np.linalg.eigvalsh(new)[0] > 0.0:
        new = old
    flat = excess + 0.5 * np.einsum("bi,ij,bj->b", x, new - old, x)
    shift = np.linalg.solve(new, _regress(flat, x))
    if translate:
        return Move(centre, centre + shift, np.eye(len(centre)))
    return Move(centre, centre + shift, np.linalg.solve(np.linalg.cholesky(new).T, np.linalg.cholesky(old).T))


def _regress(values: Array, x: Array) -> Array:
    """Return the slope (n,) of values (B,) over vectors (B, n); what is not finite is left out."""
    good = np.isfinite(values)
    if good.sum() <= x.shape[1] + 1:
        return np.zeros(x.shape[1])
    design = np.column_stack([np.ones(good.sum()), x[good]])
    return np.asarray(np.linalg.lstsq(design, values[good])[0][1:])


def _summarise(move: Move, log_weights: Array) -> Correction:
    n_draws = len(log_weights)
    if not np.isfinite(log_weights).any():
        return Correction(move, -np.inf, np.inf, 0.0, np.inf, n_draws)
    log_ratio = float(logsumexp(log_weights)) - np.log(n_draws)
    relative = np.exp(log_weights - log_ratio)
    error = float(np.std(relative, ddof=1) / np.sqrt(n_draws))
    _, pareto_k = smooth_weights(log_weights[np.isfinite(log_weights)])
    return Correction(move, float(log_ratio), error, float(1.0 / np.mean(relative**2)), pareto_k, n_draws)


# --- an explored posterior corrected --------------------------------------------------------------------------------


def correct_draws(
    costly: CostlyDensity, exploration: Exploration, sample: Sample, seed: np.random.SeedSequence
) -> Correction:
    """Return the correction from draws of the posterior."""
    draws = sample.straight.reshape(-1, sample.straight.shape[-1])
    chosen = np.random.default_rng(seed).choice(len(draws), min(USED, len(draws)), replace=False)
    modes = _sort(exploration, draws)
    centred = np.concatenate([own - own.mean(axis=0) for k in np.unique(modes) for own in (draws[modes == k],)])
    covariance = np.atleast_2d(np.cov(centred.T))
    return correct(costly, draws[chosen], modes[chosen], covariance, WEIGHED)


def correct_evidence(
    costly: CostlyDensity, exploration: Exploration, seed: np.random.SeedSequence, enough: float = KNOWN_ENOUGH
) -> Correction:
    """Return the correction from some draws of the proposal, to a standard error in nats that is enough."""
    drawn = draw_to_correct(exploration, np.random.default_rng(seed), USED // 2, PROPOSED_AT_ONCE)
    return correct(costly, *drawn, WEIGHED_AT_ONCE, PER_COORDINATE_AT_ONCE, enough)


def draw_to_correct(
    exploration: Exploration, rng: np.random.Generator, n_draws: int, n_proposed: int = PROPOSED
) -> tuple[Array, np.ndarray, Array]:
    """Return draws of the posterior (S, n) in straight coordinates, their modes (S,), a mode's covariance (n, n)."""
    proposal = exploration.proposal
    draws = resample(exploration.straight.log_density, proposal, rng, n_proposed, n_draws).draws
    main = proposal.factors[np.argmax(proposal.weights)]
    return draws, _sort(exploration, draws), main @ main.T


def _sort(exploration: Exploration, draws: Array) -> np.ndarray:
    """Return which peak of the proposal each draw (S, n) belongs to, shape (S,).

    Components about one centre, of which some are wider, are one peak.
    """
    proposal = exploration.proposal
    _, peak = np.unique(proposal.means, axis=0, return_inverse=True)
    if not peak.any():
        return np.zeros(len(draws), dtype=int)
    return np.asarray(peak.ravel()[np.argmax(proposal.component_log_densities(draws), axis=0)])


def move_sample(sample: Sample, exploration: Exploration, correction: Correction) -> Sample:
    """Return a sample whose draws are those of the costly density, as far as the correction is enough."""
    moved = correction.move(sample.straight.reshape(-1, sample.straight.shape[-1])).reshape(sample.straight.shape)
    density = sample.log_density - correction.move.log_volume + correction.log_ratio
    return Sample(exploration.straight, moved, density, sample.acceptance)


def sample_exactly(
    costly: CostlyDensity, exploration: Exploration, sample: Sample, move: Move, seeds: list[np.random.SeedSequence]
) -> Sample:
    """Return draws of ensembles that walk on the costly density itself, as many as a sample has: slow.

    They start from the moved proposal; half as many steps again are left out at first.
    """
    straight, (_, n_walkers, n_steps, _) = exploration.straight, sample.straight.shape
    density, proposal = costly.log_density, move.move_proposal(exploration.proposal)
    ensembles = run_ensembles(density, proposal, seeds, n_walkers, n_steps // 2, n_steps)
    return Sample.from_ensembles(straight, ensembles)


def pull_back(straight: Reparameterisation, y: Array, information: Array) -> Array:
    """Return information on the geometry's coordinates (m, m), at y (n,), as that on all straight ones (n, n)."""
    x, unit = straight.x_from_y(y[None]), CORRECTION_STEP * np.eye(len(y))
    slope = (straight.y_from_x(x + unit) - straight.y_from_x(x - unit))[:, : len(information)].T / (2 * CORRECTION_STEP)
    found = slope.T @ information @ slope
    return np.asarray(0.5 * (found + found.T))
