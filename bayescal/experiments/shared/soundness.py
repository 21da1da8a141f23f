"""What the residuals say of the stated noise, and the posterior's distance from nominal of the stated tolerances.

For a linear machine with normal tolerances, whitened parameters z ~ N(0, 1) and n measured rows, the misfit at the mode
has the expectation n - Σ s_k, where s_k is what the measurements take off the prior variance along the k-th direction;
their sum is the trace of the matrix that makes fitted rows of measured ones. The posterior mean along that direction is
normal with variance s_k: over directions that were learnt, Σ m_k² / s_k is χ².
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.experiments.shared.chi_square import ChiSquare
from bayescal.inference.target import Fittable
from bayescal.numerics.geometry import Array

LEARNT = 0.5
"""Share of the prior variance that the measurements have to take off a direction for its mean to say something."""
FAR_OUT = 8.0
"""Standard deviations: a draw at the very end of a uniform prior counts so much."""


@dataclass(frozen=True, eq=False)
class Misfit:
    """What is left of the measured rows at a mode.

    Attributes
    ----------
    left : ndarray, shape (P, K)
        In units of the noise.
    dof : float
        Degrees of freedom of their sum of squares.
    """

    left: Array
    dof: float

    @property
    def chi_square(self) -> ChiSquare:
        """Their sum of squares."""
        return ChiSquare(float(np.sum(self.left.ravel() ** 2)), self.dof)


def fit_rows(white: Array, slope: Array, prior: Array, prior_slope: Array, n_measured: int) -> Misfit:
    """Return what a linear fit with priors leaves of white rows.

    Parameters
    ----------
    white : ndarray, shape (P, K)
    slope : ndarray, shape (P, K, m)
        Their derivatives by the unknowns.
    prior, prior_slope : ndarray, shapes (m,) and (m, m)
        The prior as residuals of unit variance, and its derivatives.
    n_measured : int
        How many of the rows were measured.
    """
    n_rows = white.size
    rows = np.concatenate([slope.reshape(n_rows, -1), prior_slope])
    basis, _ = np.linalg.qr(rows)
    held = np.concatenate([white.ravel(), prior])
    left = held - basis @ (basis.T @ held)
    used = np.sum(basis[:n_rows] ** 2)
    return Misfit(left[:n_rows].reshape(white.shape), float(n_measured - used))


def measure_pulls(posterior: Fittable, draws: Array) -> ChiSquare:
    """Return χ² of how far the posterior lies from nominal, from draws (..., n) in own units."""
    standard = _standardise(posterior, draws)
    variance, directions = np.linalg.eigh(_covariance(standard))
    learnt = 1.0 - variance
    mean = directions.T @ standard.mean(axis=0)
    told = learnt >= LEARNT
    return ChiSquare(float(np.sum(mean[told] ** 2 / learnt[told])), float(np.count_nonzero(told)))


def _standardise(posterior: Fittable, draws: Array) -> Array:
    """Return the geometry's draws (S, m), each parameter standard normal under its prior."""
    flat, priors = draws.reshape(-1, draws.shape[-1]), list(posterior.all_priors().values())
    geometry = priors[: posterior.n_geometry]
    with np.errstate(all="ignore"):
        columns = [prior.standardise(flat[:, k]) for k, prior in enumerate(geometry)]
    return np.clip(np.stack(columns, axis=-1), -FAR_OUT, FAR_OUT) if columns else np.empty((len(flat), 0))


def _covariance(standard: Array) -> Array:
    return np.atleast_2d(np.cov(standard, rowvar=False)) if standard.shape[1] else np.empty((0, 0))
