"""The prior of a machine's free parameters, and the sampling coordinates that it gives them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from bayescal.density.priors import Prior, UniformPrior
from bayescal.errors import InputError
from bayescal.machines.coordinates import Coordinates, mirror_direction
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array


def build_coordinates(
    layout: ParameterLayout, lines: Array, priors: Mapping[str, Prior], fixed: Mapping[str, float]
) -> Coordinates:
    """Return the coordinates of the free parameters.

    Parameters
    ----------
    layout : ParameterLayout
    lines : ndarray, shape (N, 3)
        Along the nominal legs, base frame.
    priors : mapping of parameter name to Prior
        Of the free parameters.
    fixed : mapping of parameter name to float
        Values of fixed parameters that are not nominal.
    """
    start = layout.nominal.copy()
    position = {name: k for k, name in enumerate(layout.names)}
    for name, value in fixed.items():
        start[position[name]] = value
    free = np.array(sorted(position[name] for name in priors), dtype=int)
    ordered = [priors[layout.names[k]] for k in free]
    start[free] = [prior.mean for prior in ordered]
    bounds = [(p.lower, p.upper) if isinstance(p, UniformPrior) else (-np.inf, np.inf) for p in ordered]
    lower, upper = np.array(bounds).reshape(-1, 2).T
    scale = np.array([p.sd for p in ordered])
    return Coordinates(layout, start, free, scale, lines, lower, upper)


def check_bounds(coordinates: Coordinates) -> None:
    """Raise InputError where the ends of a uniform prior are no machine's parameters."""
    layout, bounded = coordinates.layout, coordinates.bounded
    lowest, highest = layout.limits
    for k, low, high in zip(
        coordinates.free[bounded], coordinates.lower[bounded], coordinates.upper[bounded], strict=True
    ):
        if low < lowest[k] or high > highest[k]:
            raise InputError(
                f"parameter {layout.names[k]}: found a prior from {low:g} to {high:g}, "
                f"expected it between {lowest[k]:g} and {highest[k]:g}"
            )


@dataclass(frozen=True, eq=False)
class GeometryPrior:
    """Prior of the free parameters in their sampling coordinates.

    Attributes
    ----------
    coordinates : Coordinates
    priors : mapping of parameter name to Prior
        Of the m free parameters.
    """

    coordinates: Coordinates
    priors: Mapping[str, Prior]

    @cached_property
    def ordered(self) -> tuple[Prior, ...]:
        """Priors of the free parameters, in order."""
        return tuple(self.priors[self.coordinates.layout.names[k]] for k in self.coordinates.free)

    @cached_property
    def normal(self) -> tuple[np.ndarray, np.ndarray, Array, Array]:
        """Which free parameters have a normal prior, where these stand in θ, and its centres and scales."""
        which = np.flatnonzero(~self.coordinates.standard)
        chosen = [self.ordered[k] for k in which]
        return which, self.coordinates.free[which], np.array([p.mean for p in chosen]), np.array([p.sd for p in chosen])

    def draw(self, standard: Array) -> Array:
        """Return draws in the coordinates, (S, m), from standard normal numbers (S, >= m); NaN where there are none."""
        theta = np.tile(self.coordinates.start, (len(standard), 1))
        for k, (place, prior) in enumerate(zip(self.coordinates.free, self.ordered, strict=True)):
            theta[:, place] = prior.at_quantile(ndtr(standard[:, k]))
        with np.errstate(invalid="ignore"):
            return self.coordinates.y_from_theta(theta)

    def residual(self, y: Array, theta: Array) -> Array:
        """Return the prior as residuals of unit variance, shape (m,), at coordinates (m,) and θ (D,)."""
        normal, places, centre, scale = self.normal
        residual = y.copy()
        residual[normal] = (theta[places] - centre) / scale
        return residual

    def slope(self, change: Array) -> Array:
        """Return the derivative of `residual` by the coordinates, shape (m, m), from dθ/dy, shape (D, m)."""
        normal, places, _, scale = self.normal
        rows = np.eye(len(self.priors))
        rows[normal] = change[places] / scale[:, None]
        return rows


# --- what is special about legs -------------------------------------------------------------------------------------


def find_legs(layout: ParameterLayout, free: np.ndarray, n_legs: int) -> list[np.ndarray]:
    """Return which of the free parameters, by their positions in θ (m,), belong to each leg."""
    per_leg = [block.symbol for block in layout.blocks if block.per_leg]
    legs = [[layout.index[s][leg] for s in per_leg] for leg in range(n_legs)]
    return [np.flatnonzero(np.isin(free, leg)) for leg in legs]


def find_curved_ridges(
    layout: ParameterLayout, free: np.ndarray, legs: list[np.ndarray]
) -> list[tuple[int, np.ndarray]]:
    """Return the free parameters that are components of directions, each with the others of its leg."""
    components = tuple(f"{symbol}[" for symbol in layout.direction_symbols)
    tilted = np.array([layout.names[k].startswith(components) for k in free], dtype=bool)
    return [(int(k), index[~tilted[index]]) for index in legs for k in index[tilted[index]]]


def mirror_lone_components(coordinates: Coordinates, y: Array) -> list[tuple[int, Array]]:
    """Return legs, and coordinates (m,) with the leg's direction mirrored, of the geometry's coordinates (m,)."""
    theta = coordinates.theta_from_y(y[None])[0]
    images = []
    for leg, component in _find_lone_components(coordinates):
        mirrored = mirror_direction(coordinates.layout, theta, leg, component, coordinates.legs[leg], coordinates.free)
        if mirrored is not None:
            images.append((leg, coordinates.y_from_theta(mirrored)))
    return images


def _find_lone_components(coordinates: Coordinates) -> list[tuple[int, int]]:
    """Return the legs of which one component of u is free and κ is not, with that component, 0 or 1."""
    layout, free = coordinates.layout, coordinates.free
    if not layout.direction_symbols:
        return []
    components = np.stack([np.isin(layout.index[symbol], free) for symbol in layout.direction_symbols])
    alone = components.sum(axis=0) == 1
    if "kappa" in layout.index:
        alone &= ~np.isin(layout.index["kappa"], free)
    return [(int(leg), int(np.argmax(components[:, leg]))) for leg in np.flatnonzero(alone)]
