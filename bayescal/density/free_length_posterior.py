"""The posterior of a variant with a structured model error whose length is free, too: the last of its coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.density.free_length import REACH, FreeLengthLikelihood
from bayescal.density.model_error import LENGTH, LengthPrior
from bayescal.density.posterior import Local
from bayescal.density.priors import Prior
from bayescal.density.structured_posterior import StructuredPosterior
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False, kw_only=True)
class FreeLengthPosterior(StructuredPosterior):
    """Posterior of free parameters, model errors τ, scales and the length of the structured error, in this order.

    Its likelihood is a `FreeLengthLikelihood`. Derivatives are those at the nodes beside the length, interpolated.

    Attributes
    ----------
    lengths : LengthPrior
    """

    lengths: LengthPrior

    # --- coordinates ---------------------------------------------------------------------------------------------

    @property
    def _family(self) -> FreeLengthLikelihood:
        assert isinstance(self.likelihood, FreeLengthLikelihood)
        return self.likelihood

    @cached_property
    def n_parameters(self) -> int:
        """Number n of sampling coordinates: free parameters, model errors, scales and the length."""
        return self._switches.stop + 1

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, model errors, scales, and the length."""
        return (*super().names, LENGTH)

    def all_priors(self) -> dict[str, Prior]:
        """Return the priors of everything that is free by name, in order."""
        found = super().all_priors()
        found.pop(LENGTH)
        return found | {LENGTH: self.lengths}

    def length(self, y: Array) -> Array:
        """Return the kernel's length in units of the actuators' range, shape (B, 1)."""
        return self.lengths.length(y[..., -1:])

    def model_errors(self, y: Array) -> Array:
        """Return τ of each leg, then s, mm, then the length, shape (B, 2 N + 1)."""
        return np.concatenate([super().model_errors(y), self.length(y)], axis=-1)

    def natural(self, y: Array) -> Array:
        """Return everything free in its own unit, shape (B, n)."""
        return np.concatenate([super().natural(y), self.length(y)], axis=-1)

    # --- derivatives ---------------------------------------------------------------------------------------------

    def _fixed(self, node: int) -> StructuredPosterior:
        """Return the posterior with the length of a node, whose coordinates are all but the last."""
        found = StructuredPosterior(
            self._family.at_node(node), self.priors, self.model_error, self.fixed, kernel_scale=self.kernel_scale
        )
        vars(found)["coordinates"] = self.coordinates  # cached there; they hang on no kernel
        return found

    def _node(self, y: Array) -> int:
        """Return the node nearest to the length at y, shape (n,)."""
        return int(self._family.nearest(self.length(y)))

    def _linearise(self, y: Array) -> Local:
        """Return the likelihood at the length of the nearest node around y, shape (n,)."""
        return self._fixed(self._node(y))._linearise(y[:-1])

    def pose_information(self, y: Array, pose: int) -> Array:
        """Return what one pose tells of the geometry at y beyond all others, shape (m, m)."""
        return self._fixed(self._node(y)).pose_information(y[:-1], pose)

    def gradient(self, y: Array) -> tuple[Array, Array]:
        """Return the gradient (n,) of the log-density at y, shape (n,), and its Gauss-Newton Hessian (n, n)."""
        lower, share = self._family.place(self.length(y))
        gradient, hessian = (
            (1.0 - share[0]) * below + share[0] * above
            for below, above in zip(*(self._differentiate_at(y, int(lower[0]) + k) for k in (0, 1)), strict=True)
        )
        gradient[-1] -= y[-1]
        hessian[-1, -1] -= 1.0
        return gradient, hessian

    def _differentiate_at(self, y: Array, node: int) -> tuple[Array, Array]:
        """Return gradient and Hessian at the length of a node, without the prior of the length."""
        fixed, n, known = self._fixed(node), self.likelihood.n_legs, y[:-1]
        local = fixed._linearise(known)
        gradient, hessian = np.zeros(self.n_parameters), np.zeros((self.n_parameters, self.n_parameters))
        gradient[:-1], hessian[:-1, :-1] = fixed._differentiate(known, local)
        if abs(y[-1]) >= REACH:
            return gradient, hessian
        errors, turn = fixed.model_errors_at(known), self._family.slope_at(node)
        weight = fixed.likelihood.actuator_weight
        scaled = local.precision * (weight[:, None, :n].mean(axis=0) * errors[n:] ** 2)  # A D, shape (P, N, N)
        solved = (local.precision @ local.errors[..., None])[..., 0]
        own, speed = np.diagonal(turn), self.lengths.spread
        size = weight[:, :n].mean(axis=0) * errors[n:] ** 2
        gradient[-1] = 0.5 * speed * (np.sum(turn * ((solved * size) @ solved.T)) - own @ np.trace(scaled, axis1=1, axis2=2))
        flat, turned = scaled.reshape(len(own), -1), np.swapaxes(scaled, 1, 2).reshape(len(own), -1)
        hessian[-1, -1] = -0.5 * speed**2 * np.sum(turn**2 * (flat @ turned.T))
        by_leg = np.einsum("kij,kji->ki", scaled, local.precision)
        by_errors = np.concatenate([by_leg, by_leg], axis=1) * weight
        hessian[-1, self.n_geometry : -1] = -speed * fixed._moves(known) @ ((own @ by_errors) * errors)
        hessian[self.n_geometry : -1, -1] = hessian[-1, self.n_geometry : -1]
        return gradient, hessian

    # --- climbing and straightening ------------------------------------------------------------------------------

    def approach(self) -> Array:
        """Return a start near the mode, shape (n,): that of the median length."""
        return np.append(self._fixed(len(self._family.log_nodes) // 2).approach(), 0.0)

    def polish(self, y: Array) -> Array:
        """Return y, shape (n,), with the geometry of least squares at its model errors and length."""
        return np.append(self._fixed(self._node(y)).polish(y[:-1]), y[-1])

    @cached_property
    def _levels_by_node(self) -> Array:
        """Mean eigenvalue of the combinations of each level at every node, shape (G, L)."""
        levels, level = self._levels
        chosen = np.eye(len(levels))[level]
        return np.asarray(self._family.values @ (chosen / chosen.sum(axis=0)))

    def funnel_errors(self, y: Array) -> Array:
        """Return the error of each leg in the combinations of poses of each level of the kernel, shape (B, L N), mm."""
        lower, share = self._family.place(self.length(y)[..., 0])
        levels = (1.0 - share)[:, None] * self._levels_by_node[lower] + share[:, None] * self._levels_by_node[lower + 1]
        square = self.tau(y)[..., None, :] ** 2 + levels[..., None] * self.scales(y)[..., None, :] ** 2
        return np.asarray(np.sqrt(square).reshape(len(y), -1))
