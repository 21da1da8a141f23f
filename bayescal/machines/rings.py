"""Actuator directions on circles about their legs.

Without a free κ the poses determine one number of a direction u: the gain along the leg, w = u · z. Directions of one
gain lie on a circle of the unit sphere about z, which in (u_x, u_y) is a strongly curved ridge. `DirectionCircles`, for
narrow normal priors, has it straight in (w, ψ), ψ the azimuth about z; w and ψ measure area on the sphere:
du_x du_y = u_z dw dψ.

`DirectionRing` is for priors as wide as these circles or with bounds. The gain gives the angle t between leg and
direction, and leaves the azimuth to the prior, which may allow all of the circle, or the arcs of it that lie between
bounds. Coordinates y1 and y2 are close to independent standard normals under the prior: t has the quantile Φ(y1) of the
prior's marginal, and ψ the quantile Φ(y2) along the circle: of the arcs between bounds, whose ends are known in closed
form, or of normal priors along the circle through the nominal direction. What the prior differs from a standard normal
in these coordinates is known exactly, so that the quantiles need not be. In the local frame of u (see `parameters`)
du1 du2 = u3 sin t dt dψ.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr, ndtri

from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

CLEARANCE = 3.0  # prior sds between a direction and its leg, below which the azimuth means nothing


@dataclass(frozen=True, eq=False)
class DirectionCircles:
    """The map between directions and (w, ψ) for K legs; ψ counts from the nominal direction."""

    axis: Array  # (K, 3): orthonormal frame of each leg: along it, towards the nominal direction, and across
    radial: Array  # (K, 3)
    tangential: Array  # (K, 3)
    gain: Array  # (K,): cosine and sine of the nominal angle between direction and leg
    sine: Array  # (K,)

    def directions(self, w: Array, psi: Array) -> tuple[Array, Array]:
        """Return u_x and u_y, shapes (..., K); NaN where u does not exist or does not point upwards."""
        with np.errstate(invalid="ignore"):
            sine = np.sqrt(1.0 - w * w)
        around = np.cos(psi)[..., None] * self.radial + np.sin(psi)[..., None] * self.tangential
        u = w[..., None] * self.axis + sine[..., None] * around
        upward = u[..., 2] > 0
        return np.where(upward, u[..., 0], np.nan), np.where(upward, u[..., 1], np.nan)

    def polar(self, u: Array) -> tuple[Array, Array]:
        """Return w and ψ of unit vectors (..., K, 3)."""
        w, across = (np.einsum("...k,...k->...", u, e) for e in (self.axis, self.tangential))
        return w, np.arctan2(across, np.einsum("...k,...k->...", u, self.radial))

    def slopes(self, u: Array) -> tuple[Array, Array]:
        """Return d(u_x, u_y)/dw and d(u_x, u_y)/dψ, shapes (K, 2), at unit vectors (K, 3)."""
        w, _ = self.polar(u)
        square = 1.0 - w * w
        by_w = self.axis - (w / square)[:, None] * (u - w[:, None] * self.axis)
        return by_w[:, :2], np.cross(self.axis, u)[:, :2]


def find_circles(directions: Array, legs: Array, sd: Array) -> tuple[np.ndarray, DirectionCircles]:
    """Return which of K legs have a circle, shape (K,), and the circles of those.

    Of nominal unit directions and leg vectors (K, 3), and prior standard deviations of the directions (K,).
    """
    with np.errstate(invalid="ignore"):  # of a direction along its leg
        every = frame_circles(directions, legs)
    clear = every.sine > CLEARANCE * sd
    return clear, DirectionCircles(*(part[clear] for part in vars(every).values()))


def frame_circles(directions: Array, legs: Array) -> DirectionCircles:
    """Return the circles through nominal unit directions (K, 3) about legs (K, 3) that these do not point along."""
    axis = legs / np.linalg.norm(legs, axis=1, keepdims=True)
    gain = np.einsum("ik,ik->i", directions, axis)
    across = directions - gain[:, None] * axis
    sine = np.linalg.norm(across, axis=1)
    radial = across / sine[:, None]
    return DirectionCircles(axis, radial, np.cross(axis, radial), gain, sine)


FURTHEST = 8.0  # prior sds from the nominal direction that the quantiles reach
N_ANGLES, N_AZIMUTHS = 600, 720
ZOOMS = 4
TAIL = 1e-14
NEWTON = 30  # steps, of which five do
HALF_LOG_TWO_PI = 0.5 * float(np.log(2 * np.pi))
DIFFERENCE_STEP = 1e-5  # of a coordinate, for derivatives by central differences


@dataclass(frozen=True, eq=False)
class DirectionRing:
    """The map between coordinates (y1, y2) and a direction's components (u1, u2) of one leg."""

    circles: DirectionCircles  # of this leg alone
    centre: Array  # (2,): of the components' priors
    sd: Array  # (2,)
    lower: Array  # (2,): bounds; infinite where a prior is normal
    upper: Array  # (2,)

    # --- the prior -----------------------------------------------------------------------------------------------

    @cached_property
    def _bounded(self) -> np.ndarray:
        return np.isfinite(self.lower)

    def log_prior(self, u: Array) -> Array:
        """Return the log-density of components (..., 2) of directions that exist."""
        z = (u - self.centre) / self.sd
        normal = -0.5 * z * z - np.log(self.sd) - HALF_LOG_TWO_PI
        with np.errstate(invalid="ignore"):
            inside = (u >= self.lower) & (u <= self.upper)
            width = np.log(np.where(self._bounded, self.upper - self.lower, 1.0))
        return np.sum(np.where(self._bounded, np.where(inside, -width, -np.inf), normal), axis=-1)

    def _direction(self, angle: Array, azimuth: Array) -> Array:
        """Return unit vectors (..., 3) in the local frame; the last component may be negative."""
        c = self.circles
        around = np.cos(azimuth)[..., None] * c.radial[0] + np.sin(azimuth)[..., None] * c.tangential[0]
        return np.cos(angle)[..., None] * c.axis[0] + np.sin(angle)[..., None] * around

    def _density(self, angle: Array, azimuth: Array) -> Array:
        """Return the prior's density by t and ψ."""
        u = self._direction(angle, azimuth)
        with np.errstate(divide="ignore"):
            return np.where(u[..., 2] > 0, np.exp(self.log_prior(u[..., :2])) * u[..., 2] * np.sin(angle), 0.0)

    # --- quantiles -----------------------------------------------------------------------------------------------

    @cached_property
    def _angle_of_y(self) -> CubicHermiteSpline:
        """The angle t by y1."""
        nominal, reach = np.arcsin(self.circles.sine[0]), FURTHEST * float(np.hypot(*self.sd))
        low, high = max(0.0, nominal - reach), min(np.pi / 2, nominal + reach) * 1.5
        azimuth = np.linspace(-np.pi, np.pi, N_AZIMUTHS, endpoint=False)
        for _ in range(ZOOMS):  # on where the prior is: bounds may leave but a small part
            grid = np.linspace(low, high, N_ANGLES)
            if self._bounded.all():
                density = self._arcs(grid)[1].sum(axis=1) * np.sin(grid)
            else:
                density = self._density(grid[:, None], azimuth).mean(axis=1)
            there = np.flatnonzero(density > 0.0)
            low, high = grid[max(there[0] - 1, 0)], grid[min(there[-1] + 1, N_ANGLES - 1)]
        return _interpolate_quantiles(grid, density)

    @cached_property
    def _azimuth_of_y(self) -> CubicHermiteSpline:
        """The azimuth ψ by y2 under priors without bounds."""
        angle = max(float(np.arcsin(self.circles.sine[0])), float(self.sd.min()))
        grid = np.linspace(-np.pi, np.pi, 4 * N_AZIMUTHS + 1)
        return _interpolate_quantiles(grid, self._density(np.full_like(grid, angle), grid))

    def _arcs(self, angle: Array) -> tuple[Array, Array]:
        """Return edges (B, E + 1) of the pieces of circles at angles (B,), and the lengths (B, E) of those inside."""
        cosine, sine, c = np.cos(angle), np.sin(angle), self.circles
        edges = np.full((len(angle), 2 + 4 * int(self._bounded.sum())), np.pi)
        edges[:, 0] = -np.pi
        for column, k in enumerate(np.flatnonzero(self._bounded)):
            size = sine * np.hypot(c.radial[0, k], c.tangential[0, k])
            middle = np.arctan2(c.tangential[0, k], c.radial[0, k])
            bounds = np.array([self.lower[k], self.upper[k]])
            with np.errstate(invalid="ignore", divide="ignore"):
                half = np.arccos((bounds - (cosine * c.axis[0, k])[:, None]) / size[:, None])
            crossings = np.concatenate([middle + half, middle - half], axis=1)
            crossings -= 2 * np.pi * np.floor((crossings + np.pi) / (2 * np.pi))
            edges[:, 2 + 4 * column : 6 + 4 * column] = np.where(np.isfinite(crossings), crossings, np.pi)
        edges.sort(axis=1)
        return edges, np.where(self._allows(cosine, sine, 0.5 * (edges[:, 1:] + edges[:, :-1])), np.diff(edges), 0.0)

    def _allows(self, cosine: Array, sine: Array, azimuth: Array) -> np.ndarray:
        """Return whether directions exist and lie between the bounds; cos t and sin t (B,), azimuths (B, E)."""
        c, (around, across) = self.circles, (np.cos(azimuth), np.sin(azimuth))

        def component(k: int) -> Array:
            part = c.radial[0, k] * around + c.tangential[0, k] * across
            return (cosine * c.axis[0, k])[:, None] + sine[:, None] * part

        inside = component(2) > 0
        for k in np.flatnonzero(self._bounded):
            value = component(int(k))
            inside &= (value > self.lower[k]) & (value < self.upper[k])
        return inside

    # --- the map -------------------------------------------------------------------------------------------------

    def _angles(self, y: Array) -> tuple[Array, Array, Array]:
        """Return t, ψ and log |dt dψ / dy1 dy2| of coordinates (B, 2); NaN beyond what the prior allows."""
        spline = self._angle_of_y
        angle = spline(y[:, 0], extrapolate=False)
        with np.errstate(invalid="ignore", divide="ignore"):
            log_slope = np.log(spline(y[:, 0], 1, extrapolate=False))
            if not self._bounded.any():
                azimuth = self._azimuth_of_y(y[:, 1], extrapolate=False)
                return angle, azimuth, log_slope + np.log(self._azimuth_of_y(y[:, 1], 1, extrapolate=False))
            edges, lengths = self._arcs(np.where(np.isfinite(angle), angle, 0.0))
            ends = np.cumsum(lengths, axis=-1)
            length = ends[:, -1]
            wanted = ndtr(y[:, 1]) * length
            piece = np.minimum((ends < wanted[:, None]).sum(axis=-1), lengths.shape[1] - 1)
            rows = np.arange(len(y))
            azimuth = edges[rows, piece] + wanted - (ends - lengths)[rows, piece]
            log_slope += np.log(length) - 0.5 * y[:, 1] ** 2 - HALF_LOG_TWO_PI
            return np.where(length > 0, angle, np.nan), azimuth, log_slope

    def components(self, y: Array) -> Array:
        """Return u1 and u2 (B, 2) of coordinates (B, 2); NaN where there is no direction."""
        angle, azimuth, _ = self._angles(y)
        u = self._direction(angle, azimuth)
        return np.where(u[:, 2:] > 0, u[:, :2], np.nan)

    def coordinates(self, u: Array) -> Array:
        """Return coordinates (B, 2) of unit vectors (B, 3) in the local frame; NaN outside of the prior's bounds."""
        u = np.where(np.isfinite(u).all(axis=-1, keepdims=True), u, np.nan)
        w, azimuth = (part[..., 0] for part in self.circles.polar(u[:, None, :]))
        angle = np.arctan2(np.linalg.norm(np.cross(u, self.circles.axis[0]), axis=-1), w)
        first = _invert(self._angle_of_y, angle)
        if not self._bounded.any():
            return np.stack([first, _invert(self._azimuth_of_y, azimuth)], axis=-1)
        edges, lengths = self._arcs(np.where(np.isfinite(angle), angle, 0.0))
        before = np.cumsum(lengths, axis=-1) - lengths
        within = np.clip(azimuth[:, None] - edges[:, :-1], 0.0, None)
        passed = np.minimum(within, lengths).sum(axis=-1)
        piece = ((edges[:, :-1] <= azimuth[:, None]).sum(axis=-1) - 1).clip(0, lengths.shape[1] - 1)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = passed / (before + lengths)[:, -1]
        inside = lengths[np.arange(len(u)), piece] > 0
        return np.where(inside[:, None], np.stack([first, ndtri(share)], axis=-1), np.nan)

    def log_prior_ratio(self, y: Array) -> Array:
        """Return the prior's log-density in the coordinates, less that of standard normals, (B, 2) to (B,)."""
        angle, azimuth, log_slope = self._angles(y)
        u = self._direction(angle, azimuth)
        with np.errstate(invalid="ignore", divide="ignore"):
            volume = np.log(u[:, 2]) + np.log(np.sin(angle)) + log_slope
        on_arcs = self.log_prior(np.clip(u[:, :2], self.lower, self.upper))  # whatever rounding makes of their ends
        return on_arcs + volume + 0.5 * np.sum(y * y, axis=-1) + 2 * HALF_LOG_TWO_PI

    # --- derivatives ---------------------------------------------------------------------------------------------

    def _differences(self, y: Array) -> Array:
        return y + DIFFERENCE_STEP * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])

    def slopes(self, y: Array) -> Array:
        """Return d(u1, u2)/d(y1, y2), shape (2, 2), at coordinates (2,)."""
        u = self.components(self._differences(y))
        return np.stack([u[0] - u[1], u[2] - u[3]], axis=-1) / (2 * DIFFERENCE_STEP)

    def log_prior_ratio_slope(self, y: Array) -> Array:
        """Return the derivative of `log_prior_ratio` by the coordinates, shape (2,), at coordinates (2,)."""
        value = self.log_prior_ratio(self._differences(y))
        return np.array([value[0] - value[1], value[2] - value[3]]) / (2 * DIFFERENCE_STEP)


