"""Posterior of a self-calibration in coordinates for inference: tolerances about the nominal machine as priors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.optimize import least_squares

from bayescal.density.priors import NormalPrior
from bayescal.density.readings.change import change_density
from bayescal.density.readings.left_over import LeftOver
from bayescal.density.readings.likelihood import ReadingLikelihood
from bayescal.errors import InputError
from bayescal.limits import FAR_AWAY
from bayescal.numerics.geometry import Array

HALF_LOG_TWO_PI = 0.5 * float(np.log(2 * np.pi))


@dataclass(frozen=True, eq=False)
class SelfCalibrationPosterior:
    """Posterior of the free parameters; coordinates are deviations from the prior's centre in its standard deviations.

    It is a `bayescal.inference.target.Target` without model errors.

    Attributes
    ----------
    likelihood : ReadingLikelihood
    priors : mapping of parameter name to NormalPrior
        Of the free parameters; the others keep their nominal values.
    fixed : mapping of parameter name to float
        Values of fixed parameters that are not nominal.
    common : mapping of name to tuple of parameter names
        Parameters that deviate alike, such as legs made in one jig, under the name that their prior has; its centre is
        that of the first of them.
    """

    likelihood: ReadingLikelihood
    priors: Mapping[str, NormalPrior]
    fixed: Mapping[str, float] = field(default_factory=dict)
    common: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the names and that there are at least as many equations as free parameters."""
        layout = self.likelihood.sensors.model.layout
        single = [name for name in self.priors if name not in self.common]
        shared = [name for members in self.common.values() for name in members]
        for name in (*single, *shared, *self.fixed):
            if name not in layout.names:
                raise InputError(f"parameter {name!r}: unknown here, expected one of {', '.join(layout.symbols)}")
        self.likelihood.sensors.check(self.likelihood.n_poses, len(self.priors))

    @cached_property
    def geometry_names(self) -> tuple[str, ...]:
        """Names of the machine's free parameters, in the layout's order."""
        return tuple(sorted(self.priors, key=lambda name: self._places(name)[0]))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of everything that is free, n of them."""
        return self.geometry_names

    @property
    def units(self) -> tuple[str, ...]:
        """Units of all."""
        return tuple(self.likelihood.sensors.model.layout.units[place] for place in self.free)

    def _places(self, name: str) -> list[int]:
        """Return where the parameters of a coordinate stand in the layout."""
        names = self.likelihood.sensors.model.layout.names
        return [names.index(member) for member in self.common.get(name, (name,))]

    @cached_property
    def free(self) -> np.ndarray:
        """Where the machine's stand in the layout, the first of those that deviate alike, shape (m,)."""
        return np.array([self._places(name)[0] for name in self.geometry_names], dtype=int)

    @cached_property
    def moves(self) -> Array:
        """How parameters move with the machine's coordinates, shape (m, D)."""
        moves = np.zeros((self.n_geometry, self.likelihood.sensors.model.layout.size))
        for k, name in enumerate(self.geometry_names):
            moves[k, self._places(name)] = self.scale[k]
        return moves

    @cached_property
    def centre(self) -> Array:
        """The machine as expected, shape (D,)."""
        layout = self.likelihood.sensors.model.layout
        theta = layout.nominal.copy()
        for name, value in self.fixed.items():
            theta[layout.names.index(name)] = value
        for name, prior in self.priors.items():
            places = self._places(name)
            theta[places] += prior.centre - theta[places[0]]
        return theta

    @cached_property
    def scale(self) -> Array:
        """Standard deviations of the machine's priors, shape (m,)."""
        return np.array([self.priors[name].scale for name in self.geometry_names])

    @property
    def prior_sd(self) -> Array:
        """Standard deviations of all priors, shape (n,)."""
        return self.scale

    @property
    def n_parameters(self) -> int:
        """Number n of coordinates."""
        return len(self.names)

    @property
    def n_geometry(self) -> int:
        """How many of them m are parameters of the machine."""
        return len(self.priors)

    def theta(self, y: Array) -> Array:
        """Return full parameter vectors (B, D) of coordinates (B, n)."""
        return np.asarray(self.centre + y[..., : self.n_geometry] @ self.moves)

    def natural(self, y: Array) -> Array:
        """Return everything that is free in its own unit, (..., n)."""
        return np.asarray(self.centre[self.free] + y * self.scale)

    def log_coordinates(self, y: Array) -> Array:
        """Return the log-prior of each coordinate, (..., n)."""
        return np.asarray(-0.5 * y**2 - HALF_LOG_TWO_PI)

    def log_parameters(self, y: Array) -> Array:
        """Return the log-prior of each parameter in its own unit, (..., n)."""
        return change_density(self.log_coordinates(y), self.natural, y)

    def log_prior(self, y: Array) -> Array:
        """Return the log-prior in the coordinates, (B, n) to (B,)."""
        return np.asarray(-0.5 * np.einsum("...i,...i->...", y, y) - self.n_parameters * HALF_LOG_TWO_PI)

    def draw_prior(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the prior in the coordinates, shape (n_draws, n)."""
        return rng.standard_normal((n_draws, self.n_parameters))

    def log_density(self, y: Array) -> Array:
        """Return log-likelihood plus log-prior, (B, n) to (B,), -inf where there is no machine."""
        with np.errstate(all="ignore"):
            total = self.log_prior(y) + self.likelihood(self.theta(y))
        return np.where(np.isfinite(total), total, -np.inf)

    def finer(self) -> None:
        """Return None: the density leaves nothing out."""

    def pointwise(self, y: Array) -> Array:
        """Return the log-likelihood of each pose's readings, (B, n) to (B, P)."""
        return self.likelihood.pointwise(self.theta(y))

    def predict_density(self, other: ReadingLikelihood, y: Array) -> Array:
        """Return the log-density of each pose's readings among others that were kept back, (B, n) to (B, Q)."""
        return other.pointwise(self.theta(y))

    def leave_over(self, y: Array) -> LeftOver:
        """Return what the best poses leave of the readings at coordinates (B, n)."""
        return self.likelihood.leave_over(self.theta(y))

    def _rows(self, y: Array) -> tuple[Array, Array]:
        """Return r̂ (m,) and its derivative by the coordinates (m, n) at y (n,)."""
        error, slope = self.likelihood.linearise(self.theta(y[None])[0])
        return error.ravel(), slope.reshape(error.size, -1) @ self.moves.T

    def gradient(self, y: Array) -> tuple[Array, Array]:
        """Return the gradient (n,) of the log-density at y, shape (n,), and its Gauss-Newton Hessian (n, n)."""
        error, rows = self._rows(y)
        theta = self.theta(y[None])[0]
        gradient = -rows.T @ error - y + self.likelihood.volume_slope(theta, self.moves)
        return gradient, -rows.T @ rows - np.eye(self.n_parameters)

    def newton(self, y: Array) -> tuple[Array, Array]:
        """Return `gradient`, whose Hessian is nearly the exact one."""
        return self.gradient(y)

    def covariance(self, y: Array) -> Array:
        """Return the covariance of the coordinates to first order at y, shape (n, n)."""
        return np.asarray(np.linalg.inv(-self.gradient(y)[1]))

    def anchored(self) -> Self:
        """Return the same posterior that looks for poses from those of the least-squares solution."""
        theta = self.theta(self.approach()[None])[0]
        return replace(self, likelihood=self.likelihood.anchored(theta))

    # --- what inference asks for besides ---------------------------------------------------------------------------

    def approach(self) -> Array:
        """Return the least-squares solution from the machine as expected, shape (n,)."""
        return self.polish(np.zeros(self.n_parameters))

    def polish(self, y: Array) -> Array:
        """Return the least-squares solution of readings and priors together from y, shape (n,)."""

        def residual(x: Array) -> Array:
            theta = self.theta(x[None])
            value = np.concatenate([self.likelihood.find_poses(theta)[1][0].ravel(), x])
            return np.where(np.isfinite(value), value, FAR_AWAY)

        def jacobian(x: Array) -> Array:
            return np.concatenate([self._rows(x)[1], np.eye(self.n_parameters)])

        return np.asarray(least_squares(residual, y, jacobian, method="lm", xtol=1e-12, ftol=1e-12).x)

    def jumps(self, y: Array) -> list[tuple[int, Array]]:
        """Return nothing: the sign of each leg is known, and no other mode is expected."""
        del y
        return []

    def funnel_errors(self, y: Array) -> Array:
        """Return no model errors, shape (B, 0)."""
        return np.empty((*y.shape[:-1], 0))

    def groups(self) -> list[np.ndarray]:
        """Return nothing: no leg has a model error."""
        return []

    def curved_ridges(self) -> list[tuple[int, np.ndarray]]:
        """Return nothing: no coordinate is expected to have one."""
        return []

    def funnel(self, y: Array) -> None:
        """Return None: there are no model errors."""
        del y
