"""Posterior of a calibration: priors by parameter, unknown noise, readings with their poses eliminated.

Coordinates are standard normal under the prior: a normal prior's parameter in its standard deviations, a uniform one's
by Φ, those of the noise by `noise.NoiseModel`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import ndtr, ndtri

from bayescal.density.calibration.likelihood import CalibrationLikelihood, Stand
from bayescal.density.calibration.noise import NoiseModel
from bayescal.density.calibration.whitening import Whitening
from bayescal.density.elimination import half_log_volume, invert, left_of, project_out
from bayescal.density.local import Funnel
from bayescal.density.priors import Prior, UniformPrior
from bayescal.errors import InputError, NumericalError
from bayescal.numerics.geometry import Array

HALF_LOG_TWO_PI = 0.5 * float(np.log(2 * np.pi))
STEP = 1e-4  # of a coordinate, for the slope of the poses' volume
DAMPING, LARGEST_DAMPING = 1e-3, 1e12
EDGE = 1e-3  # how near to a bound, by the width of a uniform prior, a machine known otherwise is taken to be
GAIN = 1e-12  # of the squares, below which the search has arrived
MAX_ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class CalibrationPosterior:
    """Posterior of free parameters and unknown noise; a `bayescal.inference.target.Target`.

    Attributes
    ----------
    likelihood : CalibrationLikelihood
    priors : mapping of name to Prior
        Of the free parameters.
    noise : NoiseModel
    fixed : mapping of parameter name to float
        Values of fixed parameters that are not nominal.
    common : mapping of name to tuple of parameter names
        Parameters that deviate alike from their nominal values, under the name that their prior has.
    """

    likelihood: CalibrationLikelihood
    priors: Mapping[str, Prior]
    noise: NoiseModel
    fixed: Mapping[str, float]
    common: Mapping[str, tuple[str, ...]]

    def __post_init__(self) -> None:
        """Check the names."""
        layout = self.likelihood.model.layout
        shared = [name for members in self.common.values() for name in members]
        for name in (*(name for name in self.priors if name not in self.common), *shared, *self.fixed):
            if name not in layout.names:
                raise InputError(f"parameter {name!r}: unknown here, expected one of {', '.join(layout.symbols)}")

    # --- parameters ------------------------------------------------------------------------------------------------

    @cached_property
    def geometry_names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the layout's order."""
        return tuple(sorted(self.priors, key=lambda name: self.places(name)[0]))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, then of the noise's."""
        return (*self.geometry_names, *self.noise.names)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of all."""
        units = self.likelihood.model.layout.units
        return (*(units[self.places(name)[0]] for name in self.geometry_names), *self.noise.units)

    def places(self, name: str) -> list[int]:
        """Return where the parameters of a coordinate stand in the layout."""
        names = self.likelihood.model.layout.names
        return [names.index(member) for member in self.common.get(name, (name,))]

    @property
    def n_parameters(self) -> int:
        """Number n of coordinates."""
        return len(self.priors) + self.noise.n_parameters

    @property
    def n_geometry(self) -> int:
        """How many of them are parameters of the machine."""
        return len(self.priors)

    @cached_property
    def centre(self) -> Array:
        """The machine as expected, shape (D,)."""
        layout = self.likelihood.model.layout
        theta = layout.nominal.copy()
        for name, value in self.fixed.items():
            theta[layout.names.index(name)] = value
        for name, prior in self.priors.items():
            places = self.places(name)
            theta[places] += prior.mean - theta[places[0]]
        return theta

    @cached_property
    def _moves(self) -> Array:
        """Which parameters go with which coordinate, ones and zeros, shape (m, D)."""
        moves = np.zeros((self.n_geometry, self.likelihood.model.layout.size))
        for k, name in enumerate(self.geometry_names):
            moves[k, self.places(name)] = 1.0
        return moves

    @cached_property
    def _first(self) -> np.ndarray:
        return np.array([self.places(name)[0] for name in self.geometry_names], dtype=int)

    @cached_property
    def prior_sd(self) -> Array:
        """Standard deviations of all priors, shape (n,)."""
        return np.array([prior.sd for prior in self.all_priors().values()])

    def all_priors(self) -> dict[str, Prior]:
        """Return the priors of all coordinates' parameters in their own units, by name and in order."""
        own = (*(self.priors[name] for name in self.geometry_names), *self.noise.priors)
        return dict(zip(self.names, own, strict=True))

    @cached_property
    def _uniform(self) -> tuple[np.ndarray, Array]:
        chosen = [self.priors[name] for name in self.geometry_names]
        return np.array([isinstance(one, UniformPrior) for one in chosen], dtype=bool), np.array(
            [one.upper - one.lower if isinstance(one, UniformPrior) else one.sd for one in chosen]
        )

    def _deviate(self, y: Array) -> Array:
        """Return deviations from the priors' means (..., m) from coordinates (..., m)."""
        uniform, width = self._uniform
        return np.where(uniform, (ndtr(y) - 0.5) * width, y * width)

    def _speed(self, y: Array) -> Array:
        """Return the derivative of the same."""
        uniform, width = self._uniform
        return np.where(uniform, np.exp(-0.5 * y * y - HALF_LOG_TWO_PI) * width, width)

    def theta(self, y: Array) -> Array:
        """Return full parameter vectors (B, D) of coordinates (B, n)."""
        return np.asarray(self.centre + self._deviate(y[..., : self.n_geometry]) @ self._moves)

    def natural(self, y: Array) -> Array:
        """Return parameters and noise in their own units, (..., n)."""
        geometry = self.centre[self._first] + self._deviate(y[..., : self.n_geometry])
        return np.concatenate([geometry, self.noise.natural(y[..., self.n_geometry :])], axis=-1)

    # --- density -------------------------------------------------------------------------------------------------

    def log_prior(self, y: Array) -> Array:
        """Return the log-prior in the coordinates, (B, n) to (B,)."""
        return np.asarray(-0.5 * np.einsum("...i,...i->...", y, y) - self.n_parameters * HALF_LOG_TWO_PI)

    def deviations(self, y: Array) -> tuple[Array, Array]:
        """Return s σ (B, P, K) and τ (B, 1, K) at coordinates (B, n)."""
        return self.noise.deviations(y[:, self.n_geometry :], self.likelihood.sd)

    def finer(self) -> None:
        """Return None: the density leaves nothing out."""

    def pointwise(self, y: Array) -> Array:
        """Return the log-likelihood of each pose's readings, (B, n) to (B, P)."""
        return self.likelihood.pointwise(self.theta(y), *self.deviations(y))

    def draw_prior(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the prior in the coordinates, shape (n_draws, n)."""
        return rng.standard_normal((n_draws, self.n_parameters))

    def log_density(self, y: Array) -> Array:
        """Return log-likelihood plus log-prior, (B, n) to (B,), -inf where there is no machine."""
        with np.errstate(all="ignore"):
            theta = self.theta(y)
            inside = self.likelihood.model.layout.inside(theta)
            theta[~inside] = self.centre
            total = self.log_prior(y) + self.likelihood.pointwise(theta, *self.deviations(y)).sum(axis=1)
        return np.where(inside & np.isfinite(total), total, -np.inf)

    def stand(self, y: Array) -> tuple[Whitening, Stand]:
        """Return the whitening and where machines of coordinates (B, n) explain the readings best."""
        white = self.likelihood.whiten(*self.deviations(y))
        return white, self.likelihood.stand(self.theta(y), white)

    # --- derivatives ---------------------------------------------------------------------------------------------

    def rows(self, y: Array, white: Whitening, pose: Array) -> tuple[Array, Array, Array]:
        """Return white errors (P, K), H (P, K, q) and the derivative of the readings by the coordinates (P, K, m)."""
        theta = self.theta(y[None])
        error, slope, by_parameters = self.likelihood.linearise(theta, pose, white, with_parameters=True)
        return error[0], slope[0], by_parameters[0] @ self.moves(y).T

    def moves(self, y: Array) -> Array:
        """Return the derivatives of θ by the geometry's coordinates at y, shape (n,), as rows (m, D)."""
        return np.asarray(self._moves * self._speed(y[: self.n_geometry])[:, None])

    def gradient(self, y: Array) -> tuple[Array, Array]:
        """Return the gradient (n,) of the log-density at y, shape (n,), and its Gauss-Newton Hessian (n, n)."""
        with np.errstate(all="ignore"):
            white, at = self.stand(y[None])
            error, slope, by_parameters = self.rows(y, white, at.pose)
            trust = self.likelihood.trust(at.square)[0]
            left = project_out(slope)
            rows = left @ by_parameters
            m, n = self.n_geometry, self.n_parameters
            gradient, hessian = -y, -np.eye(n)
            gradient[:m] += np.einsum("p,pki,pk->i", trust, rows, left_of(left, error)) + self._volume_slope(y)
            hessian[:m, :m] -= np.einsum("p,pki,pkj->ij", trust, rows, rows, optimize=True)
            if n > m:
                self._add_noise(y, white, left, left_of(left, error), trust, gradient, hessian)
        return gradient, hessian

    def newton(self, y: Array) -> tuple[Array, Array]:
        """Return `gradient`, whose Hessian is nearly the exact one."""
        return self.gradient(y)

    def _add_noise(
        self, y: Array, white: Whitening, left: Array, error: Array, trust: Array, gradient: Array, hessian: Array
    ) -> None:
        """Add the noise's part, its expected curvature in place of the exact one."""
        m, there = self.n_geometry, self.likelihood.data.present
        slopes = self.noise.covariance_slopes(y[m:], self.likelihood.sd, self.likelihood.correlation)
        slopes = np.where(there[:, :, None] & there[:, None, :], slopes, 0.0)
        both = white.rows(np.swapaxes(white.rows(slopes), -1, -2))
        square = np.einsum("p,pk,npkl,pl->n", trust, error, both, error, optimize=True)
        seen = left @ both
        gradient[m:] += 0.5 * (square - np.trace(seen, axis1=-2, axis2=-1).sum(axis=-1))
        hessian[m:, m:] -= 0.5 * np.einsum("npkl,oplk->no", seen, seen, optimize=True)

    def _volume_slope(self, y: Array) -> Array:
        """Return the derivative of -½ Σ log |HᵀΣ⁻¹H| by the geometry's coordinates, by central differences, (m,)."""
        m = self.n_geometry
        if not self.likelihood.start.shape[-1]:
            return np.zeros(m)
        moves = STEP * np.eye(self.n_parameters)[:m]
        points = y + np.concatenate([moves, -moves])
        values = np.concatenate([self._log_volume(points[part]) for part in self.likelihood.batches(2 * m)])
        return np.asarray((values[:m] - values[m:]) / (2.0 * STEP))

    def _log_volume(self, y: Array) -> Array:
        """Return -½ Σ log |HᵀΣ⁻¹H| of machines (B, n) right where they stand, shape (B,)."""
        white, at = self.stand(y)  # whose H is that of a pose close by, the same for machines that are much alike
        return -half_log_volume(self.likelihood.linearise(self.theta(y), at.pose, white)[1]).sum(axis=1)

    # --- climbing ------------------------------------------------------------------------------------------------

    def approach(self) -> Array:
        """Return the least-squares solution from the machine as expected, shape (n,)."""
        return self.fit(np.zeros(self.n_parameters), self.likelihood.start)[0]

    def polish(self, y: Array) -> Array:
        """Return y with the geometry that is best, by least squares, at its noise."""
        return self.fit(y, self.stand(y[None])[1].pose[0])[0]

    def anchored(self) -> CalibrationPosterior:
        """Return the same posterior that looks for poses from those of the least-squares solution."""
        y, pose = self.fit(np.zeros(self.n_parameters), self.likelihood.start)
        return replace(self, likelihood=self.likelihood.anchored(pose, self.theta(y[None])[0]))

    def fit(self, y: Array, pose: Array) -> tuple[Array, Array]:
        """Return coordinates (n,) and poses (P, q) that explain readings and priors best, by Levenberg and Marquardt.

        Machine and poses move together, the poses eliminated from each step; the noise stays that of y.

        Raises
        ------
        NumericalError
            Where the machine does not stand at the start.
        """
        white, damping = self.likelihood.whiten(*self.deviations(y[None])), DAMPING
        pose = np.broadcast_to(pose, (1, *pose.shape[-2:]))
        here = self.rows(y, white, pose)
        cost = self._cost(y, here[0])
        if not np.isfinite(cost):
            raise NumericalError("found no reading of the machine as expected at some start, expected one that stands")
        for _ in range(MAX_ITERATIONS):
            move, follow = self._propose(y, *here, damping)
            other, stood = y.copy(), pose + follow
            other[: self.n_geometry] += move
            there = self.rows(other, white, stood)
            new = self._cost(other, there[0])
            if not new < cost:
                damping *= 4.0
                if damping > LARGEST_DAMPING:
                    break
                continue
            done = cost - new < GAIN * max(cost, 1.0)
            y, pose, here, cost, damping = other, stood, there, new, damping / 3.0
            if done:
                break
        return y, pose[0]

    def _cost(self, y: Array, error: Array) -> float:
        freedom, squares = self.likelihood.freedom, np.einsum("pk,pk->p", error, error)
        if np.isfinite(freedom):  # what is far off counts by its logarithm, as in the density
            squares = (freedom + self.likelihood.n_spare) * np.log1p(squares / freedom)
        total = float(squares.sum() + y @ y)
        return total if self.likelihood.model.layout.inside(self.theta(y[None]))[0] else np.nan

    def _propose(
        self, y: Array, error: Array, slope: Array, by_parameters: Array, damping: float
    ) -> tuple[Array, Array]:
        """Return a damped step of the coordinates (m,) and the poses' (P, q) that follows."""
        m = self.n_geometry
        trust = np.sqrt(self.likelihood.trust(np.einsum("pk,pk->p", error, error)))
        # a little of the damping keeps poses that readings hardly tell from running away
        stiff = invert(slope, 1e-9 * damping / DAMPING)
        left = np.eye(slope.shape[1]) - slope @ stiff
        rows = trust[:, None, None] * (left @ by_parameters)
        right = trust[:, None] * left_of(left, error)
        normal = np.einsum("pki,pkj->ij", rows, rows, optimize=True) + np.eye(m)
        side = np.einsum("pki,pk->i", rows, right) - y[:m]
        move = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), side)
        return move, left_of(stiff, error - by_parameters @ move)

    # --- what inference asks for besides ---------------------------------------------------------------------------

    def jumps(self, y: Array) -> list[tuple[int, Array]]:
        """Return nothing: no other mode is expected."""
        del y
        return []

    def funnel_errors(self, y: Array) -> Array:
        """Return the noise of each group of channels over the stated one, (B, n) to (B, N), rms of its readings."""
        own, tau = self.deviations(y)
        there, square = self.likelihood.data.present, (own**2 + tau**2) / self.likelihood.sd**2
        mine = there * self.noise.groups[:, None]
        return np.sqrt(np.einsum("bpk,gpk->bg", square, mine) / np.maximum(mine.sum(axis=(1, 2)), 1))

    def groups(self) -> list[np.ndarray]:
        """Return all of the geometry as one group."""
        return [np.arange(self.n_geometry)]

    def curved_ridges(self) -> list[tuple[int, np.ndarray]]:
        """Return nothing: no coordinate is expected to have one."""
        return []

    def funnel(self, y: Array) -> Funnel | None:
        """Return how the geometry depends on the noise at y, shape (n,); None where that is known."""
        if not self.noise.n_parameters:
            return None
        with np.errstate(all="ignore"):
            white, at = self.stand(y[None])
            _, slope, by_parameters = self.rows(y, white, at.pose)
        rows = np.sqrt(self.likelihood.trust(at.square)[0])[:, None, None] * (project_out(slope) @ by_parameters)
        # information is a sum over white readings, homogeneous in their precisions: each group's share is its readings'
        parts = np.einsum("gk,pki,pkj->gij", self.noise.groups, rows, rows, optimize=True)
        tau = self.funnel_errors(y[None])[0]
        return Funnel(parts.sum(axis=0), np.eye(self.n_geometry), np.full(len(tau), 1e-12), tau, parts)

    # --- what a fit is judged by -----------------------------------------------------------------------------------

    @cached_property
    def _alone(self) -> dict[int, CalibrationPosterior]:
        return {}

    def pointwise_of(self, y: Array, row: int) -> Array:
        """Return the log-likelihood of one pose's readings, (B, n) to (B,)."""
        if row not in self._alone:
            self._alone[row] = replace(self, likelihood=self.likelihood.pick(np.array([row])))
        return self._alone[row].pointwise(y)[:, 0]

    def reduced_rows(self, y: Array) -> tuple[Array, Array]:
        """Return white residuals that no pose explains (P, K), and their derivatives by the geometry (P, K, m), at y.

        Poses that the density trusts less count less.
        """
        with np.errstate(all="ignore"):
            white, at = self.stand(y[None])
            error, slope, by_parameters = self.rows(y, white, at.pose)
            trust, left = np.sqrt(self.likelihood.trust(at.square)[0]), project_out(slope)
        return trust[:, None] * left_of(left, error), trust[:, None, None] * (left @ by_parameters)

    def pose_information(self, y: Array, pose: int) -> Array:
        """Return one pose's part of the information of the readings on the geometry at y, shape (m, m)."""
        rows = self.reduced_rows(y)[1][pose]
        return np.asarray(rows.T @ rows)

    def adopt(self, theta: Array, errors: Array) -> Array:
        """Return the coordinates of machines θ (M, D), brought within the priors' bounds, with those of errors."""
        uniform, width = self._uniform
        away = (theta - self.centre)[:, self._first] / width
        inside = ndtri(np.clip(away + 0.5, EDGE, 1.0 - EDGE))
        return np.concatenate([np.where(uniform, inside, away), errors], axis=1)