def _interpolate_quantiles(grid: Array, density: Array) -> CubicHermiteSpline:
    """Return x by y, where Φ(y) is the share of a density on a grid that lies below x."""
    from scipy.interpolate import CubicHermiteSpline, PchipInterpolator  # an eighth of a second to import

    steps = np.diff(grid)
    # the slopes of a monotone interpolant make the share of each step exact to the fourth order
    slope = PchipInterpolator(grid, density).derivative()(grid)
    mass = 0.5 * steps * (density[1:] + density[:-1]) + steps**2 / 12 * (slope[:-1] - slope[1:])
    below = np.concatenate([[0.0], np.cumsum(np.maximum(mass, 0.0))])
    above = np.concatenate([np.cumsum(np.maximum(mass, 0.0)[::-1])[::-1], [0.0]])
    total = below[-1]
    kept = (np.minimum(below, above) > TAIL * total) & (density > 0)
    below, above, grid, density = below[kept], above[kept], grid[kept], density[kept]
    y = np.where(below < above, ndtri(below / total), -ndtri(above / total))
    speed = total * np.exp(-0.5 * y**2 - HALF_LOG_TWO_PI) / density
    secant = np.diff(grid) / np.diff(y)
    limit = 3.0 * np.minimum(np.append(secant, np.inf), np.insert(secant, 0, np.inf))  # keeps it monotone
    return CubicHermiteSpline(y, grid, np.minimum(speed, limit))


def _invert(spline: CubicHermiteSpline, value: Array) -> Array:
    """Return where a monotone spline has given values, by Newton's method kept within a piece; NaN beyond its ends."""
    knots, heights = spline.x, spline(spline.x)
    known = np.where(np.isfinite(value), value, heights[0])
    piece = np.clip(np.searchsorted(heights, known) - 1, 0, len(knots) - 2)
    low, high = knots[piece], knots[piece + 1]
    y = low + (high - low) * np.clip((known - heights[piece]) / (heights[piece + 1] - heights[piece]), 0.0, 1.0)
    for _ in range(NEWTON):
        error = spline(y) - known
        low, high = np.where(error < 0, y, low), np.where(error > 0, y, high)
        step = y - error / spline(y, 1)
        y = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
    inside = (value >= heights[0]) & (value <= heights[-1])
    return np.where(inside, y, np.nan)
