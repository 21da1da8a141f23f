"""What one session measured, as sessions need it: rows free of the pose, linear in θ, and the exact density.

Rows are what no pose explains of the readings: with H = ∂h/∂v white and Z an orthonormal
complement of its columns, Zᵀ(s - h) has no pose to first order, whatever the covariance of the readings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.poses import Stand
from bayescal.numerics.geometry import Array


class LinearRows(NamedTuple):
    """Rows at one machine.

    ``errors`` (P, R) and ``slope`` (P, R, D) by θ; ``constant`` (P,) of the log-density; ``covariance`` takes what is
    unknown of the errors, in the posterior's coordinates, to (P, R, R). ``basis`` (P, K, R): the directions of white
    readings that they are.
    """

    errors: Array
    slope: Array
    constant: Array
    covariance: Callable[[Array], Array]
    basis: Array


@dataclass(frozen=True, eq=False)
class ReadingRows:
    """P rows of one session.

    Attributes
    ----------
    posterior : CalibrationPosterior
        Of the session by itself: its priors do not count.
    """

    posterior: CalibrationPosterior

    @property
    def n_poses(self) -> int:
        """Number of rows."""
        return self.posterior.likelihood.data.n_poses

    @property
    def width(self) -> int:
        """Channels less coordinates."""
        model = self.posterior.likelihood.model
        return len(model.channels) - len(model.coordinates)

    @property
    def n_errors(self) -> int:
        """What is unknown of the noise."""
        return self.posterior.n_parameters - self.posterior.n_geometry

    def linearise(self, theta: Array) -> LinearRows:
        """Return what no pose explains of the readings at a machine (D,), white by the stated noise."""
        likelihood = self.posterior.likelihood
        own, tau = likelihood.noise(self.posterior.errors, np.zeros((1, self.n_errors)))
        white = likelihood.whiten(np.broadcast_to(likelihood.sd, own.shape), np.zeros_like(tau))
        with np.errstate(all="ignore"):
            at = likelihood.stand(theta[None], white)
            error, slope, by_parameters = likelihood.linearise(theta[None], at.pose, white, with_parameters=True)
            volume = likelihood.log_volume(Stand(at.pose, error, slope), white)[0]
        q = slope.shape[-1]
        basis = np.linalg.qr(np.nan_to_num(slope[0]), mode="complete")[0][:, :, q:]
        across = np.swapaxes(basis, 1, 2)
        spare = likelihood.n_spare
        constant = white.log_det[0] + volume - 0.5 * spare * np.log(2.0 * np.pi)
        there, n = likelihood.data.present, own.shape[-1]
        # of readings as they are to what no pose explains of white ones
        left = across @ white.rows(np.eye(n)[None, None])[0] * there[:, None, :]
        spread = left if likelihood.error_gain is None else left @ likelihood.error_gain
        absent = across * ~there[:, None, :] @ basis

        def covariance(zeta: Array) -> Array:
            own, tau = (one[0] for one in likelihood.noise(self.posterior.errors, zeta[None]))
            stated, added = left * own[:, None, :], spread * tau[:, None, :]
            found = stated @ likelihood.correlation @ np.swapaxes(stated, 1, 2) + added @ np.swapaxes(added, 1, 2)
            return np.asarray(found + absent)

        errors = (across @ error[0][..., None])[..., 0]
        return LinearRows(errors, -(across @ by_parameters[0]), constant, covariance, basis)

    def evaluate(self, theta: Array, errors: Array) -> Array:
        """Return the log-likelihood of machines (B, D) with errors (B, n), poses eliminated, (B,)."""
        with np.errstate(all="ignore"):
            return self.posterior.likelihood.density(theta, self.posterior.errors, errors)
