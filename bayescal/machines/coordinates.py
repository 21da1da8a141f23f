"""Coordinates in which the ridges of the posterior are straight, so that simple proposals follow them.

Two shears of unit Jacobian take the curvature of the unit sphere, on which u has two components t1 and t2 and a third
that follows (see `directions`), out of the ridges:

- in place of the attachment point a, the joint at the initial actuator position, c = a + ρ^0 u, which is what the poses
  determine;
- in place of κ, the gain of the actuator along the leg, κ' = κ - u_z - (z_x u_x + z_y u_y) / z_z with z the nominal leg
  direction (RR-8096 eqs. 38 to 40), which is what κ and u together can tell. Along a level leg κ does nothing.

Where κ is not free, both components of a direction are replaced by its gain and its azimuth about the leg, in the local
frame of u: by linear functions of these where a normal prior allows but a short arc of the circle (`circles`),
otherwise by quantiles of the prior along it (`rings`).
Struts have neither u nor ρ^0, and ridges that are straight as they stand.

Every coordinate is then scaled by the prior's standard deviation. A parameter between bounds is not sheared; its
coordinate y is standard normal under the uniform prior, θ = lower + (upper - lower) Φ(y), so that no climb and no
walker runs into a wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import prod

import numpy as np
from scipy.special import ndtr, ndtri

from bayescal.machines.circles import DirectionCircles, find_circles, frame_circles
from bayescal.machines.models.legs import actuator_directions, chart_of, local_directions
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.rings import DirectionRing
from bayescal.machines.shears import Shears
from bayescal.numerics.geometry import Array

WIDEST = 3.0  # prior sds, in units of the sine between direction and leg, beyond which a circle is lost in the prior


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Bijection between sampling coordinates y, shape (..., n), and full parameter vectors θ, shape (..., D).

    Attributes
    ----------
    layout : ParameterLayout
        Layout of θ.
    start : ndarray, shape (D,)
        Values of the parameters that are fixed, and the origin of the coordinates.
    free : ndarray of int, shape (n,)
        Positions of the free parameters in θ.
    scale : ndarray, shape (n,)
        Unit of each coordinate.
    legs : ndarray, shape (N, 3)
        The nominal legs' lines, as `compute_leg_lines` gives them; not used without actuator directions.
    lower, upper : ndarray, shape (n,)
        Bounds of each free parameter, infinite where there are none.
    """

    layout: ParameterLayout
    start: Array
    free: np.ndarray
    scale: Array
    legs: Array
    lower: Array
    upper: Array

    @cached_property
    def bounded(self) -> np.ndarray:
        """Which free parameters have bounds, shape (n,)."""
        return np.isfinite(self.lower)

    @cached_property
    def _mask(self) -> np.ndarray:
        mask = np.zeros(self.layout.size, dtype=bool)
        mask[self.free[~self.bounded]] = True
        return mask

    @cached_property
    def _circles(self) -> tuple[np.ndarray, DirectionCircles] | None:
        """Legs with both components of u free, without bounds, and κ not; their circles."""
        index, symbols = self.layout.index, self.layout.direction_symbols
        if not symbols:
            return None
        first, second = (index[symbol] for symbol in symbols)
        both = self._mask[first] & self._mask[second]
        if "kappa" in index:
            both &= ~np.isin(index["kappa"], self.free)
        legs = np.flatnonzero(both)
        if not len(legs):
            return None
        sd = self._direction_spread(legs).max(axis=1)
        clear, circles = find_circles(*self._local_pairs(legs), sd)
        return (legs[clear], circles) if clear.any() else None

    def _direction_spread(self, legs: np.ndarray) -> Array:
        """Return the prior sds of both components of legs' directions, shape (K, 2)."""
        places = [np.searchsorted(self.free, self.layout.index[s][legs]) for s in self.layout.direction_symbols]
        return np.stack([self.scale[place] for place in places], axis=1)

    def _local_pairs(self, legs: np.ndarray) -> tuple[Array, Array]:
        """Return nominal directions and lines of legs in their local frames, shapes (K, 3)."""
        lines = chart_of(self.layout).to_local(self.legs)[legs]
        return local_directions(self.layout, self.start)[legs], lines

    @cached_property
    def rings(self) -> tuple[tuple[int, np.ndarray, DirectionRing], ...]:
        """Legs whose direction's prior is wide or bounded, where in y its components stand, and the ring of each."""
        index, symbols = self.layout.index, self.layout.direction_symbols
        if not symbols:
            return ()
        first, second = (np.isin(index[symbol], self.free) for symbol in symbols)
        both = first & second
        if "kappa" in index:
            both &= ~np.isin(index["kappa"], self.free)
        if self._circles is not None:
            both[self._circles[0]] = False
        return tuple(ring for leg in np.flatnonzero(both) if (ring := self._find_ring(int(leg))) is not None)

    def _find_ring(self, leg: int) -> tuple[int, np.ndarray, DirectionRing] | None:
        """Return a leg's ring; None where the direction lies so near to the leg that the prior hardly sees it."""
        legs = np.array([leg])
        direction, line = self._local_pairs(legs)
        spread = self._direction_spread(legs)[0]
        sine = float(np.linalg.norm(np.cross(direction[0], line[0])) / np.linalg.norm(line[0]))
        if not 0.0 < spread.max() < WIDEST * sine:
            return None
        places = np.array(
            [np.searchsorted(self.free, self.layout.index[s][leg]) for s in self.layout.direction_symbols]
        )
        ring = DirectionRing(
            frame_circles(direction, line), direction[0, :2], spread, self.lower[places], self.upper[places]
        )
        return leg, places, ring

    @cached_property
    def ringed(self) -> np.ndarray:
        """Which coordinates are those of rings, shape (n,)."""
        ringed = np.zeros(len(self.free), dtype=bool)
        for _, places, _ in self.rings:
            ringed[places] = True
        return ringed

    @cached_property
    def by_quantile(self) -> np.ndarray:
        """Which coordinates are a bounded parameter's quantile, shape (n,)."""
        return self.bounded & ~self.ringed

    @cached_property
    def standard(self) -> np.ndarray:
        """Which coordinates are standard normal under the prior, those of rings but for their ratio, shape (n,)."""
        return self.bounded | self.ringed

    @cached_property
    def _on_circles(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the coordinates of gain and azimuth stand in y."""
        assert self._circles is not None
        legs, _ = self._circles
        gain, azimuth = (np.searchsorted(self.free, self.layout.index[s][legs]) for s in self.layout.direction_symbols)
        return gain, azimuth

    @cached_property
    def log_scale(self) -> float:
        """Logarithm of the constant part of the volume dθ/dy of the parameters without bounds."""
        return float(np.log(self.scale[~self.standard]).sum())

    def log_volume(self, theta: Array) -> Array | float:
        """Return the part of log |dθ/dy| of the parameters without bounds that varies, shape (..., D) to (...)."""
        if self._circles is None:
            return 0.0
        third = local_directions(self.layout, theta)[..., self._circles[0], 2]
        return np.asarray(np.log(third).sum(axis=-1))

    def log_volume_slope(self, theta: Array) -> Array:
        """Return the derivative of `log_volume` by θ, shape (D,), at one vector (D,)."""
        slope = np.zeros(self.layout.size)
        if self._circles is not None:
            legs, _ = self._circles
            u = local_directions(self.layout, theta)[legs]
            for k, symbol in enumerate(self.layout.direction_symbols):
                slope[self.layout.index[symbol][legs]] = -u[:, k] / u[:, 2] ** 2
        return slope

    def log_ring_ratio(self, y: Array) -> Array | float:
        """Return the prior's log-density of all rings' coordinates less that of standard normals, (..., n) to (...)."""
        total: Array | float = 0.0
        for _, places, ring in self.rings:
            pairs = y[..., places]
            total = total + ring.log_prior_ratio(pairs.reshape(-1, 2)).reshape(pairs.shape[:-1])
        return total

    def log_ring_ratio_slope(self, y: Array) -> Array:
        """Return its derivative by the coordinates at y, shape (n,)."""
        slope = np.zeros(len(self.free))
        for _, places, ring in self.rings:
            slope[places] = ring.log_prior_ratio_slope(y[places])
        return slope

    @cached_property
    def _along_leg(self) -> Array:
        """Which parts of its joint the length of a leg on a circle follows, shape (N, 3).

        Poses tell l + z · c. A part of c whose attachment point is not free moves with u, and l makes up for it.
        """
        along = np.zeros((len(self.legs), 3))
        if not self.layout.direction_symbols:
            return along
        for leg in (*(leg for leg, _, _ in self.rings), *(self._circles[0] if self._circles else ())):
            unit = self.legs[leg] / np.linalg.norm(self.legs[leg])
            held = [not self._mask[self.layout.index[f"a_{axis}"][leg]] for axis in "xyz"]
            along[leg] = np.where(held, unit, 0.0)
        return along

    @cached_property
    def _shears(self) -> Shears | None:
        """The shears; None where no parameter follows a direction."""
        if "rho0" not in self.layout.index:
            return None
        return Shears(self.layout, self._mask, self.legs, self._along_leg)

    @cached_property
    def _origin(self) -> Array:
        """Sheared start values of the free parameters."""
        return self._shear(self.start[None].copy(), 1.0)[0, self.free]

    def _shear(self, theta: Array, sign: float) -> Array:
        """Return parameter vectors (B, D) with the shears added to them, in place, times a sign."""
        if self._shears is not None:
            self._shears.apply(theta.T, sign)
        return theta

    @cached_property
    def _quantiles(self) -> tuple[np.ndarray, np.ndarray, Array, Array] | None:
        """Where parameters with bounds stand in y and in θ, their lower bounds and widths; None for none."""
        inside = np.flatnonzero(self.by_quantile)
        if not len(inside):
            return None
        return inside, self.free[inside], self.lower[inside], (self.upper - self.lower)[inside]

    def theta_from_y(self, y: Array) -> Array:
        """Return full parameter vectors (..., D); NaN where a direction leaves the unit sphere.

        Batches have the parameters' values one after another in memory: that is how they are worked on.
        """
        flat = y.reshape(prod(y.shape[:-1]), y.shape[-1])
        parameters = np.empty((self.layout.size, len(flat)))
        parameters[:] = self.start[:, None]
        moved = np.multiply(flat.T, self.scale[:, None], out=np.empty(flat.shape[::-1]))
        moved += self._origin[:, None]
        parameters[self.free] = moved
        theta = parameters.T
        if self._quantiles is not None:
            inside, places, lower, width = self._quantiles
            theta[:, places] = lower + width * ndtr(flat[:, inside])
        if self._circles is not None:
            legs, circles = self._circles
            gain, azimuth = self._on_circles
            w = circles.gain + flat[:, gain] * self.scale[gain] * circles.sine
            found = circles.directions(w, flat[:, azimuth] * self.scale[azimuth] / circles.sine)
            for symbol, component in zip(self.layout.direction_symbols, found, strict=True):
                theta[:, self.layout.index[symbol][legs]] = component
        for _, places, ring in self.rings:
            theta[:, self.free[places]] = ring.components(flat[:, places])
        return self._shear(theta, -1.0).reshape(*y.shape[:-1], self.layout.size)

    def y_from_theta(self, theta: Array) -> Array:
        """Return the coordinates (..., n) of full parameter vectors (..., D)."""
        sheared = self._shear(theta.reshape(-1, self.layout.size).copy(), 1.0).reshape(theta.shape)
        y = (sheared[..., self.free] - self._origin) / self.scale
        if self._quantiles is not None:
            y[..., self._quantiles[0]] = ndtri(self._share(theta))
        for leg, places, ring in self.rings:
            u = local_directions(self.layout, theta)[..., leg, :]
            y[..., places] = ring.coordinates(u.reshape(-1, 3)).reshape(*u.shape[:-1], 2)
        if self._circles is not None:
            legs, circles = self._circles
            gain, azimuth = self._on_circles
            w, psi = circles.polar(local_directions(self.layout, theta)[..., legs, :])
            y[..., gain] = (w - circles.gain) / (self.scale[gain] * circles.sine)
            y[..., azimuth] = psi * circles.sine / self.scale[azimuth]
        return y

    def _share(self, theta: Array) -> Array:
        """Return where the parameters with bounds lie between them, from 0 to 1."""
        assert self._quantiles is not None
        _, places, lower, width = self._quantiles
        return (theta[..., places] - lower) / width

    def jacobian(self, theta: Array) -> Array:
        """Return dθ/dy, shape (D, n), at one parameter vector (D,)."""
        index = self.layout.index
        change = np.eye(self.layout.size) if self._shears is None else self._shears.slope(theta)
        if self._circles is not None:
            legs, circles = self._circles
            first, second = (index[symbol][legs] for symbol in self.layout.direction_symbols)
            x, y = change[:, first].copy(), change[:, second].copy()
            by_gain, by_azimuth = circles.slopes(local_directions(self.layout, theta)[legs])
            by_gain, by_azimuth = by_gain * circles.sine[:, None], by_azimuth / circles.sine[:, None]
            change[:, first] = x * by_gain[:, 0] + y * by_gain[:, 1]
            change[:, second] = x * by_azimuth[:, 0] + y * by_azimuth[:, 1]
        scale = self.scale if not self.rings else np.where(self.ringed, 1.0, self.scale)
        for leg, places, ring in self.rings:
            columns = self.free[places]
            u = local_directions(self.layout, theta)[leg]
            change[:, columns] = change[:, columns] @ ring.slopes(ring.coordinates(u[None])[0])
        if self._quantiles is not None:
            inside, _, _, width = self._quantiles
            normal_density = np.exp(-0.5 * ndtri(self._share(theta)) ** 2) / np.sqrt(2 * np.pi)
            scale = scale.copy()
            scale[inside] = width * normal_density
        return change[:, self.free] * scale


def mirror_direction(
    layout: ParameterLayout, theta: Array, leg: int, component: int, line: Array, free: np.ndarray
) -> Array | None:
    """Return θ with one leg's actuator turned to the other direction of the same gain, its home joint kept in place.

    With one component of u free, the actuator turns in the plane of e1 or e2 and the pole (see `directions`). The gain
    along the leg is even about the leg's line in that plane. Only the free ones of the attachment point's coordinates
    follow. None where the other direction is further from the pole than the components tell.

    Parameters
    ----------
    layout : ParameterLayout
    theta : ndarray, shape (D,)
    leg : int
        Counted from zero.
    component : int
        Which one of the direction's two turns.
    line : ndarray, shape (3,)
        Along the nominal leg, base frame, of any length and sense.
    free : ndarray of int
        Positions of the free parameters in θ.
    """
    mirrored = theta.copy()
    before, local = actuator_directions(layout, theta)[leg], local_directions(layout, theta)[leg]
    slope = line_slope(layout, leg, component, line)
    angle = 2 * np.arctan(slope) - np.arctan2(local[component], local[2])
    if not np.cos(angle) > 0.0:
        return None
    symbol = layout.direction_symbols[component]
    mirrored[layout.index[symbol][leg]] = np.hypot(local[component], local[2]) * np.sin(angle)
    moved = layout.take(theta, "rho0")[leg] * (before - actuator_directions(layout, mirrored)[leg])
    for shift, axis in zip(moved, "xyz", strict=True):
        position = layout.index[f"a_{axis}"][leg]
        if position in free:
            mirrored[position] += shift
    return mirrored


def line_slope(layout: ParameterLayout, leg: int, component: int, line: Array) -> float:
    """Return a line's part along e1 or e2 of a leg over that along its pole; infinite across the pole."""
    local = chart_of(layout).to_local(np.broadcast_to(line, (len(layout.index["l"]), 3)))[leg]
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.nan_to_num(local[component] / local[2], nan=0.0, posinf=np.inf, neginf=-np.inf))
