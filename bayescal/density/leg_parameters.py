"""Which free parameters each leg has, and what is special about its actuator's direction."""

from __future__ import annotations

import numpy as np

from bayescal.machines.coordinates import Coordinates, mirror_direction
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array


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
