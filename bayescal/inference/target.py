"""What inference needs of a posterior: any density with these members is explored, sampled and integrated alike."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from bayescal.density.components import LinearGeometry
from bayescal.density.posterior import ScaleDependence
from bayescal.density.priors import Prior
from bayescal.numerics.geometry import Array


class PriorSampleable(Protocol):
    """What tempering needs: a prior to draw from, in coordinates y of n entries, and what the data make of it."""

    @property
    def n_parameters(self) -> int:
        """Number n of coordinates."""

    def draw_prior(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the prior, shape (n_draws, n); NaN where there are no coordinates, which have no density."""

    def log_prior(self, y: Array) -> Array:
        """Return the log-prior in the coordinates, (B, n) to (B,), normalised over y and what has no coordinates."""

    def log_density(self, y: Array) -> Array:
        """Return log-likelihood plus log-prior, (B, n) to (B,), -inf where there is no machine."""


class LogDensity(PriorSampleable, Protocol):
    """A posterior in sampling coordinates y of n entries, first those of the geometry, then those of model errors.

    The geometry's coordinates are in units of the prior standard deviations; zero is the machine as expected. Each of N
    groups of them has a model error.
    """

    @property
    def n_geometry(self) -> int:
        """How many of them belong to the geometry."""

    def natural(self, y: Array) -> Array:
        """Return the parameters in their own units, (..., n) to (..., n)."""

    def exact(self) -> LogDensity | None:
        """Return the same posterior by a density that is slower and leaves nothing out; None where there is none."""

    def pointwise(self, y: Array) -> Array:
        """Return the log-likelihood of each of P poses given all others, (B, n) to (B, P)."""

    def gradient(self, y: Array) -> tuple[Array, Array]:
        """Return the gradient (n,) of the log-density at y, shape (n,), and its Gauss-Newton Hessian (n, n)."""

    def newton(self, y: Array) -> tuple[Array, Array]:
        """Return the gradient (n,), and the Hessian (n, n) as exactly as it is cheap, definite or not, to climb by."""

    # --- climbing ------------------------------------------------------------------------------------------------

    def least_squares_start(self) -> Array:
        """Return a start near the mode, shape (n,)."""

    def refine_geometry(self, y: Array) -> Array:
        """Return y, shape (n,), with the geometry that is best at its model errors."""

    def mode_candidates(self, y: Array) -> list[tuple[int, Array]]:
        """Return where other modes may be, seen from a mode at y, shape (n,): a jump's number, and where it leads.

        A jump of the same number leads back from there.
        """

    # --- straightening -------------------------------------------------------------------------------------------

    def funnel_errors(self, y: Array) -> Array:
        """Return the errors that make the geometry uncertain, (B, n) to (B, N); of no matter without a funnel."""

    def groups(self) -> list[np.ndarray]:
        """Return which coordinates of the geometry belong to each group."""

    def curved_ridges(self) -> list[tuple[int, np.ndarray]]:
        """Return coordinates along which the density has a curved ridge, each with those that follow it there.

        No coordinate that follows one has a ridge along itself.
        """

    def linear_geometry(self, y: Array) -> LinearGeometry | None:
        """Return the geometry about y, shape (n,), as normal given the errors; None where `funnel` tells enough."""

    def scale_dependence(self, y: Array) -> ScaleDependence | None:
        """Return what makes the geometry the less certain the larger a model error, at y (n,); None without them."""


class LogPosterior(LogDensity, Protocol):
    """A posterior whose fit is judged, too: its rows are left out one by one, its priors are varied."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, as `natural` has them."""

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""

    def theta(self, y: Array) -> Array:
        """Return full parameter vectors (B, D) of coordinates (B, n)."""

    def to_coordinates(self, theta: Array, errors: Array) -> Array:
        """Return the coordinates (M, n) of machines θ (M, D), brought within the priors' bounds, and of errors.

        The latter are in coordinates, (M, n - m).
        """

    def all_priors(self) -> Mapping[str, Prior]:
        """Return the priors of all parameters in their own units, by name and in order."""

    def pointwise_of(self, y: Array, row: int) -> Array:
        """Return the log-likelihood of one row given all others, (B, n) to (B,)."""

    def row_information(self, y: Array, row: int) -> Array:
        """Return what one row tells of the geometry at y beyond all others, shape (m, m)."""
