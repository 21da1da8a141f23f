"""Single rows that are wrong: the density of a row's residual, of unit covariance, by its square r².

A normal density has exp(-r²/2). A robust one lets each row have a precision w of its own, Gamma(ν/2, ν/2) distributed,
that all its readings share: what went wrong at a row spoils it as a whole. Integrated over w, with m readings more than
the pose has coordinates,

    p(r) = Γ((ν + m)/2) / Γ(ν/2) (νπ)^(-m/2) (1 + r²/ν)^(-(ν + m)/2),

and (ν + m) / (ν + r²), the mean of w given r, says how much a row counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from bayescal.numerics.geometry import Array

STEPS = np.arange(-16.0, 8.1, 0.5)  # of log w, in its standard deviations about its mode
ITERATIONS = 20


@dataclass(frozen=True)
class Outliers:
    """Degrees of freedom ν of the rows' density; infinite for a normal one, which has no outliers."""

    freedom: float = np.inf

    @property
    def expected(self) -> bool:
        """Whether rows may be wrong."""
        return bool(np.isfinite(self.freedom))

    def weigh(self, square: Array, spare: np.ndarray) -> Array:
        """Return the log-density of residuals from r² (..., P) and m (P,)."""
        m, nu = spare, self.freedom
        if not self.expected:
            return np.asarray(-0.5 * square - 0.5 * m * np.log(2.0 * np.pi))
        constant = gammaln(0.5 * (nu + m)) - gammaln(0.5 * nu) - 0.5 * m * np.log(nu * np.pi)
        return np.asarray(constant - 0.5 * (nu + m) * np.log1p(square / nu))

    def penalise(self, square: Array, spare: np.ndarray) -> Array:
        """Return minus twice the log-density but for constants: r², or by its logarithm where rows may be wrong."""
        if not self.expected:
            return square
        return np.asarray((self.freedom + spare) * np.log1p(square / self.freedom))

    def trust(self, square: Array, spare: np.ndarray) -> Array:
        """Return the mean of each row's precision w, (..., P); one where the density is normal."""
        if not self.expected:
            return np.ones_like(square)
        return np.asarray((self.freedom + spare) / (self.freedom + square))

    def soften(self, trust: Array, spare: np.ndarray) -> Array:
        """Return c in the curvature w 1 - c r rᵀ of minus the log-density, (..., P)."""
        return np.zeros_like(trust) if not self.expected else np.asarray(2.0 * trust**2 / (self.freedom + spare))

    def draw_widening(self, square: Array, spare: np.ndarray, rng: np.random.Generator) -> Array:
        """Return draws of 1/w given r² (..., P)."""
        if not self.expected:
            return np.ones_like(square)
        shape = np.broadcast_to(0.5 * (self.freedom + spare), square.shape)
        return np.asarray(0.5 * (self.freedom + square) / rng.standard_gamma(shape))

    def weigh_spread(self, size: Array, variance: Array, spare: np.ndarray) -> Array:
        """Return the log-density of residuals that have a known covariance beside the noise.

        Parameters
        ----------
        size : ndarray, shape (..., P, K)
            Residuals along the axes of that covariance.
        variance : ndarray, shape (..., P, K)
            It, in units of the noise's; zero along axes that a pose takes up.
        spare : ndarray, shape (P,)
            m.
        """
        if not self.expected:
            inside = np.log1p(variance) + size**2 / (1.0 + variance)
            return np.asarray(-0.5 * inside.sum(axis=-1) - 0.5 * spare * np.log(2.0 * np.pi))
        nu, m = self.freedom, spare
        best = self.trust((size**2 / (1.0 + variance)).sum(axis=-1), m)
        for _ in range(ITERATIONS):  # to the mode of log w given the row
            part = 1.0 / (1.0 + best[..., None] * variance)
            best = (nu + m - (1.0 - part).sum(axis=-1)) / (nu + ((size * part) ** 2).sum(axis=-1))
        width, parts = np.sqrt(2.0 / (nu + m)), []
        for step in STEPS:  # the trapezium rule in log w
            w = best * np.exp(width * step)
            inside = np.log1p(w[..., None] * variance) + w[..., None] * size**2 / (1.0 + w[..., None] * variance)
            parts.append(0.5 * ((nu + m) * np.log(w) - nu * w - inside.sum(axis=-1)))
        constant = 0.5 * nu * np.log(0.5 * nu) - gammaln(0.5 * nu) - 0.5 * m * np.log(2.0 * np.pi)
        return np.asarray(np.logaddexp.reduce(parts, axis=0) + np.log(width * (STEPS[1] - STEPS[0])) + constant)


NORMAL = Outliers()
