"""What the measurements say of the stated tolerances, by how far they are used; see `shared.misfit` for the noise.

For a linear machine with normal tolerances and whitened parameters z ~ N(0, 1), the posterior mean along the k-th
direction is normal with variance s_k, what the measurements take off the prior variance along it: over directions that
were learnt, Σ m_k² / s_k is χ².
"""

from __future__ import annotations

import numpy as np

from bayescal.density.legs import LegPosterior
from bayescal.numerics.geometry import Array

LEARNT = 0.5
"""Share of the prior variance that the measurements have to take off a direction for its mean to say something."""


def measure_pulls(posterior: LegPosterior, draws: Array) -> Array:
    """Return χ² of how far the posterior lies from nominal, and its degrees of freedom, from draws (..., n)."""
    standard = _standardise(posterior, draws)
    variance, directions = np.linalg.eigh(_covariance(standard))
    learnt = 1.0 - variance
    mean = directions.T @ standard.mean(axis=0)
    told = learnt >= LEARNT
    return np.array([np.sum(mean[told] ** 2 / learnt[told]), np.count_nonzero(told)])


def _standardise(posterior: LegPosterior, draws: Array) -> Array:
    """Return the geometry's draws (S, m), each parameter standard normal under its prior."""
    flat, priors = draws.reshape(-1, draws.shape[-1]), list(posterior.all_priors().values())
    geometry = priors[: posterior.n_geometry]
    with np.errstate(all="ignore"):
        columns = [prior.standardise(flat[:, k]) for k, prior in enumerate(geometry)]
    return np.clip(np.stack(columns, axis=-1), -FAR_OUT, FAR_OUT) if columns else np.empty((len(flat), 0))


FAR_OUT = 8.0
"""Standard deviations: a draw at the very end of a uniform prior counts so much."""


def _covariance(standard: Array) -> Array:
    return np.atleast_2d(np.cov(standard, rowvar=False)) if standard.shape[1] else np.empty((0, 0))
