"""Posterior of a self-calibration whose sensors err by functions of what they read: scales beside the machine.

How large such functions are in directions that the geometry imitates cannot be learnt from those that it does not, as
in `bayescal.density.model_error`: the scale is a tolerance, switched on or off by the data.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from bayescal.density.elimination import half_log_volume
from bayescal.density.errors import KernelScale
from bayescal.density.model_error import BORDER, OFF
from bayescal.density.readings.absorbed import Absorbed, Absorber, Strength, condition_each, condition_others
from bayescal.density.readings.change import change_density
from bayescal.density.readings.functions import SensorFunctions
from bayescal.density.readings.left_over import LeftOver
from bayescal.density.readings.likelihood import BATCH, STEP, ReadingLikelihood
from bayescal.density.readings.posterior import HALF_LOG_TWO_PI, SelfCalibrationPosterior
from bayescal.limits import FAR_AWAY
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False, kw_only=True)
class StructuredReadingPosterior(SelfCalibrationPosterior):
    """Posterior of the machine's free parameters, the scales of its sensors' functions, and a length that is free.

    Its coordinates are in this order. Those of scales are `KernelScale`'s: a switch and a magnitude in one.

    Attributes
    ----------
    functions : SensorFunctions
    """

    functions: SensorFunctions

    # --- coordinates ------------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of everything that is free."""
        return (*self.geometry_names, *self.functions.names)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of all."""
        return (*super().units, *self.functions.units)

    @property
    def prior_sd(self) -> Array:
        """Standard deviations of all priors, shape (n,)."""
        return np.concatenate([self.scale, [prior.sd for prior in self.functions.priors]])

    @cached_property
    def _kernel_scale(self) -> KernelScale:
        """Of all functions, in units of their own scales."""
        return KernelScale(1.0, self.functions.spread)

    @property
    def _switches(self) -> slice:
        return slice(self.n_geometry, self.n_geometry + len(self.functions.scale))

    def scales(self, y: Array) -> Array:
        """Return the scales (..., G), mm and rad."""
        return self._kernel_scale.value(y[..., self._switches]) * self.functions.scale

    def _length(self, y: Array) -> Array:
        """Return the length (...,)."""
        if self.functions.lengths is None:
            return np.full(y.shape[:-1], self.functions.length)
        return self.functions.lengths.length(y[..., -1])

    def strength(self, y: Array) -> Strength:
        """Return what the functions are like at coordinates (B, n)."""
        return Strength(self.scales(y)[..., self.functions.group], self._length(y))

    def natural(self, y: Array) -> Array:
        """Return everything that is free in its own unit, (..., n)."""
        free = [super().natural(y[..., : self.n_geometry]), self.scales(y)]
        return np.concatenate(free if self.functions.lengths is None else [*free, self._length(y)[..., None]], axis=-1)

    def _deviations(self, y: Array) -> Array:
        """Return coordinates less their places, standard normal under the prior."""
        place = y.copy()
        place[..., self._switches] = self._kernel_scale.deviation(y[..., self._switches])
        return place

    def log_coordinates(self, y: Array) -> Array:
        """Return the log-prior of each coordinate, (..., n); a switch is on or off with probability one half."""
        found = -0.5 * self._deviations(y) ** 2 - HALF_LOG_TWO_PI
        found[..., self._switches] -= np.log(2.0)
        return np.asarray(found)

    def log_parameters(self, y: Array) -> Array:
        """Return the log-prior of each parameter in its own unit, (..., n); of no error its probability."""
        m, natural = self.n_geometry, self.natural(y)
        geometry = change_density(super().log_coordinates(y[..., :m]), super().natural, y[..., :m])
        rest = [prior.log_density(natural[..., m + k]) for k, prior in enumerate(self.functions.priors)]
        return np.concatenate([geometry, np.stack(rest, axis=-1)], axis=-1)

    def log_prior(self, y: Array) -> Array:
        """Return the log-prior in the coordinates, (B, n) to (B,)."""
        return np.asarray(self.log_coordinates(y).sum(axis=-1))

    def draw_prior(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the prior in the coordinates, shape (n_draws, n); half of the switches are off."""
        y = super().draw_prior(n_draws, rng)
        y[:, self._switches] += np.where(rng.random((n_draws, len(self.functions.scale))) < 0.5, OFF, 0.0)
        return y

    def probability_of_error(self, y: Array) -> Array:
        """Return the share of draws (B, n) with an error, of each scale, shape (G,)."""
        return np.asarray((y[..., self._switches] > BORDER).mean(axis=0))

    # --- density ----------------------------------------------------------------------------------------------------

    @cached_property
    def absorber(self) -> Absorber:
        """What the functions do to the readings."""
        return self.absorber_of(self.likelihood)

    def absorber_of(self, other: ReadingLikelihood) -> Absorber:
        """Return what they do to other readings of the same sensors."""
        return Absorber(self.functions, other.sensors, other.measured)

    def absorb(self, y: Array) -> Absorbed:
        """Return the coefficients of the functions at coordinates (B, n)."""
        left = self.likelihood.leave_over(self.theta(y))
        return self.absorber.absorb(left.error, left.slope, self.strength(y))

    def _left(self, y: Array) -> tuple[LeftOver, Absorbed]:
        left = self.likelihood.leave_over(self.theta(y))
        return left, self.absorber.absorb(left.error, left.slope, self.strength(y))

    def log_density(self, y: Array) -> Array:
        """Return log-likelihood plus log-prior, (B, n) to (B,), -inf where there is no machine."""
        total = self.log_prior(y)
        with np.errstate(all="ignore"):
            for start in range(0, len(y), BATCH):
                part = slice(start, start + BATCH)
                left, absorbed = self._left(y[part])
                alone = self.likelihood.constant - 0.5 * (left.error**2).sum(axis=-1) - half_log_volume(left.slope)
                total[part] += alone.sum(axis=-1) + absorbed.gain
        return np.where(np.isfinite(total), total, -np.inf)

    def pointwise(self, y: Array) -> Array:
        """Return the log-density of each pose's readings given all other poses, (B, n) to (B, P)."""
        return self._by_pose(y, self.likelihood, self.absorber, among=True)

    def predict_density(self, other: ReadingLikelihood, y: Array) -> Array:
        """Return the log-density of each pose's readings among others given those of the calibration, (B, n) to (B, Q).

        Parameters
        ----------
        other : ReadingLikelihood
            Of readings that were kept back.
        y : ndarray, shape (B, n)
        """
        return self._by_pose(y, other, self.absorber_of(other), among=False)

    def _by_pose(self, y: Array, other: ReadingLikelihood, absorber: Absorber, among: bool) -> Array:
        result = np.empty((len(y), other.n_poses))
        condition = condition_each if among else condition_others
        for k in range(0, len(y), BATCH // 4):
            part = y[k : k + BATCH // 4]
            left, absorbed = other.leave_over(self.theta(part)), self.absorb(part)
            rows = absorber.rows(left.slope, absorbed.root)
            log_volume, square = condition(left.error, rows, absorbed)
            result[k : k + len(part)] = other.constant - 0.5 * square + log_volume - half_log_volume(left.slope)
        result[~np.isfinite(result)] = -np.inf
        return result

    def leave_over(self, y: Array) -> LeftOver:
        """Return what the best poses and the functions' means leave of the readings at coordinates (B, n)."""
        left, absorbed = self._left(y)
        rows = self.absorber.rows(left.slope, absorbed.root)
        error = left.error - np.einsum("bpkn,bn->bpk", rows, absorbed.mean)
        return LeftOver(error, left.slope, left.present, left.freedom, left.whiten, left.colour)

    # --- derivatives ------------------------------------------------------------------------------------------------

    def gradient(self, y: Array) -> tuple[Array, Array]:
        """Return the gradient (n,) of the log-density at y, shape (n,), and its expected Hessian (n, n)."""
        left, absorbed = self._left(y[None])
        _, slopes = self._rows(y)
        flat = slopes.reshape(-1, self.n_geometry)
        rows = self.absorber.rows(left.slope, absorbed.root)[0].reshape(len(flat), -1)
        alpha = left.error[0].ravel() - rows @ absorbed.mean[0]
        across = np.linalg.solve(absorbed.factor[0], rows.T @ flat)
        m, gradient, hessian = self.n_geometry, -self._deviations(y), -np.eye(self.n_parameters)
        gradient[:m] += self._volume_slope(y) - flat.T @ alpha
        hessian[:m, :m] -= flat.T @ flat - across.T @ across
        self._add_strength(y, absorbed, gradient, hessian)
        return gradient, hessian

    def _volume_slope(self, y: Array) -> Array:
        """Return the derivative of the volumes' logarithms by the machine's coordinates, by central differences."""
        m = self.n_geometry
        moves = STEP * np.eye(self.n_parameters)[:m]
        values = np.concatenate([self._log_volume(y + part) for part in (moves, -moves)])
        return np.asarray((values[:m] - values[m:]) / (2.0 * STEP))

    def _log_volume(self, y: Array) -> Array:
        parts = [y[k : k + BATCH] for k in range(0, len(y), BATCH)]
        found = [self._left(part) for part in parts]
        volumes = [absorbed.half_log_volume - half_log_volume(left.slope).sum(axis=1) for left, absorbed in found]
        return np.concatenate(volumes)

    def _add_strength(self, y: Array, absorbed: Absorbed, gradient: Array, hessian: Array) -> None:
        """Add the part of scales and length: with Λ the coefficients' covariance, dlog p = ½ (tᵀ dΛ t - tr Q dΛ)."""
        told, seen = (one[0] for one in absorbed.score)
        slopes = self._covariance_slopes(y, absorbed.root[0])
        products = [seen @ slope for slope in slopes]
        for k, (slope, product) in enumerate(zip(slopes, products, strict=True), start=self.n_geometry):
            gradient[k] += 0.5 * (told @ slope @ told - np.trace(product))
            for j, other in enumerate(products, start=self.n_geometry):
                hessian[k, j] -= 0.5 * np.sum(product * other.T)

    def _covariance_slopes(self, y: Array, root: Array) -> list[Array]:
        """Return the derivatives of Λ by the coordinates of scales and length, each (F R', F R')."""
        functions, covariance = self.functions, root @ root.T
        n, size = len(functions.places), len(root) // len(functions.places)
        group = np.repeat(functions.group, size)
        slopes = [
            2.0 * functions.spread * np.where((group == k)[:, None], covariance, 0.0)
            for k in range(len(functions.scale))
        ]
        if functions.lengths is not None:
            square = self.strength(y[None]).scale[0] ** 2
            turn = functions.lengths.spread * functions.root_slope(float(self._length(y[None])[0]))
            slopes.append(np.einsum("f,fg,rt->frgt", square, np.eye(n), turn).reshape(covariance.shape))
        return slopes

    # --- what inference asks for besides ----------------------------------------------------------------------------

    def polish(self, y: Array) -> Array:
        """Return y, shape (n,), with the machine that is best at its functions' scales, by least squares.

        The functions' coefficients are sought with the machine, each a reading of zero by its prior.
        """
        m, rest = self.n_geometry, y[self.n_geometry :]
        first = self.absorb(y[None])
        root, count = first.root, first.mean.shape[1]

        def place(x: Array) -> tuple[Array, Array, Array]:
            at = np.concatenate([x[:m], rest])
            left = self.likelihood.leave_over(self.theta(at[None]))
            rows = self.absorber.rows(left.slope, root)[0].reshape(-1, count)
            return at, left.error[0].ravel(), rows

        def residual(x: Array) -> Array:
            _, error, rows = place(x)
            value = np.concatenate([error - rows @ x[m:], x])
            return np.where(np.isfinite(value), value, FAR_AWAY)

        def jacobian(x: Array) -> Array:
            at, _, rows = place(x)
            return np.concatenate([np.hstack([self._rows(at)[1], -rows]), np.eye(m + count)])

        start = np.concatenate([y[:m], first.mean[0]])
        found = least_squares(residual, start, jacobian, method="lm", xtol=1e-12, ftol=1e-12)
        return np.concatenate([found.x[:m], rest])

    def jumps(self, y: Array) -> list[tuple[int, Array]]:
        """Return each kind of error switched on or off."""
        found = []
        for jump, k in enumerate(range(self._switches.start, self._switches.stop)):
            image = y.copy()
            image[k] = self._kernel_scale.flip(float(y[k]))
            found.append((jump, image))
        return found
