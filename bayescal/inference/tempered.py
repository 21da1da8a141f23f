"""Evidence and draws by sequential Monte Carlo from the prior to the posterior: owes nothing to the search for modes.

Draws of the prior p(y) are led through p(y) L(y)^β from β = 0 to 1 (Del Moral, Doucet and Jasra 2006). Each β is chosen
so that half of the draws count in the next density. Chains from resampled draws are long enough to forget where they
started, and all their states are the next density's draws (Dau and Chopin 2022, "waste-free"). They mix three moves:
independent draws of a mixture fitted to the cloud, steps of the size and shape of one of its components, and
differences of two draws.

The last draws are those of the posterior; the evidence is that of a bridge (Meng and Wong 1996) from them to a mixture
fitted to another run's, finer by an order than the product of the mean weights. Standard errors come from independent
runs.

Of wrong answers in `benchmarks/ablation` that can be drawn from their priors it alone tells one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp

from bayescal.errors import NumericalError
from bayescal.inference.bridge import iterate_bridge
from bayescal.inference.importance import evaluate_in_batches
from bayescal.inference.proposal import MixtureProposal, fit_mixture
from bayescal.inference.stages import stage
from bayescal.inference.target import PriorSampleable
from bayescal.numerics.geometry import Array

USEFUL = 0.5  # share of effective draws from one temperature to the next
FORGOTTEN = 0.1  # largest correlation of a chain's state with its start
SHORTEST, LONGEST = 8, 400  # steps of a chain
AT_LAST = 100  # steps at the least at β = 1, whose draws the bridge stands on
ROUNDS = 20  # of chains at one temperature
DRIFT = 3.0  # standard errors of a mean
CLOUD = 2000  # draws that a mixture is fitted to
MOVES = ("independent", "local", "difference")
SHARES = (0.4, 0.2, 0.4)
ACROSS = 0.2  # share of differences taken whole, which lead from one cluster to another
LEAST_STEP = 1e-12  # of β
CHAINS, RUNS = 512, 8


@dataclass(frozen=True, eq=False)
class TemperedEvidence:
    """What sequential Monte Carlo found of a posterior of n coordinates."""

    # of the mean over independent runs by the bridge, and its standard error from their scatter
    log_evidence: float
    standard_error: float
    y: Array  # (S, n): draws in sampling coordinates, all runs together
    weights: Array  # (S,): their weights, which add up to one
    mixed: bool  # whether all chains forgot their starts
    n_draws: tuple[int, ...]  # of each run, in order


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Draws y (B, n) of p L^β with log-prior and log-likelihood, both (B,)."""

    y: Array
    log_prior: Array
    log_likelihood: Array

    def take(self, chosen: np.ndarray) -> _Cloud:
        return _Cloud(self.y[chosen], self.log_prior[chosen], self.log_likelihood[chosen])


@dataclass(frozen=True, eq=False)
class _Run:
    cloud: _Cloud
    mixture: MixtureProposal
    mixed: bool


def estimate_by_tempering(
    target: PriorSampleable, seed: np.random.SeedSequence, n_chains: int = CHAINS, n_runs: int = RUNS
) -> TemperedEvidence:
    """Return the log-evidence of a target, and draws of it, from independent runs that start from its prior.

    Parameters
    ----------
    target : Prospect
    seed : SeedSequence
    n_chains : int
        Chains of each run at each temperature.
    n_runs : int
        At least two.

    Raises
    ------
    NumericalError
        Where hardly any draw of the prior has a density.
    """
    rngs = [np.random.default_rng(own) for own in seed.spawn(n_runs)]
    with stage("tempering"):
        runs = [_run(target, rng, n_chains) for rng in rngs]
        others = [runs[-1], *runs[:-1]]  # a mixture fitted to the draws themselves would be too dense right there
        bridges = [_bridge(target, r.cloud, o.mixture, n_chains, g) for r, o, g in zip(runs, others, rngs, strict=True)]
    mean = float(logsumexp(bridges) - np.log(n_runs))
    return TemperedEvidence(
        mean,
        float(np.std(np.exp(np.array(bridges) - mean), ddof=1) / np.sqrt(n_runs)),
        np.concatenate([run.cloud.y for run in runs]),
        np.concatenate([np.full(len(run.cloud.y), 1.0 / (len(run.cloud.y) * n_runs)) for run in runs]),
        all(run.mixed for run in runs),
        tuple(len(run.cloud.y) for run in runs),
    )


def _run(target: PriorSampleable, rng: np.random.Generator, n_chains: int) -> _Run:
    cloud = _evaluate(target, target.draw_prior(n_chains * SHORTEST * 2, rng))
    beta, mixed = 0.0, True
    while beta < 1.0:
        rise = _choose_rise(cloud.log_likelihood, 1.0 - beta)
        log_weights = rise * cloud.log_likelihood
        beta = min(1.0, beta + rise)
        cloud, settled = _settle(target, cloud, np.exp(log_weights - logsumexp(log_weights)), beta, n_chains, rng)
        mixed = mixed and settled
    mixture = _fit(cloud, np.full(len(cloud.y), 1.0 / len(cloud.y)), n_chains, rng)
    return _Run(cloud, mixture, mixed)


