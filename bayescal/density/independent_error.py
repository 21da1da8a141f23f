"""The model error τ: what a wrong model does to a leg, drawn anew at every pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erfcinv, erfinv, ndtr

from bayescal.numerics.geometry import Array


@dataclass(frozen=True)
class ModelError:
    """The model error τ per leg: free with a half-normal prior of the given scale in mm, or none at all (scale None).

    Its sampling coordinate ζ is standard normal under the prior: Φ(ζ) is the prior probability of a smaller τ.
    """

    scale: float | None
    shared: bool = False

    def n_parameters(self, n_legs: int) -> int:
        """Return the number of free model errors."""
        if self.scale is None:
            return 0
        return 1 if self.shared else n_legs

    def names(self, n_legs: int) -> tuple[str, ...]:
        """Names of the free model errors."""
        if self.n_parameters(n_legs) == 1:
            return ("tau",)
        return tuple(f"tau[{leg}]" for leg in range(1, self.n_parameters(n_legs) + 1))

    def tau_from_zeta(self, zeta: Array) -> Array:
        """Return τ in mm."""
        assert self.scale is not None
        tail = ndtr(-np.abs(zeta))
        return self.scale * np.sqrt(2.0) * np.where(zeta > 0, erfcinv(tail), erfinv(tail))

    def slope(self, zeta: Array, tau: Array) -> Array:
        """Return dτ/dζ in mm."""
        assert self.scale is not None
        return 0.5 * self.scale * np.exp(0.5 * ((tau / self.scale) ** 2 - zeta**2))

    def bend(self, zeta: Array, tau: Array) -> Array:
        """Return d²τ/dζ² in mm."""
        assert self.scale is not None
        slope = self.slope(zeta, tau)
        return slope * (tau * slope / self.scale**2 - zeta)
