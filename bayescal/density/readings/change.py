"""Densities of parameters from those of their coordinates, of which each parameter is a function of one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayescal.numerics.geometry import Array

STEP = 1e-5  # of a coordinate that is standard normal under the prior


def change_density(log_density: Array, natural: Callable[[Array], Array], y: Array) -> Array:
    """Return log-densities (..., n) of parameters in their own units from those of coordinates y (..., n)."""
    slope = np.abs(natural(y + STEP) - natural(y - STEP)) / (2 * STEP)
    return np.asarray(log_density - np.log(slope))