def _fit(cloud: _Cloud, weights: Array, n_chains: int, rng: np.random.Generator) -> MixtureProposal:
    """Return a mixture fitted to the weighted states of chains, thinned in time where they are many."""
    n_steps = len(cloud.y) // n_chains
    kept = np.unique(np.linspace(0, n_steps - 1, max(2, CLOUD // n_chains)).astype(int))
    chosen = (kept[:, None] * n_chains + np.arange(n_chains)).ravel()
    chosen = chosen[weights[chosen] > 0.0]
    chain = chosen % n_chains
    return fit_mixture(cloud.y[chosen], weights[chosen] / weights[chosen].sum(), chain % 2 == 0, rng)


def _bridge(
    target: PriorSampleable, cloud: _Cloud, mixture: MixtureProposal, n_chains: int, rng: np.random.Generator
) -> float:
    """Return the log-evidence from draws of the posterior and as many of a mixture that was fitted to others."""
    proposed = mixture.draw(len(cloud.y), rng)
    there = _evaluate(target, proposed)
    ours = cloud.log_prior + cloud.log_likelihood - mixture.log_density(cloud.y)
    theirs = there.log_prior + there.log_likelihood - mixture.log_density(proposed)
    offset = float(np.median(ours))
    log_evidence, converged = iterate_bridge(ours - offset, theirs - offset, float(n_chains))
    if not converged:
        raise NumericalError("tempering: bridge did not converge")
    return log_evidence + offset


def _evaluate(target: PriorSampleable, y: Array) -> _Cloud:
    """Return a cloud at vectors (B, n); those that are not finite, or no machine, have no likelihood."""
    there = np.isfinite(y).all(axis=1)
    inside = np.where(there[:, None], y, 0.0)
    with np.errstate(all="ignore"):
        prior = evaluate_in_batches(target.log_prior, inside)
        density = evaluate_in_batches(target.log_density, inside)
    known = there & np.isfinite(density) & np.isfinite(prior)
    return _Cloud(y, np.where(known, prior, -np.inf), np.where(known, density - np.where(known, prior, 0.0), -np.inf))


def _choose_rise(log_likelihood: Array, left: float) -> float:
    """Return by how much β may rise, at most what is left, so that half of the draws count.

    Raises
    ------
    NumericalError
        Where even the smallest rise leaves too few.
    """

    def excess(log_rise: float) -> float:
        log_weights = np.exp(log_rise) * log_likelihood
        return float(np.exp(2.0 * logsumexp(log_weights) - logsumexp(2.0 * log_weights))) - USEFUL * n_known

    n_known = int(np.isfinite(log_likelihood).sum())
    if n_known < 10:
        raise NumericalError(f"tempering: {n_known} of {len(log_likelihood)} prior draws have a density")
    if excess(np.log(left)) >= 0.0:
        return left
    low = np.log(LEAST_STEP)
    while excess(low) < 0.0:
        low -= 10.0
    return float(np.exp(brentq(excess, low, np.log(left), xtol=1e-6)))


def _resample(weights: Array, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return n positions by systematic resampling, in random order."""
    edges = np.cumsum(weights)
    chosen = np.searchsorted(edges / edges[-1], (rng.random() + np.arange(n)) / n)
    return rng.permutation(np.minimum(chosen, len(weights) - 1))


def _settle(
    target: PriorSampleable, cloud: _Cloud, weights: Array, beta: float, n_chains: int, rng: np.random.Generator
) -> tuple[_Cloud, bool]:
    """Return the draws of p L^β that come of a weighted cloud: rounds of chains until one neither remembers nor drifts.

    Where the mass moves from one region to another between two temperatures, as into the narrow end of a funnel, the
    first rounds carry the draws over.
    """
    here = cloud.take(_resample(weights, n_chains, rng))
    for round_ in range(ROUNDS):
        pairs = cloud.y[_resample(weights, CLOUD, rng)]
        mover = _Mover(pairs, _fit(cloud, weights, n_chains, rng), rng)
        last, cloud, forgotten = _move(target, here, beta, mover)
        weights = np.full(len(cloud.y), 1.0 / len(cloud.y))
        settled = forgotten and not _have_drifted(here, last)
        if settled and (beta < 1.0 or round_):
            break
        here = last
    return cloud, settled


def _have_drifted(first: _Cloud, last: _Cloud) -> bool:
    """Return whether means of coordinates or likelihood moved by more than chance."""
    before, after = (np.column_stack([c.y, c.log_likelihood]) for c in (first, last))
    error = np.sqrt((before.var(axis=0) + after.var(axis=0)) / len(before))
    return bool((np.abs(after.mean(axis=0) - before.mean(axis=0)) > DRIFT * error).any())


def _move(target: PriorSampleable, first: _Cloud, beta: float, mover: _Mover) -> tuple[_Cloud, _Cloud, bool]:
    """Return the last and all states of chains on p L^β, and whether they forgot their starts."""
    here, states, enough, scale = first, list[_Cloud](), LONGEST, 1.0
    for step in range(1, LONGEST + 1):
        here, moved = _step(target, here, beta, mover, scale)
        scale *= np.exp(moved / np.sqrt(step)) if np.isfinite(moved) else 1.0
        states.append(here)
        if enough == LONGEST and _have_forgotten(first, here):
            enough = max(AT_LAST if beta == 1.0 else SHORTEST, 2 * step)
        if step >= enough:
            break
    names = ("y", "log_prior", "log_likelihood")
    return here, _Cloud(*(np.concatenate([getattr(s, name) for s in states]) for name in names)), enough < LONGEST


def _have_forgotten(first: _Cloud, here: _Cloud) -> bool:
    """Return whether no coordinate, nor the likelihood, has much to do any more with what it was at first."""
    before, after = (np.column_stack([c.y, c.log_likelihood]) for c in (first, here))
    before, after = before - before.mean(axis=0), after - after.mean(axis=0)
    size = np.sqrt((before**2).sum(axis=0) * (after**2).sum(axis=0))
    correlation = (before * after).sum(axis=0) / np.where(size > 0.0, size, 1.0)
    return bool(correlation.max() < FORGOTTEN + 2.0 / np.sqrt(len(before)))


def _step(target: PriorSampleable, here: _Cloud, beta: float, mover: _Mover, scale: float) -> tuple[_Cloud, float]:
    """Return the chains after one move; and, of local moves, how much too often they were accepted, otherwise NaN."""
    kind = mover.rng.choice(MOVES, p=SHARES)
    proposed, log_ratio = mover.propose(str(kind), here.y, scale)
    there = _evaluate(target, proposed)
    gain = there.log_prior - here.log_prior + beta * (there.log_likelihood - here.log_likelihood) + log_ratio
    accepted = np.log(mover.rng.random(len(gain))) < np.where(np.isfinite(gain), gain, -np.inf)
    moved = _Cloud(
        np.where(accepted[:, None], there.y, here.y),
        np.where(accepted, there.log_prior, here.log_prior),
        np.where(accepted, there.log_likelihood, here.log_likelihood),
    )
    return moved, float(accepted.mean()) - 0.3 if kind == "local" else np.nan


@dataclass(frozen=True, eq=False)
class _Mover:
    """Proposals shaped by a cloud of draws (C, n) and the mixture fitted to it."""

    cloud: Array
    mixture: MixtureProposal
    rng: np.random.Generator

    def propose(self, kind: str, y: Array, scale: float) -> tuple[Array, Array]:
        """Return proposals (B, n) and the logarithm (B,) of backward over forward probability."""
        propose = {"independent": self._independent, "local": self._local, "difference": self._difference}
        return propose[kind](y, scale)

    def _independent(self, y: Array, scale: float) -> tuple[Array, Array]:
        del scale
        drawn = self.mixture.draw(len(y), self.rng)
        return drawn, self.mixture.log_density(y) - self.mixture.log_density(drawn)

    def _local(self, y: Array, scale: float) -> tuple[Array, Array]:
        """Step by the shape of a component that is likely where the chain is; it has to be so where it goes, too."""
        terms = self.mixture.component_log_densities(y)
        share = np.exp(terms - logsumexp(terms, axis=0))
        component = (np.cumsum(share, axis=0) < self.rng.random(len(y))).sum(axis=0).clip(max=len(share) - 1)
        length = scale * 2.38 / np.sqrt(y.shape[1]) * np.exp(-self.rng.exponential(size=(len(y), 1)))
        normal = self.rng.standard_normal(y.shape) * length
        proposed = y + np.einsum("bij,bj->bi", self.mixture.factors[component], normal)
        after = self.mixture.component_log_densities(proposed)
        rows = np.arange(len(y))
        back = after[component, rows] - logsumexp(after, axis=0)
        return proposed, back - np.log(np.maximum(share[component, rows], 1e-300))

    def _difference(self, y: Array, scale: float) -> tuple[Array, Array]:
        """Add a multiple of the difference of two draws of the cloud, in all coordinates or in some of them."""
        del scale
        one, other = self.cloud[self.rng.integers(len(self.cloud), size=(2, len(y)))]
        some = self.rng.random(y.shape) < self.rng.choice([0.0, 0.3, 1.0], size=(len(y), 1))
        some[np.arange(len(y)), self.rng.integers(y.shape[1], size=len(y))] = True
        whole = some.all(axis=1) & (self.rng.random(len(y)) < ACROSS)
        shorter = 2.38 / np.sqrt(2.0 * some.sum(axis=1)) * np.exp(-self.rng.exponential(size=len(y)))
        factor = np.where(whole, 1.0, shorter)
        return y + some * factor[:, None] * (one - other), np.zeros(len(y))
