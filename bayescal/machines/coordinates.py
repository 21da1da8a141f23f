"""Coordinates in which the ridges of the posterior are straight, so that simple proposals follow them.

Two shears of unit Jacobian take the curvature u_z = sqrt(1 - u_x² - u_y²) out of the ridges:

- in place of the attachment point a, the joint at the initial actuator position, c = a + ρ^0 u, which is what the poses
  determine;
- in place of κ, the gain of the actuator along the leg, κ' = κ - u_z - (z_x u_x + z_y u_y) / z_z with z the nominal leg
  direction (RR-8096 eqs. 38 to 40), which is what κ and u together can tell.

Where κ is not free, both components of a direction are replaced by its gain and its azimuth about the leg (`circles`).
Struts have neither u nor ρ^0, and ridges that are straight as they stand.

Every coordinate is then scaled by the prior's standard deviation. A parameter between bounds is not sheared; its
coordinate y is standard normal under the uniform prior, θ = lower + (upper - lower) Φ(y), so that no climb and no
walker runs into a wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr, ndtri

from bayescal.machines.circles import DirectionCircles, find_circles
from bayescal.machines.models.legs import actuator_directions
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array


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
    leg_slope : ndarray, shape (N, 2)
        z_x / z_z and z_y / z_z of the nominal legs; not used without actuator directions.
    lower, upper : ndarray, shape (n,)
        Bounds of each free parameter, infinite where there are none.
    """

    layout: ParameterLayout
    start: Array
    free: np.ndarray
    scale: Array
    leg_slope: Array
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
        index = self.layout.index
        if "u_x" not in index:
            return None
        both = self._mask[index["u_x"]] & self._mask[index["u_y"]]
        if "kappa" in index:
            both &= ~np.isin(index["kappa"], self.free)
        legs = np.flatnonzero(both)
        if not len(legs):
            return None
        sd = np.maximum(*(self.scale[np.searchsorted(self.free, index[s][legs])] for s in ("u_x", "u_y")))
        vectors = np.concatenate([self.leg_slope[legs], np.ones((len(legs), 1))], axis=1)
        clear, circles = find_circles(actuator_directions(self.layout, self.start)[legs], vectors, sd)
        return (legs[clear], circles) if clear.any() else None

    @cached_property
    def _on_circles(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the coordinates of gain and azimuth stand in y."""
        assert self._circles is not None
        legs, _ = self._circles
        gain, azimuth = (np.searchsorted(self.free, self.layout.index[s][legs]) for s in ("u_x", "u_y"))
        return gain, azimuth

    @cached_property
    def log_scale(self) -> float:
        """Logarithm of the constant part of the volume dθ/dy of the parameters without bounds."""
        return float(np.log(self.scale[~self.bounded]).sum())

    def log_volume(self, theta: Array) -> Array | float:
        """Return the part of log |dθ/dy| of the parameters without bounds that varies, shape (..., D) to (...)."""
        if self._circles is None:
            return 0.0
        u_z = actuator_directions(self.layout, theta)[..., self._circles[0], 2]
        return np.asarray(np.log(u_z).sum(axis=-1))

    def log_volume_slope(self, theta: Array) -> Array:
        """Return the derivative of `log_volume` by θ, shape (D,), at one vector (D,)."""
        slope = np.zeros(self.layout.size)
        if self._circles is not None:
            legs, _ = self._circles
            u = actuator_directions(self.layout, theta)[legs]
            for k, symbol in enumerate(("u_x", "u_y")):
                slope[self.layout.index[symbol][legs]] = -u[:, k] / u[:, 2] ** 2
        return slope

    def _shifts(self, theta: Array) -> dict[str, Array]:
        """Return what the shears add to each sheared symbol, shapes (..., N)."""
        if "rho0" not in self.layout.index:
            return {}
        direction = actuator_directions(self.layout, theta)
        rho0 = self.layout.take(theta, "rho0")
        shifts = {f"a_{axis}": rho0 * direction[..., k] for k, axis in enumerate("xyz")}
        if "kappa" in self.layout.index:
            shifts["kappa"] = -direction[..., 2] - np.sum(self.leg_slope * direction[..., :2], axis=-1)
        return shifts

    @cached_property
    def _origin(self) -> Array:
        """Sheared start values of the free parameters."""
        return self._shear(self.start, self.start, 1.0)[self.free]

    def _shear(self, theta: Array, source: Array, sign: float) -> Array:
        result = theta.copy()
        for symbol, shift in self._shifts(source).items():
            index = self.layout.index[symbol]
            result[..., index] += sign * np.where(self._mask[index], shift, 0.0)
        return result

    def theta_from_y(self, y: Array) -> Array:
        """Return full parameter vectors (..., D); NaN where a direction leaves the unit sphere."""
        theta = np.broadcast_to(self.start, (*y.shape[:-1], self.layout.size)).copy()
        theta[..., self.free] = self._origin + y * self.scale
        if self.bounded.any():
            inside = self.bounded
            lower, width = self.lower[inside], (self.upper - self.lower)[inside]
            theta[..., self.free[inside]] = lower + width * ndtr(y[..., inside])
        if self._circles is not None:
            legs, circles = self._circles
            gain, azimuth = self._on_circles
            w = circles.gain + y[..., gain] * self.scale[gain] * circles.sine
            u_x, u_y = circles.directions(w, y[..., azimuth] * self.scale[azimuth] / circles.sine)
            theta[..., self.layout.index["u_x"][legs]], theta[..., self.layout.index["u_y"][legs]] = u_x, u_y
        return self._shear(theta, theta, -1.0)

    def y_from_theta(self, theta: Array) -> Array:
        """Return the coordinates (..., n) of full parameter vectors (..., D)."""
        y = (self._shear(theta, theta, 1.0)[..., self.free] - self._origin) / self.scale
        y[..., self.bounded] = ndtri(self._share(theta))
        if self._circles is not None:
            legs, circles = self._circles
            gain, azimuth = self._on_circles
            w, psi = circles.polar(actuator_directions(self.layout, theta)[..., legs, :])
            y[..., gain] = (w - circles.gain) / (self.scale[gain] * circles.sine)
            y[..., azimuth] = psi * circles.sine / self.scale[azimuth]
        return y

    def _share(self, theta: Array) -> Array:
        """Return where the parameters with bounds lie between them, from 0 to 1."""
        lower, upper = self.lower[self.bounded], self.upper[self.bounded]
        return (theta[..., self.free[self.bounded]] - lower) / (upper - lower)

    def jacobian(self, theta: Array) -> Array:
        """Return dθ/dy, shape (D, n), at one parameter vector (D,)."""
        index = self.layout.index
        change = np.eye(self.layout.size)
        if "rho0" in index:
            direction = actuator_directions(self.layout, theta)
            rho0 = self.layout.take(theta, "rho0")
            fall = direction[:, :2] / direction[:, 2:]  # -du_z / du_x, -du_z / du_y
            for k, axis in enumerate("xyz"):
                rows = index[f"a_{axis}"]
                change[rows, index["rho0"]] -= direction[:, k]
                for m, other in enumerate("xy"):
                    slope = -fall[:, m] if k == 2 else np.full(len(rows), float(k == m))
                    change[rows, index[f"u_{other}"]] -= rho0 * slope
            if "kappa" in index:
                for m, other in enumerate("xy"):
                    change[index["kappa"], index[f"u_{other}"]] += self.leg_slope[:, m] - fall[:, m]
            sheared = np.concatenate([index[s] for s in ("a_x", "a_y", "a_z", "kappa") if s in index])
            fixed = sheared[~self._mask[sheared]]
            change[fixed] = np.eye(self.layout.size)[fixed]
        if self._circles is not None:
            legs, circles = self._circles
            x, y = (change[:, index[s][legs]].copy() for s in ("u_x", "u_y"))
            by_gain, by_azimuth = circles.slopes(actuator_directions(self.layout, theta)[legs])
            by_gain, by_azimuth = by_gain * circles.sine[:, None], by_azimuth / circles.sine[:, None]
            change[:, index["u_x"][legs]] = x * by_gain[:, 0] + y * by_gain[:, 1]
            change[:, index["u_y"][legs]] = x * by_azimuth[:, 0] + y * by_azimuth[:, 1]
        scale = self.scale.copy()
        normal_density = np.exp(-0.5 * ndtri(self._share(theta)) ** 2) / np.sqrt(2 * np.pi)
        scale[self.bounded] = (self.upper - self.lower)[self.bounded] * normal_density
        return change[:, self.free] * scale


def mirror_direction(layout: ParameterLayout, theta: Array, leg: int, slope: float, free: np.ndarray) -> Array:
    """Return θ with one leg's actuator turned to the other direction of the same gain, its home joint kept in place.

    The gain u_z + (z_x / z_z) u_x is that of an angle in the plane of x and z; it is even about arctan(z_x / z_z). Only
    the free ones of the attachment point's coordinates follow.

    Parameters
    ----------
    layout : ParameterLayout
    theta : ndarray, shape (D,)
    leg : int
        Counted from zero.
    slope : float
        z_x / z_z of the nominal leg.
    free : ndarray of int
        Positions of the free parameters in θ.
    """
    mirrored = theta.copy()
    before = actuator_directions(layout, theta)[leg]
    angle = 2 * np.arctan(slope) - np.arctan2(before[0], before[2])
    mirrored[layout.index["u_x"][leg]] = np.hypot(before[0], before[2]) * np.sin(angle)
    moved = layout.take(theta, "rho0")[leg] * (before - actuator_directions(layout, mirrored)[leg])
    for shift, axis in zip(moved, "xyz", strict=True):
        position = layout.index[f"a_{axis}"][leg]
        if position in free:
            mirrored[position] += shift
    return mirrored
