"""Convergence of ensembles: a chain is an ensemble, never a walker.

A walker that stands still tells a third of the wrong answers of `benchmarks/ablation`, one of them alone: without the
conditional map a quantile of a printer is 0.26 standard deviations off.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import ndtri

from bayescal.inference.ensemble import JUMP_SHARE
from bayescal.limits import (
    EFFECTIVE_LIMIT,
    ESS_BULK_LIMIT,
    ESS_TAIL_LIMIT,
    HARMLESS,
    PARETO_K_LIMIT,
    RHAT_LIMIT,
    STUCK_SHARE,
    STUCK_STEPS,
    TEMPERED_LIMIT,
)
from bayescal.numerics.geometry import Array

LEAST_ERROR = 0.01  # nats; a few runs tell no smaller standard error
APART = 100.0  # R-hat of ensembles that stand still at different places

BLOM = 3.0 / 8.0
"""Offset of ranks (Blom 1958)."""
TAILS = (0.05, 0.95)
MET = 3.0  # jumps expected at a place, of which there is one at least in 95 of 100 cases
LEAST = 8  # draws of a chain whose halves are judged

POWERS = (0.99, 1.01)


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """Rank-normalised R-hat and effective sample sizes of each parameter, shape (n,)."""

    rhat: Array
    ess_bulk: Array
    ess_tail: Array

    def list_problems(self) -> list[str]:
        """Return in words which limits are not kept; empty where all are."""
        rhat, bulk, tail = float(self.rhat.max()), float(self.ess_bulk.min()), float(self.ess_tail.min())
        problems = []
        if not rhat < RHAT_LIMIT:
            problems.append(f"R-hat {rhat:.3f}, limit {RHAT_LIMIT}")
        if not bulk > ESS_BULK_LIMIT:
            problems.append(f"bulk ESS {bulk:.0f}, limit {ESS_BULK_LIMIT:.0f}")
        if not tail > ESS_TAIL_LIMIT:
            problems.append(f"tail ESS {tail:.0f}, limit {ESS_TAIL_LIMIT:.0f}")
        return problems


def diagnose(draws: Array) -> Diagnostics:
    """Return the diagnostics of draws, shape (ensembles, walkers, steps, n).

    R-hat splits every ensemble in time, so that a drift of all walkers shows. The effective sizes take the draws walker
    by walker: then the autocorrelation along the chain is that of the walkers in time. A parameter that is the same in
    all draws, a scale that is zero, has nothing to mix, unless all others stand still as well.
    """
    rhat, bulk, tail = judge_draws(draws)
    walker_by_walker = np.moveaxis(draws.reshape(len(draws), -1, draws.shape[-1]), -1, 0)
    still = np.ptp(walker_by_walker, axis=(1, 2)) == 0.0
    if still.any() and not still.all():
        rhat[still], bulk[still], tail[still] = 1.0, *[float(walker_by_walker[0].size)] * 2
    stuck = ~np.isfinite(rhat) & ~still & np.isfinite(walker_by_walker).all(axis=(1, 2))
    rhat[stuck], bulk[stuck], tail[stuck] = APART, 1.0, 1.0
    return Diagnostics(rhat, np.where(np.isfinite(bulk), bulk, 1.0), np.where(np.isfinite(tail), tail, 1.0))


def measure_longest_stand(log_density: Array, log_ratio: Array, rare_ratio: float = np.inf) -> int:
    """Return for how many steps the most patient walker stood still where that matters.

    Where a proposal misses mass, a walker that gets there finds no way back: effective sizes, which average over
    walkers that never went, do not see it. But a long stand alone says little: by jumps of density q a walker leaves a
    place of density p after p / q steps on average, long where q has a lighter tail than p, and such stands are part of
    what makes the draws right. What mass the place may hold decides. Stands do not count, if together they are less
    than `HARMLESS` of the draws,

    - where jumps lead often enough: of J jumps J m q / p get to where there is a mass m, and a mass of `HARMLESS` or
      more would have been met;
    - where so few places of the posterior are, by weights of draws from farther out, that they hold less than
      `HARMLESS` of it;
    - where the density is far below that of nearly all draws: moves by differential evolution are as long as the
      ensemble is wide and did not move the walker, so the place is no wider than the ensemble and holds far less.

    Parameters
    ----------
    log_density : ndarray, shape (E, W, S)
    log_ratio : ndarray, shape (E, W, S)
        Log of p / q, both normalised.
    rare_ratio : float
        The same, beyond which hardly any of the posterior lies; see `bayescal.inference.chain_checks`.
    """
    met = log_ratio < np.log(HARMLESS * JUMP_SHARE * log_density.size / MET)
    rare, middle = np.quantile(log_density, [TAILS[0], 0.5])
    visit = met | (log_ratio > rare_ratio) | (log_density < min(float(rare), float(middle) + np.log(HARMLESS)))
    longest, visits = (_measure_stands(log_density, where) for where in (~visit, visit))
    long = visits[visits >= STUCK_STEPS]
    return int(max(longest.max(), long.max(initial=0) if long.sum() > HARMLESS * log_density.size else 0))


def _measure_stands(log_density: Array, where: np.ndarray) -> np.ndarray:
    """Return for how many steps each walker (E, W) stood still at most, at places that are in a mask (E, W, S)."""
    longest = current = np.zeros(log_density.shape[:2], dtype=int)
    stood = (np.diff(log_density, axis=2) == 0.0) & where[..., 1:]
    for still in np.moveaxis(stood, 2, 0):
        current = np.where(still, current + 1, 0)
        longest = np.maximum(longest, current)
    return longest


def list_stand_problems(longest_stand: int, n_steps: int) -> list[str]:
    """Return in words whether a walker is stuck, and what cures it; empty where none is."""
    limit = max(STUCK_STEPS, int(np.ceil(STUCK_SHARE * n_steps)))
    if longest_stand < limit:
        return []
    stood = f"stuck walker ({longest_stand} of {n_steps} steps, limit {limit})"
    return [f"{stood}; increase `steps` in `[sampler]`"]


def list_importance_problems(pareto_k: float, n_effective: float) -> list[str]:
    """Return in words what speaks against the weights of importance sampling; empty where nothing does.

    What the proposal misses the chains that start from it miss, too, so that a bridge from them is no way out.
    """
    problems = []
    if not pareto_k <= PARETO_K_LIMIT:
        problems.append(f"Pareto k {pareto_k:.2f}, limit {PARETO_K_LIMIT}")
    if not n_effective >= EFFECTIVE_LIMIT:
        problems.append(f"{n_effective:.0f} effective importance draws, limit {EFFECTIVE_LIMIT:.0f}")
    return problems


def list_check_problems(evidence: tuple[float, float], check: tuple[float, float], settled: bool) -> list[str]:
    """Return what a check by tempering says against a log-evidence, in words; empty where they agree.

    Parameters
    ----------
    evidence, check : pair of float
        Both log-evidences with their standard errors.
    settled : bool
        Whether the chains of the check did.
    """
    problems = [] if settled else ["tempering chains did not settle"]
    error = max(float(np.hypot(evidence[1], check[1])), LEAST_ERROR)
    apart = abs(evidence[0] - check[0]) / error
    if not apart <= TEMPERED_LIMIT:
        problems.append(
            f"log-evidence {evidence[0]:.3f} ± {evidence[1]:.3f}, by tempering {check[0]:.3f} ± {check[1]:.3f}: "
            f"{apart:.1f} standard errors apart, limit {TEMPERED_LIMIT:g}"
        )
    return problems


def judge_draws(draws: Array) -> tuple[Array, Array, Array]:
    """Return rank-normalised R-hat, bulk and tail effective sample sizes of each parameter, shapes (n,).

    They are those of ArviZ (Vehtari et al. 2021), with what they share computed once: R-hat and bulk effective size are
    of the same ranks, in another order of the draws, and a rank's normal score is one of 2 S - 1 numbers, in steps of a
    half since draws repeat.

    Parameters
    ----------
    draws : ndarray, shape (ensembles, walkers, steps, n)
        R-hat takes the draws of an ensemble step by step, the effective sizes take them walker by walker.
    """
    from arviz_stats.base import array_stats  # seconds to import, for those who sample

    n_ensembles, n_walkers, n_steps, n = draws.shape
    n_draws = n_walkers * n_steps
    by_walker = np.ascontiguousarray(np.moveaxis(draws, -1, 0))
    if n_draws % 2 or n_draws < LEAST or n_ensembles < 2 or not np.isfinite(by_walker).all():
        return _judge_plainly(by_walker)
    found = np.empty((3, n))
    for k, values in enumerate(by_walker):
        scores, folded, low, high = _rank(values)
        in_time = np.stack([_halve(np.swapaxes(one, 1, 2)) for one in (scores, folded)])
        with np.errstate(divide="ignore", invalid="ignore"):  # ensembles that stand still
            rhat = array_stats.rhat(in_time, method="identity")
        walking = np.stack([_halve(one) for one in (scores, values <= low, values <= high)])
        bulk, *tail = array_stats.ess(walking, method="identity")
        found[:, k] = max(rhat.tolist()), bulk, min(tail)
    return found[0], found[1], found[2]


def _judge_plainly(by_walker: Array) -> tuple[Array, Array, Array]:
    """Return `judge_draws` as ArviZ does, of draws (n, ensembles, walkers, steps) whatever they are."""
    from arviz_stats.base import array_stats

    chains = by_walker.reshape(*by_walker.shape[:2], -1)
    in_time = np.swapaxes(by_walker, 2, 3).reshape(chains.shape)
    found = array_stats.rhat(in_time), array_stats.ess(chains), array_stats.ess(chains, method="tail", prob=TAILS)
    rhat, bulk, tail = (np.asarray(one, dtype=np.float64) for one in found)
    return rhat, bulk, tail


def _halve(values: Array) -> Array:
    """Return chains (E, ...) with as many halves in their order, first halves first, shape (2 E, S / 2)."""
    chains = values.reshape(len(values), -1)
    half = chains.shape[1] // 2
    return np.concatenate([chains[:, :half], chains[:, half:]])


def _rank(values: Array) -> tuple[Array, Array, float, float]:
    """Return normal scores of the ranks of values (...), those of the ranks of |values - median|, and both quantiles.

    In the order of the values their distances from the median fall, then rise: two runs, which a stable sort merges.
    """
    flat = values.ravel()
    order = np.argsort(flat)
    ordered = flat[order]
    half = len(flat) // 2
    distances = np.abs(ordered - 0.5 * (ordered[half - 1] + ordered[half]))
    fold = np.argsort(distances, kind="stable")
    folded = _score(distances[fold], order[fold])
    low, high = (_interpolate(ordered, share) for share in TAILS)
    return _score(ordered, order).reshape(values.shape), folded.reshape(values.shape), low, high


def _interpolate(ordered: Array, share: float) -> float:
    """Return a quantile of ordered values (S,), between two of them along a line, to the bit as NumPy does."""
    place = share * (len(ordered) - 1)
    below = int(place)
    first, second = ordered[below : below + 2]
    part, step = place - below, second - first
    return float(second - step * (1.0 - part) if part >= 0.5 else first + step * part)


def _score(ordered: Array, order: np.ndarray) -> Array:
    """Return the normal scores of the ranks of values (S,), those of equal ones the same, from their order."""
    first = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
    last = np.append(first[1:], len(ordered))
    twice = first + last - 1  # twice the mean rank, from zero
    scores = np.empty(len(ordered))
    scores[order] = np.repeat(_list_scores(len(ordered))[twice], last - first)
    return scores


@lru_cache(maxsize=4)
def _list_scores(size: int) -> Array:
    """Return the normal scores of the ranks 1, 1.5, 2, ..., of so many draws."""
    ranks = 1.0 + 0.5 * np.arange(2 * size - 1)
    scores = ndtri((ranks - BLOM) / (size - 2 * BLOM + 1))
    scores.setflags(write=False)
    return np.asarray(scores)


def measure_sensitivity(draws: Array, log_prior: Array, log_likelihood: Array) -> Array:
    """Return each parameter's sensitivity to the prior and to the measurements, shape (n, 2).

    Both are raised to a power near one, by weights (Kallioinen et al. 2023, as ArviZ's `psense_summary` does it).

    Parameters
    ----------
    draws : ndarray, shape (E, S, n)
    log_prior, log_likelihood : ndarray, shape (E, S)
        In the parameters' own units.
    """
    from arviz_stats.base import array_stats  # seconds to import, for those who sample

    by_parameter, found = np.moveaxis(draws, -1, 0), []
    for component in (log_prior, log_likelihood):
        weights = [_weigh(component, power) for power in POWERS]
        shares = [np.broadcast_to(one / one.sum(), by_parameter.shape) for one in weights]
        found.append(np.asarray(array_stats.power_scale_sense(by_parameter, *shares, *POWERS)))
    return np.stack(found, axis=-1)


def _weigh(component: Array, power: float) -> Array:
    """Return the weights (E, S) of a component raised to a power; smoothed where they have a tail."""
    from arviz_stats.base import array_stats

    try:
        with warnings.catch_warnings():  # of very few draws the tail is that of five
            warnings.filterwarnings("ignore", message="Number of tail draws")
            return np.asarray(np.exp(array_stats.power_scale_lw(component, alpha=power, axis=(-2, -1))))
    except ValueError:  # squeezed against a bound, all draws of the tail are alike
        return np.exp((power - 1.0) * (component - component.max()))
