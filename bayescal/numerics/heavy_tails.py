"""Sizes of errors that data hardly determine: half-widths of intervals, and not moments that a heavy tail makes.

Under a half-Cauchy prior a size s that leaves no trace in the data has no second moment: the mean of s² over draws is
that of the largest few, and grows with their number. An error that is normal given its size, e ~ N(0, s²), has a 90 %
interval all the same; where a standard deviation is wanted, its half-width over that of a standard normal number is
taken. For covariances the largest sizes are cut off where their root mean square is that, draw by draw: geometry and
errors that imitate each other then still belong together, which no factor on the covariance's rows would leave.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri

from bayescal.numerics.geometry import Array

COVERAGE: Final = 0.90
HEAVY: Final = 1.1
"""Root mean square of a size in its equivalent from which on it is not used: below, data determine the size."""
HARDLY: Final = 1.5
"""The same from which on pages say so."""
HALVINGS: Final = 50


def find_equivalent(sizes: Array) -> float:
    """Return the half-width of the central 90 % interval of an error N(0, s²) over draws s (T,), by that of N(0, 1)."""
    k = float(ndtri(0.5 * (1.0 + COVERAGE)))
    low, high = 0.0, float(np.max(sizes, initial=0.0))
    for _ in range(HALVINGS if high > 0.0 else 0):
        middle = 0.5 * (low + high)
        ratio = np.divide(middle, sizes, out=np.full(len(sizes), np.inf), where=sizes > 0.0)
        held = float(np.mean(2.0 * ndtr(k * ratio) - 1.0))
        low, high = (middle, high) if held < COVERAGE else (low, middle)
    return high


def measure_tail(sizes: Array) -> float:
    """Return the root mean square of draws (T,) of a size in its equivalent; one of sizes that are all zero."""
    equivalent = find_equivalent(sizes)
    return float(np.sqrt(np.mean(sizes**2))) / equivalent if equivalent > 0.0 else 1.0


def find_most(sizes: Array) -> float:
    """Return at which size draws (T,) are cut off so that their root mean square is `find_equivalent`.

    Infinite where data determine the size, as far as `HEAVY` says.
    """
    if measure_tail(sizes) <= HEAVY:
        return np.inf
    wanted, low, high = find_equivalent(sizes) ** 2, 0.0, float(sizes.max())
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.mean(np.minimum(sizes, middle) ** 2) < wanted else (low, middle)
    return high
