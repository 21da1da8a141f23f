"""Sizes of errors beside a cause: the best ones, and the log-density with all of them.

The errors' sizes ζ are integrated for each cause by itself (Laplace): errors that a cause explains give way to it, and
a cause that leaves their sizes open gains the room that data which need them take from their prior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayescal.inference.scales import find_scales_mode, measure_volume
from bayescal.numerics.geometry import Array

LEVELS = (-3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0, 5.0)  # of all coordinates of errors at once
TURNS = (-2.0, -1.0, 1.0, 2.0), (-1.0, -0.5, 0.5, 1.0)  # steps of single ones, turn by turn
SLOPE_STEP = 1e-4  # of errors' coordinates: log-densities of some thousand nats are known to 1e-8

type Weigh = Callable[[Array], Array]
"""From errors ζ (B, n) to log-densities (B,)."""


def profile(weigh: Weigh, starts: Sequence[Array], levels: bool = True, turns: bool = True) -> Array:
    """Return the errors' coordinates ζ (n,) with the largest log-density and prior.

    The best of some starts, and of all coordinates at once; from there by turns, one coordinate after the other.
    """

    def evaluate(zeta: Array) -> Array:
        found = weigh(zeta) - 0.5 * np.sum(zeta**2, axis=1)
        return np.where(np.isnan(found), -np.inf, found)

    n = len(starts[0])
    first = np.stack([*starts, *(np.full(n, size) for size in LEVELS if n and levels)])
    if len(first) == 1 and not (n and turns):
        return starts[0]
    values = evaluate(first)
    zeta, best = first[values.argmax()], values.max()
    for steps in TURNS if n and turns else ():
        for k in range(n):
            left = np.array(steps)
            while len(left):  # all from where the last step led that was better
                moved = np.tile(zeta, (len(left), 1))
                moved[:, k] += left
                values = evaluate(moved)
                better = np.flatnonzero(values > best)
                if not len(better):
                    break
                zeta, best, left = moved[better[0]], values[better[0]], left[better[0] + 1 :]
    return zeta


def integrate_sizes(weigh: Weigh, start: Array) -> tuple[float, Array]:
    """Return the log-density with the errors' coordinates ζ (n,) integrated over their prior, and the best ones.

    By Laplace's approximation about the optimum that a search from a start leads to.
    """

    def log_density(zeta: Array) -> Array:
        return weigh(zeta) - 0.5 * np.sum(zeta**2, axis=1)

    mode = find_scales_mode(log_density, start, SLOPE_STEP)
    return float(log_density(mode[None])[0]) + measure_volume(log_density, mode), mode
