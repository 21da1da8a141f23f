"""The posterior density of one variant in sampling coordinates: machine's coordinates × elimination × errors.

One class for every machine. What is special about legs, or about a machine that one function describes, stands in its
coordinates (`Sampling`) and in its density of the measurements (`Elimination`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self, final

import numpy as np

from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.components import LinearGeometry, LinearRows
from bayescal.density.priors import HALF_LOG_TWO_PI, Prior
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class ScaleDependence:
    """How the geometry depends on the model errors around a point."""

    information: Array  # (m, m): of the data on the geometry
    prior: Array  # (m, m): precision of the prior on the geometry
    rest: Array  # (N,): each group's variance but for the model error, in the model errors' unit squared
    tau: Array  # (N,): each of `Target.funnel_errors` there
    # (N, m, m): what of the information each model error governs; None where group i's governs group i
    parts: Array | None = None


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
    moved : ndarray, shape (m, D)
        Which parameters go with which free one, ones and zeros.
    n_jumps : int
        Numbers of `jumps` are below it.
    """

    layout: ParameterLayout
    start: Array
    moved: Array
    priors: tuple[Prior, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    n_jumps: int = 0

    @property
    @abstractmethod
    def free(self) -> np.ndarray:
        """Where the free parameters stand in θ, the first of those that deviate alike, shape (m,)."""

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

    def to_coordinates(self, theta: Array) -> Array:
        """Return the same, of machines that may lie beyond the priors' bounds, brought within; by default none has."""
        return self.y_from_theta(theta)

    def natural(self, theta: Array) -> Array:
        """Return the free parameters in their own units, (..., D) to (..., m)."""
        return theta[..., self.free]

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

    def mode_candidates(self, y: Array) -> list[tuple[int, Array]]:
        """Return where other modes may be, seen from y (m,), none by default; see `LogDensity.mode_candidates`."""
        del y
        return []

    def curved_ridges(self) -> list[tuple[int, np.ndarray]]:
        """Return coordinates along which the density has a curved ridge; see `Target.curved_ridges`."""
        return []


class Elimination[S: Sampling, E: ErrorModel](ABC):
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

    def with_pose_guesses(self, sampling: S, errors: E) -> Self:
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
    def least_squares_start(self, sampling: S, errors: E) -> Array:
        """Return initial values near the mode, shape (m + k,)."""

    @abstractmethod
    def refine_geometry(self, sampling: S, errors: E, y: Array) -> Array:
        """Return y, shape (m + k,), with the geometry that is best at its errors."""

    @abstractmethod
    def exact(self) -> Self | None:
        """Return the same density without what it leaves out for speed; None where that is nothing."""

    def begin_at(self, sampling: S) -> Array:
        """Return the geometry's coordinates (m,) from which searches begin: by default the machine as expected."""
        return np.zeros(sampling.size)

    # --- straightening -------------------------------------------------------------------------------------------

    def groups(self, sampling: S, errors: E) -> list[np.ndarray]:
        """Return which coordinates an error makes uncertain together; by default all of them."""
        del errors
        return [np.arange(sampling.size)]

    @abstractmethod
    def funnel_errors(self, errors: E, zeta: Array) -> Array:
        """Return the errors that the geometry's uncertainty depends on, (B, k) to (B, N)."""

    def linear_rows(self, sampling: S, errors: E, y: Array, cause: str = "") -> LinearRows | None:
        """Return the rows about y, shape (m + k,), as linear in the geometry, with a covariance that depends on ζ.

        Columns of a named cause (`bayescal.density.directions`) stand behind the geometry's. None, by default, where
        the rows of a pose depend on no other's, so that `funnel` tells enough; and where a cause has no columns.
        """
        del sampling, errors, y, cause
        return None

    @abstractmethod
    def scale_dependence(self, sampling: S, errors: E, y: Array) -> ScaleDependence | None:
        """Return how the geometry depends on the errors at y, shape (m + k,); None where it does not."""


@final
@dataclass(frozen=True, eq=False)
class Posterior[L: Elimination[Any, Any], S: Sampling, E: ErrorModel]:
    """Posterior of the free parameters and errors of one variant; a `bayescal.inference.target.LogDensity`."""

    likelihood: L  # density of the measurements at the calibration poses
    priors: Mapping[str, Prior]  # of the free parameters
    errors: E  # what is unknown of the errors; their coordinates come behind those of the geometry
    fixed: Mapping[str, float] = field(default_factory=dict)  # values of fixed parameters that are not nominal
    # parameters that deviate alike from their nominal values, under the name that their prior has
    common: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that every name exists."""
        _ = self.sampling

    # --- parameters ----------------------------------------------------------------------------------------------

    @cached_property
    def sampling(self) -> S:
        """Coordinates of the geometry."""
        found: S = self.likelihood.sampling(self.priors, self.fixed, self.common)
        return found

    @property
    def n_geometry(self) -> int:
        """Number m of coordinates of the geometry."""
        return len(self.priors)

    @property
    def n_parameters(self) -> int:
        """Number n of sampling coordinates: free parameters and errors."""
        return self.n_geometry + self.errors.n_parameters

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, then of the errors'."""
        return (*self.sampling.names, *self.errors.names)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of all."""
        return (*self.sampling.units, *self.errors.units)

    def all_priors(self) -> dict[str, Prior]:
        """Return the priors of everything that is free by name, in order."""
        return dict(zip(self.names, (*self.sampling.priors, *self.errors.priors), strict=True))

    @cached_property
    def prior_sd(self) -> Array:
        """Standard deviations of all priors, shape (n,)."""
        return np.array([prior.sd for prior in self.all_priors().values()])

    def theta(self, y: Array) -> Array:
        """Return full parameter vectors (B, D) of coordinates (B, n)."""
        return self.sampling.theta_from_y(y[..., : self.n_geometry])

    def zeta(self, y: Array) -> Array:
        """Return the coordinates of the errors, (..., n) to (..., k)."""
        return y[..., self.n_geometry :]

    def at(self, y: Array) -> tuple[Array, E, Array]:
        """Return what a likelihood takes of coordinates (B, n): θ (B, D), the errors and their coordinates (B, k)."""
        return self.theta(y), self.errors, self.zeta(y)

    def natural(self, y: Array) -> Array:
        """Return everything that is free in its own unit, (..., n)."""
        return np.concatenate([self.sampling.natural(self.theta(y)), self.errors.natural(self.zeta(y))], axis=-1)

    def to_coordinates(self, theta: Array, zeta: Array) -> Array:
        """Return the coordinates (M, n) of machines θ (M, D), brought within the priors' bounds, and of errors ζ."""
        return np.concatenate([self.sampling.to_coordinates(theta), zeta], axis=-1)

    # --- density -------------------------------------------------------------------------------------------------

    def log_prior(self, y: Array) -> Array:
        """Return the log-prior in the coordinates, shape (B,), normalised over y."""
        return self._log_prior(y, self.theta(y))

    def _log_prior(self, y: Array, theta: Array) -> Array:
        deviations = self.errors.deviations(self.zeta(y))
        constant = self.errors.log_mass - self.errors.n_parameters * HALF_LOG_TWO_PI
        own = constant - 0.5 * np.einsum("...i,...i->...", deviations, deviations)
        return np.asarray(self.sampling.log_prior(y[..., : self.n_geometry], theta) + own)

    def draw_prior(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the prior in the coordinates, shape (n_draws, n); NaN where they are no coordinates."""
        y, m = rng.standard_normal((n_draws, self.n_parameters)), self.n_geometry
        y[:, :m] = self.sampling.draw(y[:, :m])
        y[:, m:] = self.errors.draw(y[:, m:], rng)
        return y

    def log_density(self, y: Array) -> Array:
        """Return log-likelihood plus log-prior, shape (B,), for coordinates (B, n); -inf where there is no machine."""
        with np.errstate(all="ignore"):  # far out numbers overflow; what is not finite has no density
            theta = self.theta(y)
            inside = self.likelihood.layout.inside(theta)
            if not inside.all():
                theta[~inside] = self.sampling.start  # keeps what is no machine out of the models
            total = self._log_prior(y, theta) + self.likelihood.density(theta, self.errors, self.zeta(y))
        return np.where(inside & np.isfinite(total), total, -np.inf)

    def pointwise(self, y: Array) -> Array:
        """Return the log-likelihood of each row of the data given all others, (B, n) to (B, P)."""
        return self.likelihood.density_by_row(*self.at(y))

    def pointwise_of(self, y: Array, row: int) -> Array:
        """Return the log-likelihood of one row given all others, (B, n) to (B,)."""
        return self.likelihood.density_of_row(*self.at(y), row)

    def predict_density(self, other: L, y: Array) -> Array:
        """Return the log-density of each of Q other rows given these, (B, n) to (B, Q)."""
        return self.likelihood.density_of_others(other, *self.at(y))

    def with_pose_guesses(self) -> Posterior[L, S, E]:
        """Return the same posterior, prepared for machines that explain the data."""
        return replace(self, likelihood=self.likelihood.with_pose_guesses(self.sampling, self.errors))

    def exact(self) -> Posterior[L, S, E] | None:
        """Return the same posterior by a density that leaves nothing out; None where there is none."""
        likelihood = self.likelihood.exact()
        return None if likelihood is None else replace(self, likelihood=likelihood)

    # --- derivatives ---------------------------------------------------------------------------------------------

    def information(self, y: Array) -> tuple[Array, Array]:
        """Return the information of the data and the precision of the prior on the geometry at y, shapes (m, m)."""
        theta, change = self.around(y)
        rows = self.sampling.prior_slope(change)
        return self.likelihood.inform(theta, change, self.errors, self.zeta(y)), rows.T @ rows

    def row_information(self, y: Array, row: int) -> Array:
        """Return what one row tells of the geometry at y beyond all others, shape (m, m); see `pointwise`."""
        return self.likelihood.inform_row(*self.around(y), self.errors, self.zeta(y), row)

    @cached_property
    def begin(self) -> Array:
        """Coordinates from which searches begin, shape (n,): the machine as expected, or nearer to the data."""
        return np.append(self.likelihood.begin_at(self.sampling), np.zeros(self.errors.n_parameters))

    @cached_property
    def first_machine(self) -> Array:
        """The machine from which searches begin, (D,)."""
        return np.asarray(self.theta(self.begin[None])[0])

    def around(self, y: Array) -> tuple[Array, Array]:
        """Return θ (D,) and dθ/dy (D, m) at y, shape (n,)."""
        theta = self.theta(y[None])[0]
        return theta, self.sampling.jacobian(theta)

    def gradient(self, y: Array) -> tuple[Array, Array]:
        """Return the exact gradient (n,) of the log-density at y, shape (n,), and its Gauss-Newton Hessian (n, n)."""
        return self._differentiate(y, newton=False)

    def newton(self, y: Array) -> tuple[Array, Array]:
        """Return the gradient (n,) at y, and the Hessian (n, n) as exactly as it is cheap, definite or not."""
        return self._differentiate(y, newton=True)

    def _differentiate(self, y: Array, newton: bool) -> tuple[Array, Array]:
        m, zeta, (theta, change) = self.n_geometry, self.zeta(y), self.around(y)
        gradient, hessian = self.likelihood.differentiate(theta, change, self.errors, zeta, newton)
        rows = self.sampling.prior_slope(change)
        gradient[:m] -= self.sampling.prior_residual(y[:m], theta) @ rows
        gradient[:m] += self.sampling.log_volume_slope(y[:m], theta, change)
        hessian[:m, :m] -= rows.T @ rows
        gradient[m:] -= self.errors.deviations(zeta)
        hessian[m:, m:] -= np.eye(len(zeta))
        return gradient, hessian

    # --- what inference asks for besides -------------------------------------------------------------------------

    def least_squares_start(self) -> Array:
        """Return initial values near the mode, shape (n,)."""
        return self.likelihood.least_squares_start(self.sampling, self.errors)

    def refine_geometry(self, y: Array) -> Array:
        """Return y, shape (n,), with the geometry that is best at its errors."""
        return self.likelihood.refine_geometry(self.sampling, self.errors, y)

    def mode_candidates(self, y: Array) -> list[tuple[int, Array]]:
        """Return where other modes of geometry and errors may be, seen from y; see `LogDensity.mode_candidates`."""
        m, first = self.n_geometry, self.sampling.n_jumps + self.n_geometry
        found = [(jump, np.append(image, y[m:])) for jump, image in self.sampling.mode_candidates(y[:m])]
        return found + [(first + k, np.append(y[:m], image)) for k, image in self.errors.mode_candidates(self.zeta(y))]

    def curved_ridges(self) -> list[tuple[int, np.ndarray]]:
        """Return coordinates along which the density has a curved ridge; see `Target.curved_ridges`."""
        return self.sampling.curved_ridges()

    def groups(self) -> list[np.ndarray]:
        """Return which coordinates of the geometry an error makes uncertain together."""
        return self.likelihood.groups(self.sampling, self.errors)

    def funnel_errors(self, y: Array) -> Array:
        """Return the errors that the geometry's uncertainty depends on, (B, n) to (B, N)."""
        return self.likelihood.funnel_errors(self.errors, self.zeta(y))

    def scale_dependence(self, y: Array) -> ScaleDependence | None:
        """Return how the geometry depends on the errors at y, shape (n,); None where it does not."""
        return self.likelihood.scale_dependence(self.sampling, self.errors, y)

    def linear_geometry(self, y: Array, cause: str = "") -> LinearGeometry | None:
        """Return the geometry as linear in the rows about y, shape (n,); None where `funnel` tells what errors do.

        The columns of a named cause, if any, stand behind the geometry's, without a prior.
        """
        rows = self.likelihood.linear_rows(self.sampling, self.errors, y, cause)
        if rows is None:
            return None
        m, (theta, change) = self.n_geometry, self.around(y)
        slope = self.sampling.prior_slope(change)
        precision, pull, centre = rows.information.copy(), rows.pull.copy(), np.zeros(len(rows.pull))
        precision[:m, :m] += slope.T @ slope
        pull[:m] -= self.sampling.prior_residual(y[:m], theta) @ slope
        pull[:m] += self.sampling.log_volume_slope(y[:m], theta, change)
        centre[:m] = y[:m]

        def log_prior(zeta: Array) -> Array:
            return np.asarray(-0.5 * np.sum(self.errors.deviations(zeta) ** 2, axis=-1))

        return LinearGeometry(centre, rows, precision, pull, log_prior, self.errors.natural)
