"""Coordinates of a machine that one function describes: each parameter by itself, standard normal under its prior."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr, ndtri

from bayescal.density.priors import Prior, UniformPrior
from bayescal.density.protocols import Sampling
from bayescal.errors import InputError
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array

EDGE = 1e-3  # how near to a bound, by the width of a uniform prior, a machine known otherwise is taken to be
HALF_LOG_TWO_PI = 0.5 * float(np.log(2 * np.pi))


def place_free(
    layout: ParameterLayout,
    priors: Mapping[str, Prior],
    fixed: Mapping[str, float],
    common: Mapping[str, tuple[str, ...]],
) -> tuple[tuple[str, ...], Array, Array]:
    """Return the names of what is free in the layout's order, the machine as expected and which parameters it moves.

    Arguments are those of `Elimination.sampling`; shapes (m,), (D,) and (m, D). InputError for a name that no parameter
    has.
    """
    shared = [name for members in common.values() for name in members]
    for name in (*(name for name in priors if name not in common), *shared, *fixed):
        if name not in layout.names:
            raise InputError(f"parameter {name!r}: unknown here, expected one of {', '.join(layout.symbols)}")
    places = {name: [layout.names.index(one) for one in common.get(name, (name,))] for name in priors}
    names = tuple(sorted(priors, key=lambda name: places[name][0]))
    start, moved = layout.nominal.copy(), np.zeros((len(names), layout.size))
    for name, value in fixed.items():
        start[layout.names.index(name)] = value
    for k, name in enumerate(names):
        own = places[name]
        start[own] = priors[name].mean + (start[own] - start[own[0]])
        moved[k, own] = 1.0
    return names, start, moved


@dataclass(frozen=True, eq=False)
class AffineSampling(Sampling):
    """Coordinates that are standard normal under the prior.

    A normal prior's parameter is counted in its standard deviations, a uniform one's by Φ.

    Attributes
    ----------
    layout : ParameterLayout
    start : ndarray, shape (D,)
        The machine as expected.
    names : tuple of str, length m
        Of the free parameters, or of those that deviate alike, in the layout's order.
    priors : tuple of Prior, length m
    moved : ndarray, shape (m, D)
        Which parameters go with which coordinate, ones and zeros.
    """

    layout: ParameterLayout
    start: Array
    names: tuple[str, ...]
    priors: tuple[Prior, ...]
    moved: Array

    @classmethod
    def build(
        cls,
        layout: ParameterLayout,
        priors: Mapping[str, Prior],
        fixed: Mapping[str, float],
        common: Mapping[str, tuple[str, ...]],
    ) -> AffineSampling:
        """Return the coordinates; see `Elimination.sampling` and `place_free`."""
        names, start, moved = place_free(layout, priors, fixed, common)
        return cls(layout, start, names, tuple(priors[name] for name in names), moved)

    @cached_property
    def free(self) -> np.ndarray:
        """Where the free parameters stand in θ, the first of those that deviate alike, shape (m,)."""
        return np.argmax(self.moved, axis=1) if len(self.moved) else np.empty(0, dtype=int)

    @cached_property
    def units(self) -> tuple[str, ...]:  # type: ignore[override]
        """Units of the free parameters."""
        return tuple(self.layout.units[k] for k in self.free)

    @cached_property
    def _uniform(self) -> tuple[np.ndarray, Array]:
        """Which priors are uniform, and their widths, standard deviations of the others."""
        uniform = np.array([isinstance(one, UniformPrior) for one in self.priors], dtype=bool)
        widths = [one.upper - one.lower if isinstance(one, UniformPrior) else one.sd for one in self.priors]
        return uniform, np.array(widths)

    def _deviate(self, y: Array) -> Array:
        """Return deviations from the priors' means, (..., m)."""
        uniform, width = self._uniform
        return np.where(uniform, (ndtr(y) - 0.5) * width, y * width)

    def theta_from_y(self, y: Array) -> Array:
        """Return full parameter vectors, (..., D)."""
        return np.asarray(self.start + self._deviate(y) @ self.moved)

    def y_from_theta(self, theta: Array) -> Array:
        """Return coordinates, (..., m); NaN beyond a uniform prior's bounds."""
        return self._place(theta, 0.0)

    def adopt(self, theta: Array) -> Array:
        """Return coordinates, (..., m), of machines brought within the bounds."""
        return self._place(theta, EDGE)

    def _place(self, theta: Array, edge: float) -> Array:
        uniform, width = self._uniform
        away = (theta - self.start)[..., self.free] / width
        share = np.clip(away + 0.5, edge, 1.0 - edge) if edge else away + 0.5
        return np.where(uniform, ndtri(share), away)

    def natural(self, theta: Array) -> Array:
        """Return the free parameters in their own units, (..., m)."""
        return theta[..., self.free]

    def jacobian(self, theta: Array) -> Array:
        """Return dθ/dy, shape (D, m)."""
        uniform, width = self._uniform
        y = self.y_from_theta(theta)
        speed = np.where(uniform, np.exp(-0.5 * y * y - HALF_LOG_TWO_PI) * width, width)
        return np.asarray((self.moved * speed[:, None]).T)

    # --- prior ---------------------------------------------------------------------------------------------------

    def log_prior(self, y: Array, theta: Array) -> Array:
        """Return the standard normal log-density, shape (B,)."""
        del theta
        return np.asarray(-0.5 * np.einsum("...i,...i->...", y, y) - self.size * HALF_LOG_TWO_PI)

    def prior_residual(self, y: Array, theta: Array) -> Array:
        """Return y: it is standard normal."""
        del theta
        return y

    def prior_slope(self, change: Array) -> Array:
        """Return one."""
        return np.eye(change.shape[1])

    def draw(self, standard: Array) -> Array:
        """Return the standard normal numbers as they are."""
        return standard
