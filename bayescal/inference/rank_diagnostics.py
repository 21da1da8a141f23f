"""R-hat and effective sample sizes as ArviZ computes them (Vehtari et al. 2021), with what they share computed once.

Rank-normalised R-hat and bulk effective size are of the same ranks, in another order of the draws, and a rank's normal
score is one of 2 S - 1 numbers, in steps of a half since draws repeat. What is left to ArviZ are its own formulas on
such scores.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import ndtri

from bayescal.numerics.geometry import Array

BLOM = 3.0 / 8.0
"""Offset of ranks (Blom 1958)."""
TAILS = (0.05, 0.95)
LEAST = 8  # draws of a chain whose halves are judged


def judge_draws(draws: Array) -> tuple[Array, Array, Array]:
    """Return rank-normalised R-hat, bulk and tail effective sample sizes of each parameter, shapes (n,).

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
        in_time = np.stack([_halve(_in_time(one)) for one in (scores, folded)])
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


def _in_time(values: Array) -> Array:
    """Return values (E, W, S) step by step."""
    return np.swapaxes(values, 1, 2)


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
