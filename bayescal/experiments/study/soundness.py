"""What the measurements say of what was stated: of the noise by the misfit, of the tolerances by how far they are used.

For a linear machine with normal tolerances, whitened parameters z ~ N(0, 1) and n measured rows, the misfit at the mode
has the expectation n - Σ s_k, where s_k is what the measurements take off the prior variance along the k-th direction;
their sum is the trace of the matrix that makes fitted rows of measured ones.
The posterior mean along it is normal with variance s_k: over directions that were learnt, Σ m_k² / s_k is χ².
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from bayescal.density.likelihood import Likelihood
from bayescal.density.posterior import Posterior
from bayescal.numerics.geometry import Array

LEARNT = 0.5
"""Share of the prior variance that the measurements have to take off a direction for its mean to say something."""


def measure_misfit(
    posterior: Posterior,
    mode: Array,
    likelihood: Likelihood,
    shared: Array | None = None,
    counted: np.ndarray | None = None,
) -> Array:
    """Return χ² at the mode (n,) and its degrees of freedom.

    Parameters
    ----------
    posterior : Posterior
    mode : ndarray, shape (n,)
        Its model errors count as noise.
    likelihood : Likelihood
        Of the same measurements, without errors that all poses share.
    shared : ndarray, shape (P, K, M), optional
        What M unknowns, standard normal a priori, add to the rows of all poses: as noise of single poses they would
        count as often as there are poses. They are fitted along, to first order.
    counted : ndarray of bool, shape (P,), optional
        Poses that count; all without it.
    """
    theta = posterior.theta(mode[None])[0]
    model_error = np.broadcast_to(posterior.model_errors(mode[None]), (1, likelihood.n_model_errors))[0]
    whitening = np.linalg.inv(np.linalg.cholesky(likelihood.error_covariance(model_error)))
    errors = likelihood.errors(theta[None])[0]
    by_machine, prior_slope = posterior.residual_slope(theta)
    extra = np.empty((*errors.shape, 0)) if shared is None else shared
    if counted is not None:
        errors, whitening = errors[counted], whitening[counted]
        by_machine, extra = by_machine[counted], extra[counted]
    slope = whitening @ np.concatenate([by_machine, extra], axis=-1)
    white, n_rows = (whitening @ errors[..., None]).ravel(), errors.size
    slope = slope.reshape(n_rows, -1)
    n_extra = extra.shape[-1]
    rows = np.concatenate([slope, block_diag(prior_slope, np.eye(n_extra))])
    held = np.concatenate([white, posterior.prior_residual(mode, theta), np.zeros(n_extra)])
    basis, _ = np.linalg.qr(rows)
    left = held - basis @ (basis.T @ held)
    used = np.sum(basis[:n_rows] ** 2)
    n_measured = np.count_nonzero(errors)  # rows beyond what was measured at a pose are exactly zero
    return np.array([np.sum(left[:n_rows] ** 2), n_measured - used])


def measure_pulls(posterior: Posterior, draws: Array) -> Array:
    """Return χ² of how far the posterior lies from nominal, and its degrees of freedom, from draws (..., n)."""
    standard = _standardise(posterior, draws)
    variance, directions = np.linalg.eigh(_covariance(standard))
    learnt = 1.0 - variance
    mean = directions.T @ standard.mean(axis=0)
    told = learnt >= LEARNT
    return np.array([np.sum(mean[told] ** 2 / learnt[told]), np.count_nonzero(told)])


def _standardise(posterior: Posterior, draws: Array) -> Array:
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
