"""What is not known of the noise: a factor on that of each group of channels, and a model error beside it.

The standard deviation of a reading of group g is sqrt((s_g σ)² + τ_g²). The factor s_g is lognormal about one, the
model error τ_g half normal. Their sampling coordinates are standard normal under the prior.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.special import erfcinv, erfinv, ndtr

from bayescal.density.model_error import LengthPrior
from bayescal.density.priors import HalfNormalPrior, Prior
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Unknown factors and model errors of the noise of K channels.

    Attributes
    ----------
    scale_names, tau_names : tuple of str
        Names of the groups with an unknown factor, and of those with a model error.
    scale_of, tau_of : ndarray of int, shape (K,)
        Which of them a channel has; -1 for none.
    log_sd : ndarray, shape (number of factors,)
        Standard deviations of log s.
    tau_scale : ndarray, shape (number of model errors,)
        Scales of the half normals, in the channels' units.
    tau_units : tuple of str
    """

    scale_of: np.ndarray
    tau_of: np.ndarray
    scale_names: tuple[str, ...] = ()
    tau_names: tuple[str, ...] = ()
    log_sd: Array = field(default_factory=lambda: np.empty(0))
    tau_scale: Array = field(default_factory=lambda: np.empty(0))
    tau_units: tuple[str, ...] = ()

    @property
    def n_parameters(self) -> int:
        """Number of unknown factors and model errors."""
        return len(self.scale_names) + len(self.tau_names)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all: ``noise_factor(motor)``, ``model_error(motor)``."""
        factors = tuple(f"noise_factor({name})" for name in self.scale_names)
        return (*factors, *(f"model_error({name})" for name in self.tau_names))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of all."""
        return ("1",) * len(self.scale_names) + self.tau_units

    @cached_property
    def groups(self) -> Array:
        """Which channels have the same unknowns of their noise, or none, ones and zeros (N, K)."""
        both = np.stack([self.scale_of, self.tau_of])
        kinds = np.unique(both, axis=1)
        return (both[:, None, :] == kinds[:, :, None]).all(axis=0).astype(np.float64)

    def natural(self, zeta: Array) -> Array:
        """Return factors and model errors (..., n) from their coordinates."""
        n = len(self.scale_names)
        tau = np.sqrt(2.0) * self.tau_scale * _half_normal(zeta[..., n:])
        return np.concatenate([np.exp(self.log_sd * zeta[..., :n]), tau], axis=-1)

    @property
    def priors(self) -> tuple[Prior, ...]:
        """Priors of all, in order."""
        factors = (LengthPrior(1.0, float(sd)) for sd in self.log_sd)
        return (*factors, *(HalfNormalPrior(float(scale)) for scale in self.tau_scale))

    def deviations(self, zeta: Array, sd: Array) -> tuple[Array, Array]:
        """Return s σ and τ of all readings, (B, P, K) and (B, 1, K), from coordinates (B, n) and stated σ (P, K)."""
        natural, n = self.natural(zeta), len(self.scale_names)
        one, zero = np.ones((len(zeta), 1)), np.zeros((len(zeta), 1))
        factor = np.concatenate([natural[:, :n], one], axis=1)[:, self.scale_of]
        tau = np.concatenate([natural[:, n:], zero], axis=1)[:, self.tau_of]
        return factor[:, None] * sd, tau[:, None]

    def covariance_slopes(self, zeta: Array, sd: Array, correlation: Array) -> Array:
        """Return the derivatives of the readings' covariance by the coordinates at (n,), shape (n, P, K, K).

        Parameters
        ----------
        zeta : ndarray, shape (n,)
        sd : ndarray, shape (P, K)
        correlation : ndarray, shape (P, K, K) or (1, K, K)
        """
        own, _ = (one[0] for one in self.deviations(zeta[None], sd))
        stated = own[:, :, None] * correlation * own[:, None, :]
        n, natural = len(self.scale_names), self.natural(zeta)
        slopes = np.zeros((self.n_parameters, *stated.shape))
        for k in range(n):
            mine = (self.scale_of == k).astype(np.float64)
            slopes[k] = self.log_sd[k] * stated * (mine[:, None] + mine)
        for k, scale in enumerate(self.tau_scale):
            size, at = natural[n + k], zeta[n + k]
            speed = 0.5 * scale * np.exp(0.5 * ((size / scale) ** 2 - at**2))
            slopes[n + k] = np.diag(np.where(self.tau_of == k, 2.0 * size * speed, 0.0))
        return slopes


def _half_normal(zeta: Array) -> Array:
    """Return erfinv Φ(ζ) without loss where Φ(ζ) is close to one."""
    return np.where(zeta > 0, erfcinv(ndtr(-zeta)), erfinv(ndtr(zeta)))
