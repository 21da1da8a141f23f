"""What inference needs of a posterior: any density with these members is explored, sampled and integrated alike."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from bayescal.numerics.geometry import Array


class Target(Protocol):
    """A posterior in sampling coordinates y of n entries, first those of the geometry, then those of model errors.

    The geometry's coordinates are in units of the prior standard deviations; zero is the machine as expected.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, one per coordinate."""

    @property
    def n_parameters(self) -> int:
        """Number n of coordinates."""

    @property
    def n_geometry(self) -> int:
        """How many of them belong to the geometry."""

    def natural(self, y: Array) -> Array:
        """Return the parameters in their own units, (..., n) to (..., n)."""

    def log_density(self, y: Array) -> Array:
        """Return the log-density, (B, n) to (B,), -inf where there is no machine."""

    def gradient(self, y: Array) -> tuple[Array, Array]:
        """Return the gradient (n,) of the log-density at y, shape (n,), and its Gauss-Newton Hessian (n, n)."""

    # --- climbing ------------------------------------------------------------------------------------------------

    def approach(self) -> Array:
        """Return a start near the mode, shape (n,)."""

    def polish(self, y: Array) -> Array:
        """Return y, shape (n,), with the geometry that is best at its model errors."""

    def mirror_images(self, y: Array) -> list[tuple[int, Array]]:
        """Return legs and where other modes may be, reached by changing one leg each."""

    # --- straightening -------------------------------------------------------------------------------------------

    def tau(self, y: Array) -> Array:
        """Return the model error of each leg in mm, shape (B, N)."""

    def leg_coordinates(self) -> list[np.ndarray]:
        """Return which geometric coordinates belong to each leg."""

    def funnel(self, y: Array) -> Funnel | None:
        """Return what makes the geometry the less certain the larger a model error, at y (n,); None without them."""


class Funnel(Protocol):
    """How the geometry depends on the model errors around a point."""

    @property
    def information(self) -> Array:
        """Of the data on the geometry, shape (m, m)."""

    @property
    def prior(self) -> Array:
        """Precision of the prior on the geometry, shape (m, m)."""

    @property
    def rest(self) -> Array:
        """Each leg's variance but for the model error, shape (N,), mm²."""

    @property
    def tau(self) -> Array:
        """Each leg's model error, shape (N,), mm."""
