"""How much a posterior hangs on the prior and on the measurements: both raised to a power near one, by weights.

Kallioinen et al. 2023, as ArviZ's `psense_summary` does it.
"""

from __future__ import annotations

import warnings

import numpy as np

from bayescal.numerics.geometry import Array

POWERS = (0.99, 1.01)


def measure_sensitivity(draws: Array, log_prior: Array, log_likelihood: Array) -> Array:
    """Return each parameter's sensitivity to the prior and to the measurements, shape (n, 2).

    Parameters
    ----------
    draws : ndarray, shape (E, S, n)
    log_prior, log_likelihood : ndarray, shape (E, S)
        In the parameters' own units.
    """
    return np.stack([_measure_one(np.moveaxis(draws, -1, 0), part) for part in (log_prior, log_likelihood)], axis=-1)


def _measure_one(draws: Array, component: Array) -> Array:
    from arviz_stats.base import array_stats  # seconds to import, for those who sample

    weights = [_weigh(component, power) for power in POWERS]
    shares = [np.broadcast_to(one / one.sum(), draws.shape) for one in weights]
    return np.asarray(array_stats.power_scale_sense(draws, *shares, *POWERS))


def _weigh(component: Array, power: float) -> Array:
    """Return the weights (E, S) of a component raised to a power; smoothed where they have a tail."""
    from arviz_stats.base import array_stats

    try:
        with warnings.catch_warnings():  # of very few draws the tail is that of five
            warnings.filterwarnings("ignore", message="Number of tail draws")
            return np.asarray(np.exp(array_stats.power_scale_lw(component, alpha=power, axis=(-2, -1))))
    except ValueError:  # squeezed against a bound, all draws of the tail are alike
        return np.exp((power - 1.0) * (component - component.max()))
