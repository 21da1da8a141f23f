"""The posterior of a variant whose model error is a function of the pose: scales s beside geometry and τ."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.density.model_error import BORDER, OFF, KernelScale, KernelScalePrior
from bayescal.density.posterior import Funnel, Posterior
from bayescal.density.priors import Prior
from bayescal.density.structured import StructuredLikelihood
from bayescal.machines.closing_coordinates import ClosingCoordinates
from bayescal.machines.coordinates import Coordinates
from bayescal.numerics.geometry import Array


def average_rotation(rotations: Array) -> Array:
    """Return the rotation nearest to the mean of rotations (P, 3, 3)."""
    return np.asarray(Rotation.from_matrix(rotations).mean().as_matrix())


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
        where = poses.position.mean(axis=0), average_rotation(poses.rotation), poses.actuators.mean(axis=0)
        return ClosingCoordinates.around(known, likelihood.machine, *(one[None] for one in where))

    @property
    def _n_tau(self) -> int:
        return self.model_error.n_parameters(self.likelihood.n_legs)

    @property
    def _switches(self) -> slice:
        """Coordinates of the scales."""
        return slice(self.n_geometry + self._n_tau, None)

    @cached_property
    def n_parameters(self) -> int:
        """Number n of sampling coordinates: free parameters, model errors and scales."""
        return self.n_geometry + self._n_tau + self.kernel_scale.n_parameters(self.likelihood.n_legs)

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
        tau = self.model_error.tau_from_zeta(y[..., self.n_geometry : self.n_geometry + self._n_tau])
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
        tau = self.model_error.tau_from_zeta(y[..., self.n_geometry : self.n_geometry + self._n_tau])
        scale = self.kernel_scale.scale_from_switch(y[..., self._switches])
        return np.concatenate([self.theta(y)[..., self.coordinates.free], tau, scale], axis=-1)

    def _deviations(self, y: Array) -> Array:
        place = y.copy()
        place[..., self._switches] = self.kernel_scale.deviation(y[..., self._switches])
        return place[..., self._standard]

    def _log_prior(self, y: Array, theta: Array) -> Array:
        """Add that each switch is on or off with probability one half."""
        n_switches = self.n_parameters - self._switches.start
        return super()._log_prior(y, theta) - n_switches * np.log(2.0)

    def draw_prior(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the prior in the coordinates, shape (n_draws, n); half of the switches are off."""
        y = super().draw_prior(n_draws, rng)
        off = rng.random((n_draws, self.n_parameters - self._switches.start)) < 0.5
        y[:, self._switches] += np.where(off, OFF, 0.0)
        return y

    # --- derivatives ---------------------------------------------------------------------------------------------

    def _add_model_error(self, y: Array, weighted: Array, precision: Array, gradient: Array, hessian: Array) -> None:
        """Add the part of τ and s; their expected curvature stands in for the exact one."""
        weight, errors = self.likelihood.actuator_weight, self._model_errors_at(y)
        weighted, precision = self.likelihood.on_legs(weighted), self._see_by_legs(precision)
        diagonal = np.diagonal(precision, axis1=1, axis2=2)
        per_entry = np.sum(weight * errors * (weighted**2 - diagonal), axis=0)
        scaled = weight * errors
        curvature = 2.0 * np.einsum("pi,pij,pj->ij", scaled, precision**2, scaled)
        moves = self._moves(y)
        first = self.n_geometry
        place = y[first:].copy()
        place[self._n_tau :] = self.kernel_scale.deviation(y[self._switches])
        gradient[first:] = moves @ per_entry - place
        hessian[first:, first:] = -moves @ curvature @ moves.T - np.eye(len(place))

    def _moves(self, y: Array) -> Array:
        """Return the derivative of `model_errors` by their coordinates at y, shape (k, 2 N)."""
        n_legs, first = self.likelihood.n_legs, self.n_geometry
        zeta, c = y[first : first + self._n_tau], y[self._switches]
        tau = self.model_error.slope(zeta, self.model_error.tau_from_zeta(zeta))
        blocks = [(tau, 0), (self.kernel_scale.slope(c), n_legs)]
        moves, row = np.zeros((len(zeta) + len(c), 2 * n_legs)), 0
        for slope, start in blocks:
            legs = np.eye(n_legs) if len(slope) == n_legs else np.ones((1, n_legs))
            moves[row : row + len(slope), start : start + n_legs] = slope[:, None] * legs
            row += len(slope)
        return moves

    # --- climbing and straightening ------------------------------------------------------------------------------

    def jumps(self, y: Array) -> list[tuple[int, Array]]:
        """Return the jumps of the geometry, and each structured error switched on or off."""
        found = super().jumps(y)
        first = self.likelihood.n_legs
        for k in range(self._switches.start, self.n_parameters):
            image = y.copy()
            image[k] = self.kernel_scale.flip(y[k])
            found.append((first + k, image))
        return found

    def funnel(self, y: Array) -> Funnel | None:
        """Return how the geometry depends on τ at y, shape (n,); see `Posterior.funnel`.

        Combinations of the poses in which the kernel's error is larger than the noise tell the same whatever τ: what
        these know of the geometry counts as prior knowledge.
        """
        if self._ties_legs and not self.model_error.shared:
            return None
        n_legs, tau = self.likelihood.n_legs, self.tau(y[None])[0]
        _, _, slope, precision, change = self._linearise(y)
        weight = self.likelihood.actuator_weight
        noise = 1.0 / np.diagonal(precision, axis1=-2, axis2=-1)
        added = weight[:, n_legs:] * self.scales(y[None])[0] ** 2
        free_of_kernel = 1.0 - np.minimum(added / noise, 1.0).mean(axis=1)
        rest = np.average(noise, axis=0, weights=free_of_kernel + 1e-12) / weight[:, :n_legs].mean(axis=0) - tau**2
        information = np.einsum("pik,pij,pjm->pkm", slope, precision, slope, optimize=True)
        rows = self._prior_slope(change)
        telling = np.einsum("p,pkm->km", free_of_kernel, information)
        return Funnel(telling, rows.T @ rows + information.sum(axis=0) - telling, np.maximum(rest, 1e-12), tau)

    def probability_of_error(self, y: Array) -> Array:
        """Return the share of draws (B, n) with a structured error, of each scale."""
        return np.asarray((y[..., self._switches] > BORDER).mean(axis=0))
