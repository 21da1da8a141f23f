"""What the residuals say of the stated noise, and the posterior's distance from nominal of the stated tolerances.

For a linear machine with normal tolerances, whitened parameters z ~ N(0, 1) and n measured rows, the misfit at the mode
has the expectation n - Σ s_k, where s_k is what the measurements take off the prior variance along the k-th direction;
their sum is the trace of the matrix that makes fitted rows of measured ones. The posterior mean along that direction is
normal with variance s_k: over directions that were learnt, Σ m_k² / s_k is χ². Sums of squares are judged against what
chance gives: limits hang on the degrees of freedom, few of which scatter widely.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtr, chdtrc

from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_significant

if TYPE_CHECKING:
    from bayescal.inference.target import LogPosterior

RARE = 1e-3
"""Probability of a deviation as large by chance, from which on it is said."""
WORTH_SAYING = 1.1
"""Factor on noise or tolerance below which a deviation changes no interval that matters."""
LEARNT = 0.5
"""Share of the prior variance that the measurements have to take off a direction for its mean to say something."""
SHARES = 0.99
"""Probability of a share within what is expected of it."""
FAR_OUT = 8.0
"""Standard deviations: a draw at the very end of a uniform prior counts so much."""


@dataclass(frozen=True)
class ChiSquare:
    """A sum of squares that should be χ²-distributed."""

    value: float
    dof: float

    @property
    def factor(self) -> float:
        """How many times larger the deviations are than stated."""
        return math.sqrt(self.value / self.dof) if self.dof > 0 else math.nan

    @property
    def chance(self) -> float:
        """Probability of as large a deviation to either side."""
        if not self.dof > 0:
            return 1.0
        return float(2 * min(chdtrc(self.dof, self.value), chdtr(self.dof, self.value), 0.5))

    @property
    def is_off(self) -> bool:
        """Whether it lies far from its expectation, by chance and by size."""
        return self.chance < RARE and max(self.factor, 1 / self.factor) > WORTH_SAYING


def format_chance(chance: float) -> str:
    """Return a probability in words."""
    return "p < 0.0001" if chance < 1e-4 else f"p = {format_significant(chance, 1)}"


def span_shares(expected: float, n_poses: int, probability: float = SHARES) -> tuple[float, float]:
    """Return between which shares of readings in their intervals lie, with a probability, where intervals are right.

    Readings of a pose count as one trial: what is not known of the pose, or of the machine there, moves them together,
    so that ten of six each scatter like ten, and not like sixty.
    """
    from scipy.stats import binom  # a second to import, for those who judge shares

    n = max(n_poses, 1)
    low, high = binom.interval(probability, n, expected)
    return float(low) / n, float(high) / n


def fit_rows(white: Array, slope: Array, prior: Array, prior_slope: Array, n_measured: int) -> tuple[Array, ChiSquare]:
    """Return what a linear fit with priors leaves of white rows (P, K), and the sum of its squares.

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
    return left[:n_rows].reshape(white.shape), ChiSquare(float(np.sum(left[:n_rows] ** 2)), float(n_measured - used))


def measure_pulls(posterior: LogPosterior, draws: Array) -> ChiSquare:
    """Return χ² of how far the posterior lies from nominal, from draws (..., n) in own units."""
    flat, priors = draws.reshape(-1, draws.shape[-1]), list(posterior.all_priors().values())[: posterior.n_geometry]
    if not priors:
        return ChiSquare(0.0, 0.0)
    with np.errstate(all="ignore"):
        columns = [prior.standardise(flat[:, k]) for k, prior in enumerate(priors)]
    standard = np.clip(np.stack(columns, axis=-1), -FAR_OUT, FAR_OUT)
    variance, directions = np.linalg.eigh(np.atleast_2d(np.cov(standard, rowvar=False)))
    learnt = 1.0 - variance
    mean = directions.T @ standard.mean(axis=0)
    told = learnt >= LEARNT
    return ChiSquare(float(np.sum(mean[told] ** 2 / learnt[told])), float(np.count_nonzero(told)))
