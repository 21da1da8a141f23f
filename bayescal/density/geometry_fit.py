"""Least squares of a posterior's geometry: whitened errors and priors together."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.optimize import least_squares

from bayescal.density.likelihood import Likelihood
from bayescal.limits import FAR_AWAY
from bayescal.machines.coordinates import Coordinates
from bayescal.numerics.geometry import Array

TOLERANCE = 1e-6


class Fitted(Protocol):
    """What is fitted: the geometry of a posterior; see `bayescal.density.posterior`."""

    @property
    def coordinates(self) -> Coordinates:
        """Coordinates of the geometry."""

    def prior_residual(self, y: Array, theta: Array) -> Array:
        """Return the prior as residuals of unit variance, shape (m,)."""

    def residual_slope(self, theta: Array, likelihood: Likelihood) -> tuple[Array, Array]:
        """Return the derivatives of errors (P, K, m) and of `prior_residual` (m, m) at θ, shape (D,)."""


def fit_geometry(posterior: Fitted, likelihood: Likelihood, start: Array, whitening: Array) -> Array:
    """Return the geometry's coordinates of least squares, shape (m,).

    Parameters
    ----------
    posterior : Fitted
    likelihood : Likelihood
        Whose errors are fitted.
    start : ndarray, shape (m,)
    whitening : ndarray, shape (P, K, K)
        Of each pose's errors.
    """
    coordinates, layout = posterior.coordinates, likelihood.layout

    def residual(y: Array) -> Array:
        theta = coordinates.theta_from_y(y[None])
        errors = likelihood.errors(theta)[0]
        white = (whitening @ errors[..., None]).ravel()
        value = np.concatenate([white, posterior.prior_residual(y, theta[0])])
        return np.where(np.isfinite(value) & layout.inside(theta)[0], value, FAR_AWAY)

    def jacobian(y: Array) -> Array:
        slope, prior_slope = posterior.residual_slope(coordinates.theta_from_y(y[None])[0], likelihood)
        return np.concatenate([(whitening @ slope).reshape(-1, len(start)), prior_slope])

    return np.asarray(least_squares(residual, start, jacobian, method="lm", xtol=TOLERANCE, ftol=TOLERANCE).x)
