"""What a posterior is made of: coordinates of the machine, errors, and a density of the measurements."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Self

import numpy as np

from bayescal.density.calibration.terms import Errors
from bayescal.density.local import Funnel
from bayescal.density.priors import Prior
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array


class Sampling(ABC):
    """Sampling coordinates y of a machine's m free parameters, in units of their priors; zero is the machine expected.

    Attributes
    ----------
    layout : ParameterLayout
        Of θ (D,).
    start : ndarray, shape (D,)
        The machine as expected.
    priors : tuple of Prior, length m
        Of the free parameters, in order.
    names, units : tuple of str, length m
    n_jumps : int
        Numbers of `jumps` are below it.
    """

    layout: ParameterLayout
    start: Array
    priors: tuple[Prior, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    n_jumps: int = 0

    @property
    def size(self) -> int:
        """Number m of coordinates."""
        return len(self.names)

    @abstractmethod
    def theta_from_y(self, y: Array) -> Array:
        """Return full parameter vectors, (..., m) to (..., D)."""

    @abstractmethod
    def y_from_theta(self, theta: Array) -> Array:
        """Return coordinates of parameter vectors, (..., D) to (..., m)."""

    def adopt(self, theta: Array) -> Array:
        """Return the same, of machines that may lie beyond the priors' bounds, brought within; by default none has."""
        return self.y_from_theta(theta)

    @abstractmethod
    def natural(self, theta: Array) -> Array:
        """Return the free parameters in their own units, (..., D) to (..., m)."""

    @abstractmethod
    def jacobian(self, theta: Array) -> Array:
        """Return dθ/dy at one vector θ (D,), shape (D, m)."""

    @abstractmethod
    def log_prior(self, y: Array, theta: Array) -> Array:
        """Return the log-prior in the coordinates, shape (B,), normalised, at (B, m) and their θ (B, D)."""

    @abstractmethod
    def prior_residual(self, y: Array, theta: Array) -> Array:
        """Return the prior as residuals of unit variance, shape (m,), at (m,) and θ (D,)."""

    @abstractmethod
    def prior_slope(self, change: Array) -> Array:
        """Return the derivative of `prior_residual`, shape (m, m), from dθ/dy (D, m)."""

    def log_volume_slope(self, y: Array, theta: Array, change: Array) -> Array:
        """Return the derivative of what the log-prior has beside these residuals, shape (m,); by default nothing."""
        del theta, change
        return np.zeros(len(y))

    @abstractmethod
    def draw(self, standard: Array) -> Array:
        """Return draws of the prior from standard normal numbers (S, m); NaN where they are no coordinates."""

    def jumps(self, y: Array) -> list[tuple[int, Array]]:
        """Return where other modes may be, seen from y (m,); see `Target.jumps`. By default none is expected."""
        del y
        return []

    def curved_ridges(self) -> list[tuple[int, np.ndarray]]:
        """Return coordinates along which the density has a curved ridge; see `Target.curved_ridges`."""
        return []


class Elimination[S: Sampling, E: Errors](ABC):
    """The density of measured rows under a machine θ (D,) and errors with coordinates ζ (k,), the poses eliminated."""

    layout: ParameterLayout

    @abstractmethod
    def sampling(
        self, priors: Mapping[str, Prior], fixed: Mapping[str, float], common: Mapping[str, tuple[str, ...]]
    ) -> S:
        """Return the coordinates in which the machine's free parameters are sampled.

        Parameters
        ----------
        priors : mapping of name to Prior
            Of the free parameters, or of names in ``common``.
        fixed : mapping of parameter name to float
            Values of fixed parameters that are not nominal.
        common : mapping of name to tuple of parameter names
            Parameters that deviate alike from their nominal values.
        """

    @abstractmethod
    def density(self, theta: Array, errors: E, zeta: Array) -> Array:
        """Return the log-likelihood, (B, D) and (B, k) to (B,); -inf where there is no machine."""

    @abstractmethod
    def density_by_row(self, theta: Array, errors: E, zeta: Array) -> Array:
        """Return the log-likelihood of each of P rows given all others, shape (B, P)."""

    def density_of_row(self, theta: Array, errors: E, zeta: Array, row: int) -> Array:
        """Return the log-likelihood of one row given all others, shape (B,)."""
        return np.asarray(self.density_by_row(theta, errors, zeta)[:, row])

    def density_of_others(self, other: Self, theta: Array, errors: E, zeta: Array) -> Array:
        """Return the log-density of each of Q other rows given these, shape (B, Q); by default these say nothing."""
        return other.density_by_row(theta, errors, zeta)

    def anchored(self, sampling: S, errors: E) -> Self:
        """Return the same density, prepared for machines that explain the data; by default as it is."""
        del sampling, errors
        return self

    @abstractmethod
    def differentiate(self, theta: Array, change: Array, errors: E, zeta: Array, newton: bool) -> tuple[Array, Array]:
        """Return gradient (m + k,) and Hessian (m + k, m + k) of the log-likelihood at θ (D,), ζ (k,), dθ/dy (D, m).

        The Hessian is Gauss and Newton's; where ``newton`` asks for it, as exact as it is cheap.
        """

    @abstractmethod
    def inform(self, theta: Array, change: Array, errors: E, zeta: Array) -> Array:
        """Return the information of the data on the geometry's coordinates, shape (m, m)."""

    @abstractmethod
    def inform_row(self, theta: Array, change: Array, errors: E, zeta: Array, row: int) -> Array:
        """Return what one row tells of the geometry's coordinates beyond all others, shape (m, m)."""

    @abstractmethod
    def approach(self, sampling: S, errors: E) -> Array:
        """Return initial values near the mode, shape (m + k,)."""

    @abstractmethod
    def polish(self, sampling: S, errors: E, y: Array) -> Array:
        """Return y, shape (m + k,), with the geometry that is best at its errors."""

    @abstractmethod
    def finer(self) -> Self | None:
        """Return the same density without what it leaves out for speed; None where that is nothing."""

    # --- straightening -------------------------------------------------------------------------------------------

    def groups(self, sampling: S, errors: E) -> list[np.ndarray]:
        """Return which coordinates an error makes uncertain together; by default all of them."""
        del errors
        return [np.arange(sampling.size)]

    @abstractmethod
    def funnel_errors(self, errors: E, zeta: Array) -> Array:
        """Return the errors that the geometry's uncertainty depends on, (B, k) to (B, N)."""

    @abstractmethod
    def funnel(self, sampling: S, errors: E, y: Array) -> Funnel | None:
        """Return how the geometry depends on the errors at y, shape (m + k,); None where it does not."""
