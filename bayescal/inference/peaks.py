"""Gaussians fitted to a density's peaks in straight coordinates, by finite differences of a posterior sd.

The mode of a skewed density is not where its mass is, and the curvature at a point is not that of the mass around it.
Both are seen better over steps as large as the posterior is wide. All points of a step are independent and go through
the density as one batch, so a refined peak costs less than a short chain.

Without refined peaks the evidence of the telescope's six_pus/none is 0.50 nats low and draws stand still; without bends
its six_pus/matrix takes 16 times as long (`benchmarks/ablation`). Without a least weight no draw is of the far mode of
its beam/none (`tests/experiments/study/test_far_modes.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from bayescal.inference.importance import LogDensity, difference_twice
from bayescal.inference.proposal import MixtureProposal
from bayescal.inference.reparameterisation import QUANTILES, Bend, Reparameterisation, bend_from_quantiles
from bayescal.numerics.geometry import Array

PEAK_STEP = 1.0  # posterior sds
MAX_STEPS = 3
MAX_PEAK_GAIN_NAT = 50.0  # nats that no step to a peak from a mode nearby gains
CURVATURE_BOUNDS = (0.1, 10.0)  # of a step's curvature in units of the last one's
LONGEST_STEP = 4.0
SETTLED_GAIN, SETTLED_CURVATURE = 0.02, 0.1  # nats, and the squared logarithms of all axes' curvatures together
GRID = np.linspace(-5.0, 5.0, 81)  # of a model error's coordinate ζ, standard normal under the prior
LEAST_WEIGHT = 0.02


@dataclass(frozen=True, eq=False)
class GaussianMode:
    """A Gaussian around a peak: its centre (n,), Cholesky factor (n, n) and the log-density at its centre."""

    centre: Array
    factor: Array
    log_density: float

    @property
    def log_evidence(self) -> float:
        """Its mass by Laplace's formula."""
        return self.log_density + float(np.log(np.diag(self.factor)).sum()) + 0.5 * len(self.centre) * np.log(2 * np.pi)


def proposal_from_peaks(peaks: Sequence[GaussianMode], dof: float) -> MixtureProposal:
    """Return a mixture over the peaks, weighted by their mass; none so little that draws hardly lead there.

    The mass of a lesser peak is the less sure: its own ridge may be bent in coordinates that are straight at the best.
    """
    log_weights = np.array([peak.log_evidence for peak in peaks])
    weights = np.maximum(np.exp(log_weights - logsumexp(log_weights)), LEAST_WEIGHT / len(peaks))
    centres, factors = (np.stack([getattr(peak, name) for peak in peaks]) for name in ("centre", "factor"))
    return MixtureProposal(weights / weights.sum(), centres, factors, dof)


def refine_peak(log_density: LogDensity, peak: GaussianMode) -> GaussianMode:
    """Return the peak after Newton steps with gradients and Hessians by differences over a posterior sd.

    Where they lead nowhere, it is returned as it is.
    """
    centre, factor = peak.centre, peak.factor
    for _ in range(MAX_STEPS):
        gradient, hessian = difference_twice(log_density, centre, factor, PEAK_STEP)
        if not (np.isfinite(gradient).all() and np.isfinite(hessian).all()):
            return peak
        values, vectors = np.linalg.eigh(-hessian)
        values = np.clip(values, *CURVATURE_BOUNDS)
        step = vectors @ ((vectors.T @ gradient) / values)
        gain, length = float(gradient @ step), float(np.linalg.norm(step))
        if gain > MAX_PEAK_GAIN_NAT:
            return peak
        centre = centre + factor @ (step * min(1.0, LONGEST_STEP / length) if length > 0 else step)
        factor = factor @ (vectors / np.sqrt(values))
        if gain < SETTLED_GAIN and np.sum(np.log(values) ** 2) < SETTLED_CURVATURE:
            break
    found = float(log_density(centre[None])[0])
    if not np.isfinite(found):
        return peak
    return GaussianMode(centre, np.linalg.cholesky(factor @ factor.T), found)


def bend_at(straight: Reparameterisation, peak: GaussianMode) -> tuple[Reparameterisation, GaussianMode]:
    """Return the straightening with bends fitted to the model errors' conditional densities at a peak.

    Along each ζ, the geometry following the stretch, quantiles of the density on a grid take the place of draws'.
    """
    if not straight.follows_errors:
        return straight, peak
    n, flat = straight.posterior.n_geometry, replace(straight, bend=None)
    y = straight.y_from_x(peak.centre[None])
    start = flat.x_from_y(y)[0]
    quantiles = []
    for k in range(n, len(start)):
        points = np.tile(start, (len(GRID), 1))
        points[:, k] = GRID
        values = flat.log_density(points)
        mass = np.exp(values - values.max())
        share = (np.cumsum(mass) - 0.5 * mass) / mass.sum()
        quantiles.append(np.interp(QUANTILES, share, GRID))
    bent = replace(straight, bend=bend_from_quantiles(*np.transpose(quantiles)))
    centre = bent.x_from_y(y)[0]
    scale = np.ones(len(centre))
    scale[n:] = _bend_slope(straight.bend, peak.centre[n:]) / _bend_slope(bent.bend, centre[n:])
    scaled = scale[:, None] * peak.factor
    return bent, GaussianMode(centre, np.linalg.cholesky(scaled @ scaled.T), peak.log_density)


def _bend_slope(bend: Bend | None, eta: Array) -> Array:
    return np.ones_like(eta) if bend is None else bend.slope(eta)
