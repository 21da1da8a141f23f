"""Whether ranks are uniform: bands that hold their empirical distribution function everywhere at once.

By simulation after Säilynoja, Bürkner and Vehtari (2022): the pointwise level is the one at which so many sets of
uniform numbers as asked for stay within the pointwise binomial limits at every point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.stats import binom

from bayescal.numerics.geometry import Array

POINTS = 40
SIMULATED = 20_000


@dataclass(frozen=True, eq=False)
class Band:
    """Limits of the distribution function of n uniform numbers.

    Attributes
    ----------
    at, low, high : ndarray, shape (K,)
    """

    at: Array
    low: Array
    high: Array

    def holds(self, ranks: Array) -> bool:
        """Whether the distribution of ranks (n,) lies within everywhere."""
        share = distribute(ranks, self.at)
        return bool(np.all((share >= self.low - 1e-12) & (share <= self.high + 1e-12)))


def distribute(ranks: Array, at: Array) -> Array:
    """Return the share of ranks (n,) at or below each point (K,)."""
    return np.asarray(np.searchsorted(np.sort(ranks), at, side="right") / len(ranks))


@cache
def find_band(n: int, false_alarms: float) -> Band:
    """Return the band that n uniform numbers leave with a probability of ``false_alarms``."""
    at = np.arange(1, POINTS) / POINTS
    rng = np.random.default_rng(0)
    cells = rng.multinomial(n, np.full(POINTS, 1.0 / POINTS), SIMULATED)
    counts = np.cumsum(cells, axis=1)[:, :-1]
    tails = np.minimum(binom.cdf(counts, n, at), binom.sf(counts - 1, n, at))
    level = float(np.quantile(2.0 * tails.min(axis=1), false_alarms))
    return Band(at, binom.ppf(level / 2.0, n, at) / n, binom.isf(level / 2.0, n, at) / n)
