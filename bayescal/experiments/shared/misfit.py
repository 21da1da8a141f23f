"""What the best machine leaves of the measurements, against the noise that was stated.

For a linear machine with normal tolerances, whitened parameters z ~ N(0, 1) and n measured rows, the misfit at the mode
has the expectation n - Σ s_k, where s_k is what the measurements take off the prior variance along the k-th direction;
their sum is the trace of the matrix that makes fitted rows of measured ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from bayescal.density.legs import LegPosterior
from bayescal.density.likelihood import Likelihood
from bayescal.density.local import turn_to_coordinates
from bayescal.numerics.geometry import Array


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
    def square(self) -> float:
        """Their sum of squares, χ²."""
        return float(np.sum(self.left.ravel() ** 2))


def measure_misfit(
    posterior: LegPosterior,
    mode: Array,
    likelihood: Likelihood,
    shared: Array | None = None,
    counted: np.ndarray | None = None,
) -> Array:
    """Return χ² at the mode (n,) and its degrees of freedom; arguments are those of `find_misfit`."""
    found = find_misfit(posterior, mode, likelihood, shared, counted)
    return np.array([found.square, found.dof])


def find_misfit(
    posterior: LegPosterior,
    mode: Array,
    likelihood: Likelihood,
    shared: Array | None = None,
    counted: np.ndarray | None = None,
) -> Misfit:
    """Return what is left of the measured rows at the mode (n,).

    Parameters
    ----------
    posterior : LegPosterior
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
    model_error = np.broadcast_to(
        posterior.errors.amplitudes(posterior.zeta(mode[None])), (1, likelihood.n_model_errors)
    )[0]
    whitening = np.linalg.inv(np.linalg.cholesky(likelihood.error_covariance(model_error)))
    errors = likelihood.errors(theta[None])[0]
    change = posterior.sampling.jacobian(theta)
    by_machine = turn_to_coordinates(likelihood.error_jacobian(theta)[1], change)
    prior_slope = posterior.sampling.prior_slope(change)
    extra = np.empty((*errors.shape, 0)) if shared is None else shared
    if counted is not None:
        errors, whitening = errors[counted], whitening[counted]
        by_machine, extra = by_machine[counted], extra[counted]
    slope = whitening @ np.concatenate([by_machine, extra], axis=-1)
    white, n_rows = (whitening @ errors[..., None]).ravel(), errors.size
    slope = slope.reshape(n_rows, -1)
    n_extra = extra.shape[-1]
    rows = np.concatenate([slope, block_diag(prior_slope, np.eye(n_extra))])
    held = np.concatenate(
        [white, posterior.sampling.prior_residual(mode[: posterior.n_geometry], theta), np.zeros(n_extra)]
    )
    basis, _ = np.linalg.qr(rows)
    left = held - basis @ (basis.T @ held)
    used = np.sum(basis[:n_rows] ** 2)
    n_measured = np.count_nonzero(errors)  # rows beyond what was measured at a pose are exactly zero
    return Misfit(left[:n_rows].reshape(errors.shape), float(n_measured - used))
