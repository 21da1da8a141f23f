"""Sampling coordinates of machines: each parameter by itself, or straightened where a leg's do alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr, ndtri

from bayescal.density.posterior import Sampling
from bayescal.density.priors import HALF_LOG_TWO_PI, Prior
from bayescal.errors import InputError
from bayescal.machines.coordinates import Coordinates, mirror_direction
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array

EDGE = 1e-3  # how near to a bound, by the width of a uniform prior, a machine known otherwise is taken to be


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
            raise InputError(f"parameter {name!r}: expected one of {', '.join(layout.symbols)}")
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
    """

    layout: ParameterLayout
    start: Array  # (D,): the machine as expected
    names: tuple[str, ...]  # length m: of the free parameters, or of those that deviate alike, in the layout's order
    priors: tuple[Prior, ...]  # length m
    moved: Array  # (m, D): which parameters go with which coordinate, ones and zeros

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
        lower, upper = np.array([one.bounds for one in self.priors]).reshape(-1, 2).T
        uniform = np.isfinite(lower)
        return uniform, np.where(uniform, upper - lower, [one.sd for one in self.priors])

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

    def to_coordinates(self, theta: Array) -> Array:
        """Return coordinates, (..., m), of machines brought within the bounds."""
        return self._place(theta, EDGE)

    def _place(self, theta: Array, edge: float) -> Array:
        uniform, width = self._uniform
        away = (theta - self.start)[..., self.free] / width
        share = np.clip(away + 0.5, edge, 1.0 - edge) if edge else away + 0.5
        return np.where(uniform, ndtri(share), away)

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


def build_sampling(
    layout: ParameterLayout,
    priors: Mapping[str, Prior],
    fixed: Mapping[str, float],
    common: Mapping[str, tuple[str, ...]],
    straighten: Callable[[Coordinates], Coordinates | None] | None,
) -> Sampling:
    """Return the coordinates of the free parameters; arguments as of `Elimination.sampling`.

    ``straighten`` takes coordinates in which each parameter is by itself to those in which a machine's ridges are
    straight, or to None where they are that already; None where they shall stay as they are.

    Raises
    ------
    InputError
        For a name that no parameter has.
    """
    if common or straighten is None:
        return AffineSampling.build(layout, priors, fixed, common)
    names, start, moved = place_free(layout, priors, fixed, {})
    free, ordered = np.flatnonzero(moved.any(axis=0)), tuple(priors[name] for name in names)
    lower, upper = np.array([p.bounds for p in ordered]).reshape(-1, 2).T
    scale = np.array([p.sd for p in ordered])
    found = straighten(Coordinates(layout, start, free, scale, np.zeros((0, 3)), lower, upper))
    if found is None:
        return AffineSampling.build(layout, priors, fixed, common)
    units = tuple(layout.units[k] for k in free)
    return LegSampling(layout, found.start, ordered, names, units, found, len(found.legs))


