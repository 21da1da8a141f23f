"""The posterior of a variant whose model error is a function of the pose: scales s beside geometry and τ."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.density.local import Funnel, Local
from bayescal.density.model_error import BORDER, OFF, Kernel, KernelScale, KernelScalePrior
from bayescal.density.posterior import Posterior
from bayescal.density.priors import Prior
from bayescal.density.structured import StructuredLikelihood, root_of
from bayescal.machines.closing_coordinates import close_at_mean
from bayescal.machines.coordinates import Coordinates
from bayescal.numerics.geometry import Array

ALIKE_LEVELS = 1.5
NO_LEVEL = 1e-9


@dataclass(frozen=True, eq=False, kw_only=True)
class StructuredPosterior(Posterior):
    """Posterior of free parameters, model errors τ and scales of the structured error; its coordinates in this order.

    Its likelihood is a `StructuredLikelihood`; τ is free.

    Attributes
    ----------
    kernel_scale : KernelScale
    """

    kernel_scale: KernelScale

    # --- coordinates ---------------------------------------------------------------------------------------------

    @cached_property
    def coordinates(self) -> Coordinates:
        """Coordinates of the geometry, the lengths following so that the legs close at the mean of the poses."""
        known, likelihood = super().coordinates, self.likelihood
        assert isinstance(likelihood, StructuredLikelihood)
        poses = likelihood.base.poses
        return close_at_mean(known, likelihood.machine, poses.position, poses.rotation, poses.actuators)

    @property
    def _switches(self) -> slice:
        """Coordinates of the scales."""
        return slice(self._taus.stop, self._taus.stop + self.kernel_scale.n_parameters(self.likelihood.n_legs))

    @cached_property
    def n_parameters(self) -> int:
        """Number n of sampling coordinates: free parameters, model errors and scales."""
        return int(self._switches.stop)

    @property
    def _n_switches(self) -> int:
        return int(self._switches.stop - self._switches.start)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, model errors and scales."""
        geometry = tuple(self._layout.names[k] for k in self.coordinates.free)
        n_legs = self.likelihood.n_legs
        return geometry + self.model_error.names(n_legs) + self.kernel_scale.names(n_legs)

    def all_priors(self) -> dict[str, Prior]:
        """Return the priors of everything that is free by name, in order."""
        scales = self.kernel_scale.names(self.likelihood.n_legs)
        names = [name for name in self.names if name not in scales]
        result = self._name_priors(names)
        return result | dict.fromkeys(scales, KernelScalePrior(self.kernel_scale.scale, self.kernel_scale.spread))

    def tau(self, y: Array) -> Array:
        """Return the model error τ of each leg in mm, shape (B, N)."""
        tau = self.model_error.tau_from_zeta(y[..., self._taus])
        return np.broadcast_to(tau, (*tau.shape[:-1], self.likelihood.n_legs))

    def scales(self, y: Array) -> Array:
        """Return the scale s of each leg in mm, shape (B, N)."""
        scale = self.kernel_scale.scale_from_switch(y[..., self._switches])
        return np.broadcast_to(scale, (*scale.shape[:-1], self.likelihood.n_legs))

    def model_errors(self, y: Array) -> Array:
        """Return τ of each leg and then s, shape (B, 2 N), mm."""
        return np.concatenate([self.tau(y), self.scales(y)], axis=-1)

    def natural(self, y: Array) -> Array:
        """Return everything free in its own unit, shape (B, n)."""
        tau = self.model_error.tau_from_zeta(y[..., self._taus])
        scale = self.kernel_scale.scale_from_switch(y[..., self._switches])
        return np.concatenate([self.theta(y)[..., self.coordinates.free], tau, scale], axis=-1)

    def _deviations(self, y: Array) -> Array:
        place = y.copy()
        place[..., self._switches] = self.kernel_scale.deviation(y[..., self._switches])
        return place[..., self._standard]

    def _log_prior(self, y: Array, theta: Array) -> Array:
        """Add that each switch is on or off with probability one half."""
        return super()._log_prior(y, theta) - self._n_switches * np.log(2.0)

    def draw_prior(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the prior in the coordinates, shape (n_draws, n); half of the switches are off."""
        y = super().draw_prior(n_draws, rng)
        off = rng.random((n_draws, self._n_switches)) < 0.5
        y[:, self._switches] += np.where(off, OFF, 0.0)
        return y

    # --- derivatives ---------------------------------------------------------------------------------------------

    def pose_information(self, y: Array, pose: int) -> Array:
        """Return what one pose tells of the geometry at y beyond all others, shape (m, m); see `pointwise`."""
        assert isinstance(self.likelihood, StructuredLikelihood)
        local, share = self._linearise(y), self.likelihood.combination[pose]
        seen = np.einsum("k,kij,kjm->im", share, local.precision, local.slope)
        own = np.einsum("k,kij->ij", share**2, local.precision)
        return np.asarray(seen.T @ np.linalg.solve(own, seen))

    def _add_model_error(self, y: Array, local: Local, weighted: Array, gradient: Array, hessian: Array) -> None:
        """Add the part of τ and s."""
        by_errors, curvature = self._differentiate_by_errors(self.model_errors_at(y), local, weighted)
        moves = self._moves(y)
        place = np.concatenate([y[self._taus], self.kernel_scale.deviation(y[self._switches])])
        inside = slice(self.n_geometry, None)
        gradient[inside] = moves @ by_errors - place
        hessian[inside, inside] = -moves @ curvature @ moves.T - np.eye(len(place))

    def _moves(self, y: Array) -> Array:
        """Return the derivative of `model_errors` by their coordinates at y, shape (k, 2 N)."""
        return self._beside(super()._moves(y), self.kernel_scale.slope(y[self._switches]))

    def _bends(self, y: Array) -> Array:
        """Return the second derivative of `model_errors` by their coordinates at y, shape (k, 2 N)."""
        return self._beside(super()._bends(y), self.kernel_scale.bend(y[self._switches]))

    def _beside(self, tau: Array, scales: Array) -> Array:
        """Return something of τ at the legs, shape (j, N), and of each scale, shape (i,), as one, (j + i, 2 N)."""
        own = self._spread(scales)
        return np.block([[tau, np.zeros_like(tau)], [np.zeros_like(own), own]])

    # --- climbing and straightening ------------------------------------------------------------------------------

    def jumps(self, y: Array) -> list[tuple[int, Array]]:
        """Return the jumps of the geometry, and each structured error switched on or off."""
        found = super().jumps(y)
        first = self.likelihood.n_legs
        for k in range(self._switches.start, self._switches.stop):
            image = y.copy()
            image[k] = self.kernel_scale.flip(y[k])
            found.append((first + k, image))
        return found

    @cached_property
    def _levels(self) -> tuple[Array, np.ndarray]:
        """Eigenvalues of the kernel, those that are alike as one, (L,), and the level of each combination of poses."""
        likelihood = self.likelihood
        assert isinstance(likelihood, StructuredLikelihood)
        values = likelihood.eigenvalues
        there = values > NO_LEVEL * values.max()
        rounded = np.full(len(values), -np.inf)
        rounded[there] = np.round(np.log(values[there]) / np.log(ALIKE_LEVELS))
        _, level = np.unique(rounded, return_inverse=True)
        return np.bincount(level, values) / np.bincount(level), level

    def funnel_errors(self, y: Array) -> Array:
        """Return the error of each leg in the combinations of poses of each level of the kernel, shape (B, L N), mm."""
        levels, _ = self._levels
        square = self.tau(y)[..., None, :] ** 2 + levels[:, None] * self.scales(y)[..., None, :] ** 2
        return np.asarray(np.sqrt(square).reshape(len(y), -1))

    def groups(self) -> list[np.ndarray]:
        """Return all of the geometry as one group: the scales make all legs uncertain."""
        return [np.arange(self.n_geometry)]

    def funnel(self, y: Array) -> Funnel:
        """Return how the geometry depends on τ and s at y, shape (n,); see `Posterior.funnel`.

        What the geometry is worth hangs on s: the larger the scale, the less do combinations of poses tell in which the
        kernel's error is. The joint mode of scale and geometry is therefore none of the scale's density; that is seen
        in straight coordinates only (as restricted likelihood has it: Patterson and Thompson 1971).
        """
        n_legs, (levels, level) = self.likelihood.n_legs, self._levels
        _, errors, slope, precision, change, *_ = self._linearise(y)
        whitening, _ = root_of(precision)
        rows, white = whitening @ slope, (whitening @ errors[..., None])[..., 0]
        chosen = np.eye(len(levels))[level]
        parts = np.einsum("kl,kia,kib->liab", chosen, rows, rows, optimize=True)
        scores = -np.einsum("kl,kia,ki->lia", chosen, rows, white, optimize=True)
        weight = self.likelihood.actuator_weight[:, :n_legs]
        variance = 1.0 / np.diagonal(precision, axis1=-2, axis2=-1) / weight
        own = self.funnel_errors(y[None])[0]
        rest = (chosen.T @ variance / chosen.sum(axis=0)[:, None]).ravel() - own**2
        size, m = n_legs * len(levels), self.n_geometry
        prior = self._prior_slope(change)
        return Funnel(
            parts.sum(axis=(0, 1)),
            prior.T @ prior,
            np.maximum(rest, 1e-12),
            own,
            parts.reshape(size, m, m),
            scores.reshape(size, m),
        )

    def describe_function(self, natural: Array) -> tuple[Kernel, Array]:
        """Return the kernel, and the rms of each leg's scale over draws in natural units (S, n), shape (N,), mm."""
        assert isinstance(self.likelihood, StructuredLikelihood)
        scale = np.sqrt(np.mean(natural[:, self._switches] ** 2, axis=0))
        return self.likelihood.kernel, np.broadcast_to(scale, self.likelihood.n_legs)

    def probability_of_error(self, y: Array) -> Array:
        """Return the share of draws (B, n) with a structured error, of each scale."""
        return np.asarray((y[..., self._switches] > BORDER).mean(axis=0))
