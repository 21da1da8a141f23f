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
        scores, folded = _score(values), _score(np.abs(values - np.median(values)))
        with np.errstate(divide="ignore", invalid="ignore"):  # ensembles that stand still
            rhat = [float(array_stats.rhat(_halve(_in_time(one)), method="identity")) for one in (scores, folded)]
        below = [values <= quantile for quantile in np.quantile(values, TAILS)]
        bulk, *tail = (float(array_stats.ess(_halve(one), method="identity")) for one in (scores, *below))
        found[:, k] = max(rhat), bulk, min(tail)
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


def _score(values: Array) -> Array:
    """Return the normal scores of the ranks of values (...), those of equal ones the same."""
    flat = values.ravel()
    order = np.argsort(flat)
    ordered = flat[order]
    first = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
    last = np.append(first[1:], len(flat))
    twice = first + last - 1  # twice the mean rank, from zero
    scores = np.empty(len(flat))
    scores[order] = np.repeat(_list_scores(len(flat))[twice], last - first)
    return scores.reshape(values.shape)


@lru_cache(maxsize=4)
def _list_scores(size: int) -> Array:
    """Return the normal scores of the ranks 1, 1.5, 2, ..., of so many draws."""
    ranks = 1.0 + 0.5 * np.arange(2 * size - 1)
    scores = ndtri((ranks - BLOM) / (size - 2 * BLOM + 1))
    scores.setflags(write=False)
    return np.asarray(scores)
