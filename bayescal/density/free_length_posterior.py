"""The posterior of a variant with a structured model error whose length is free, too: the last of its coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.density.free_length import REACH, FreeLengthLikelihood
from bayescal.density.local import Local
from bayescal.density.model_error import LENGTH, Kernel, LengthPrior
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

    def newton(self, y: Array) -> tuple[Array, Array]:
        """Return `gradient`: it is of two nodes of the length."""
        return self.gradient(y)

    def _differentiate_at(self, y: Array, node: int) -> tuple[Array, Array]:
        """Return gradient and Hessian at the length of a node, without the prior of the length."""
        fixed, known = self._fixed(node), y[:-1]
        local = fixed._linearise(known)
        gradient, hessian = np.zeros(self.n_parameters), np.zeros((self.n_parameters, self.n_parameters))
        gradient[:-1], hessian[:-1, :-1] = fixed._differentiate(known, local)
        if abs(y[-1]) < REACH:
            inside, speed = slice(self.n_geometry, -1), self.lengths.spread
            first, second, mixed = self._differentiate_by_length(local, fixed.model_errors_at(known), node)
            gradient[-1], hessian[-1, -1] = speed * first, -(speed**2) * second
            hessian[inside, -1] = hessian[-1, inside] = -speed * fixed._moves(known) @ mixed
        return gradient, hessian

    def _differentiate_by_length(self, local: Local, model_errors: Array, node: int) -> tuple[float, float, Array]:
        """Return the log-likelihood's derivative by log L at a node, and expected curvatures.

        With A the precision of all combinations, α = A q, and E = Uᵀ K' U: d log p = ½ (αᵀ (E x D) α - tr A (E x D)),
        D = diag(w s²). The curvatures are with log L itself and with the model errors (2 N,).
        """
        n, weight, turn = (
            self.likelihood.n_legs,
            self._family.at_node(node).actuator_weight,
            self._family.slope_at(node),
        )
        size = weight[0, :n] * model_errors[n:] ** 2
        solved = np.einsum("kij,kj->ki", local.precision, local.errors)
        scaled, own = local.precision * size, np.diagonal(turn)
        first = np.sum(turn * ((solved * size) @ solved.T)) - own @ np.trace(scaled, axis1=1, axis2=2)
        both = np.einsum("kij,lji->kl", scaled, scaled, optimize=True)
        seen = np.tile(np.einsum("kij,kji->ki", scaled, local.precision), 2)
        return 0.5 * float(first), 0.5 * float(np.sum(turn**2 * both)), own @ (seen * weight) * model_errors

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

    def describe_function(self, natural: Array) -> tuple[Kernel, Array]:
        """Return the kernel of the draws' median length, and the rms of each leg's scale over draws (S, n)."""
        node = int(self._family.nearest(np.median(natural[:, -1:], axis=0)))
        return self._family.at_node(node).kernel, super().describe_function(natural)[1]