@dataclass(frozen=True, eq=False)
class LegSampling(Sampling):
    """Coordinates of the free parameters of a machine on legs; see `bayescal.machines.coordinates`."""

    layout: ParameterLayout
    start: Array
    priors: tuple[Prior, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    coordinates: Coordinates
    n_jumps: int = 0  # number of legs

    @property
    def free(self) -> np.ndarray:
        """Where the free parameters stand in θ, shape (m,)."""
        return self.coordinates.free

    def theta_from_y(self, y: Array) -> Array:
        """Return full parameter vectors (..., D)."""
        return self.coordinates.theta_from_y(y)

    def y_from_theta(self, theta: Array) -> Array:
        """Return coordinates (..., m)."""
        return self.coordinates.y_from_theta(theta)

    def to_coordinates(self, theta: Array) -> Array:
        """Return coordinates (M, m) of machines (M, D), brought within the bounds of uniform priors."""
        known, theta = self.coordinates, theta.copy()
        lower, upper = known.lower[known.bounded], known.upper[known.bounded]
        margin, places = EDGE * (upper - lower), known.free[known.bounded]
        theta[:, places] = np.clip(theta[:, places], lower + margin, upper - margin)
        return known.y_from_theta(theta)

    def jacobian(self, theta: Array) -> Array:
        """Return dθ/dy, shape (D, m)."""
        return self.coordinates.jacobian(theta)

    # --- prior ---------------------------------------------------------------------------------------------------

    @cached_property
    def _normal(self) -> tuple[np.ndarray, np.ndarray, Array, Array]:
        """Which free parameters have a normal prior, where these stand in θ, and its centres and scales."""
        which = np.flatnonzero(~self.coordinates.standard)
        chosen = [self.priors[k] for k in which]
        return which, self.free[which], np.array([p.mean for p in chosen]), np.array([p.sd for p in chosen])

    @cached_property
    def _log_constant(self) -> float:
        """What the log-prior in the coordinates has that does not vary."""
        *_, scale = self._normal
        return float(self.coordinates.log_scale - np.log(scale).sum() - self.size * HALF_LOG_TWO_PI)

    def log_prior(self, y: Array, theta: Array) -> Array:
        """Return the normal priors, and those of coordinates that are standard normal themselves: bounded ones."""
        _, places, centre, scale = self._normal
        z, standard = (theta[..., places] - centre) / scale, y[..., self.coordinates.standard]
        total = -0.5 * (np.einsum("...i,...i->...", z, z) + np.einsum("...i,...i->...", standard, standard))
        total = total + self.coordinates.log_volume(theta) + self.coordinates.log_ring_ratio(y)
        return np.asarray(total + self._log_constant)

    def prior_residual(self, y: Array, theta: Array) -> Array:
        """Return the prior as residuals of unit variance, shape (m,)."""
        normal, places, centre, scale = self._normal
        residual = y.copy()
        residual[normal] = (theta[places] - centre) / scale
        return residual

    def prior_slope(self, change: Array) -> Array:
        """Return the derivative of `prior_residual`, shape (m, m)."""
        normal, places, _, scale = self._normal
        rows = np.eye(self.size)
        rows[normal] = change[places] / scale[:, None]
        return rows

    def log_volume_slope(self, y: Array, theta: Array, change: Array) -> Array:
        """Return the derivative of the coordinates' volume, shape (m,)."""
        return self.coordinates.log_volume_slope(theta) @ change + self.coordinates.log_ring_ratio_slope(y)

    def draw(self, standard: Array) -> Array:
        """Return draws in the coordinates, NaN where there are none."""
        theta = np.tile(self.start, (len(standard), 1))
        for k, (place, prior) in enumerate(zip(self.free, self.priors, strict=True)):
            theta[:, place] = prior.value(standard[:, k])
        with np.errstate(invalid="ignore"):
            return self.coordinates.y_from_theta(theta)

    # --- legs ----------------------------------------------------------------------------------------------------

    @property
    def moved(self) -> Array:  # type: ignore[override]
        """Which parameters are free, shape (m, D)."""
        return np.eye(self.layout.size)[self.free]

    @cached_property
    def legs(self) -> list[np.ndarray]:
        """Which of the free parameters belong to each leg."""
        own = self.coordinates.symbols  # of the legs, and not of an instrument beside them
        blocks = [one for one in self.layout.blocks if one.per_leg and not one.axes]
        per_leg = [one.symbol for one in blocks if own is None or one.symbol in own]
        legs = [[self.layout.index[s][leg] for s in per_leg] for leg in range(self.n_jumps)]
        return [np.flatnonzero(np.isin(self.free, leg)) for leg in legs]

    def curved_ridges(self) -> list[tuple[int, np.ndarray]]:
        """Return the coordinates of free directions' components, each with the other coordinates of its leg.

        Where κ is fixed the actuator gain is a quadratic of u_x that the other parameters of the leg have to follow.
        """
        components = tuple(f"{symbol}[" for symbol in self.layout.direction_symbols)
        tilted = np.array([name.startswith(components) for name in self.names], dtype=bool)
        return [(int(k), index[~tilted[index]]) for index in self.legs for k in index[tilted[index]]]

    def mode_candidates(self, y: Array) -> list[tuple[int, Array]]:
        """Return legs, and coordinates with the leg's direction mirrored to the other solution of the same gain.

        With one component of u free and κ fixed the actuator's gain along the leg, z · u, has two solutions in every
        leg. With both components free a circle of equal gain joins the two.
        """
        theta = self.theta_from_y(y[None])[0]
        images = []
        for leg, component in self._lone_components:
            mirrored = mirror_direction(self.layout, theta, leg, component, self.coordinates.legs[leg], self.free)
            if mirrored is not None:
                images.append((leg, self.y_from_theta(mirrored)))
        return images

    @cached_property
    def _lone_components(self) -> list[tuple[int, int]]:
        """The legs of which one component of u is free and κ is not, with that component, 0 or 1."""
        layout, free = self.layout, self.free
        if not layout.direction_symbols:
            return []
        components = np.stack([np.isin(layout.index[symbol], free) for symbol in layout.direction_symbols])
        alone = components.sum(axis=0) == 1
        if "kappa" in layout.index:
            alone &= ~np.isin(layout.index["kappa"], free)
        return [(int(leg), int(np.argmax(components[:, leg]))) for leg in np.flatnonzero(alone)]
