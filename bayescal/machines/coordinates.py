"""Coordinates in which the ridges of the posterior are straight, so that simple proposals follow them.

Two shears of unit Jacobian take the curvature of the unit sphere, on which u has two components t1 and t2 and a third
that follows (see `parameters`), out of the ridges:

- instead of the attachment point a, the joint at the initial actuator position, c = a + ρ^0 u, which is what the poses
  determine;
- instead of κ, the gain of the actuator along the leg, κ' = κ - u_z - (z_x u_x + z_y u_y) / z_z with z the nominal leg
  direction (RR-8096 eqs. 38 to 40), which is what κ and u together can tell. Along a level leg κ does nothing.

Where κ is not free, both components of a direction are replaced by its gain and its azimuth about the leg, in the local
frame of u: by linear functions of these where a normal prior allows but a short arc of the circle, otherwise by
quantiles of the prior along it (see `rings`).
Struts have neither u nor ρ^0, and ridges that are straight as they stand.

Every coordinate is then scaled by the prior's standard deviation. A parameter between bounds is not sheared; its
coordinate y is standard normal under the uniform prior, θ = lower + (upper - lower) Φ(y), so that no search and
no walker meets a bound.

`ClosingCoordinates` are for legs whose joints are hardly known. Measured poses determine the mean closure of a leg to a
fraction of a micrometre, its joints perhaps to a millimetre only: where the model error may be a function of the pose.
The length that closes the leg is no linear function of where the joints are, and a millimetre squared over the leg is
micrometres. Instead of the length l stands what it is beyond the length that closes the leg at a reference pose; as a
shear along l this has unit Jacobian.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from math import prod
from typing import Self

import numpy as np
from scipy.special import ndtr, ndtri

from bayescal.machines.kinematics import Machine
from bayescal.machines.models.legs import actuator_directions, chart_of, local_directions
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.rings import DirectionCircles, DirectionRing, find_circles, frame_circles
from bayescal.numerics.geometry import Array

WIDEST = 3.0  # prior sds, in units of the sine between direction and leg, beyond which a circle is lost in the prior


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Bijection between sampling coordinates y, shape (..., n), and full parameter vectors θ, shape (..., D)."""

    layout: ParameterLayout  # layout of θ
    start: Array  # (D,): values of the parameters that are fixed, and the origin of the coordinates
    free: np.ndarray  # (n,): positions of the free parameters in θ
    scale: Array  # (n,): unit of each coordinate
    # (N, 3): the nominal legs' lines, as `compute_leg_lines` gives them; not used without actuator directions
    legs: Array
    lower: Array  # (n,): bounds of each free parameter, infinite where there are none
    upper: Array  # (n,)
    # of the machine on legs, without those of instruments beside it; None for all
    symbols: tuple[str, ...] | None = field(default=None, kw_only=True)

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
    def _turning(self) -> np.ndarray:
        """Legs with both components of u free and κ not."""
        index, symbols = self.layout.index, self.layout.direction_symbols
        if not symbols:
            return np.empty(0, dtype=int)
        turning = np.all([np.isin(index[symbol], self.free) for symbol in symbols], axis=0)
        if "kappa" in index:
            turning &= ~np.isin(index["kappa"], self.free)
        return np.flatnonzero(turning)

    def _places(self, legs: np.ndarray) -> np.ndarray:
        """Return where in y both components of legs' directions stand, shape (K, 2)."""
        index, symbols = self.layout.index, self.layout.direction_symbols
        return np.stack([np.searchsorted(self.free, index[symbol][legs]) for symbol in symbols], axis=1)

    @cached_property
    def _circles(self) -> tuple[np.ndarray, DirectionCircles] | None:
        """Legs whose direction is free and without bounds, and their circles."""
        legs = self._turning
        if len(legs):
            legs = legs[~self.bounded[self._places(legs)].any(axis=1)]
        if not len(legs):
            return None
        sd = self.scale[self._places(legs)].max(axis=1)
        clear, circles = find_circles(*self._local_pairs(legs), sd)
        return (legs[clear], circles) if clear.any() else None

    def _local_pairs(self, legs: np.ndarray) -> tuple[Array, Array]:
        """Return nominal directions and lines of legs in their local frames, shapes (K, 3)."""
        lines = chart_of(self.layout).to_local(self.legs)[legs]
        return local_directions(self.layout, self.start)[legs], lines

    @cached_property
    def rings(self) -> tuple[tuple[int, np.ndarray, DirectionRing], ...]:
        """Legs whose direction's prior is wide or bounded, where in y its components stand, and the ring of each."""
        others = self._turning if self._circles is None else np.setdiff1d(self._turning, self._circles[0])
        return tuple(ring for leg in others if (ring := self._find_ring(int(leg))) is not None)

    def _find_ring(self, leg: int) -> tuple[int, np.ndarray, DirectionRing] | None:
        """Return a leg's ring; None where the direction lies so near to the leg that the prior hardly sees it."""
        legs = np.array([leg])
        direction, line = self._local_pairs(legs)
        places = self._places(legs)[0]
        spread = self.scale[places]
        sine = float(np.linalg.norm(np.cross(direction[0], line[0])) / np.linalg.norm(line[0]))
        if not 0.0 < spread.max() < WIDEST * sine:
            return None
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
    def standard(self) -> np.ndarray:
        """Which coordinates are standard normal under the prior, those of rings but for their ratio, shape (n,)."""
        return self.bounded | self.ringed

    @cached_property
    def _on_circles(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the coordinates of gain and azimuth stand in y."""
        assert self._circles is not None
        gain, azimuth = self._places(self._circles[0]).T
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
        inside = np.flatnonzero(self.bounded & ~self.ringed)
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

    With one component of u free, the actuator turns in the plane of e1 or e2 and the pole (see `parameters`). The gain
    along the leg is even about the leg's line (3,) in that plane, base frame, of any length and sense. Only the free
    ones of the attachment point's coordinates follow. None where the other direction is further from the pole than the
    components tell.
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


JOINT = ("a_x", "a_y", "a_z")


@dataclass(frozen=True, eq=False)
class Shears:
    """What is added to parameters that are counted from what a direction does to them, for batches."""

    layout: ParameterLayout  # with actuators that have directions
    mask: np.ndarray  # (D,): parameters that may follow
    legs: Array  # (N, 3): the nominal legs' lines; κ follows along those that are not level
    along_leg: Array  # (N, 3): which parts of its joint the length of a leg follows

    @cached_property
    def _joints(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows of the attachment points that follow, and the axis and leg of each, shapes (K,)."""
        rows = np.stack([self.layout.index[symbol] for symbol in JOINT])
        axis, leg = np.nonzero(self.mask[rows])
        return rows[axis, leg], axis, leg

    def _choose(self, symbol: str, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows of a symbol that follow, and their legs; none where there is no such symbol."""
        rows = self.layout.index.get(symbol)
        if rows is None:
            return np.empty(0, dtype=int), np.empty(0, dtype=int)
        legs = np.flatnonzero(which & self.mask[rows])
        return rows[legs], legs

    @cached_property
    def _gains(self) -> tuple[np.ndarray, np.ndarray]:
        return self._choose("kappa", self.legs[:, 2] == 1.0)

    @cached_property
    def _lengths(self) -> tuple[np.ndarray, np.ndarray]:
        return self._choose("l", self.along_leg.any(axis=1))

    @cached_property
    def _turns(self) -> np.ndarray:
        """Where the two components of the directions stand, shape (2, N)."""
        return np.stack([self.layout.index[symbol] for symbol in self.layout.direction_symbols])

    def apply(self, parameters: Array, sign: float) -> None:
        """Add the shears to parameters (D, B) in place, times a sign; NaN where there are no directions."""
        (joints, axis, leg), (gains, rising), (lengths, followed) = self._joints, self._gains, self._lengths
        if not (len(joints) or len(gains) or len(lengths)):
            return
        n_legs, n_batch = self._turns.shape[1], parameters.shape[1]
        direction = np.empty((3, n_legs, n_batch))
        direction[:2] = parameters[self._turns]
        chart_of(self.layout).complete(direction)
        if len(gains):
            first, second, third = direction[:, rising]
            along = self.legs[rising, :2]
            parameters[gains] += sign * (-third - (along[:, :1] * first + along[:, 1:] * second))
        if not (len(joints) or len(lengths)):
            return
        shift = parameters[self.layout.index["rho0"]] * direction
        if len(joints):
            parameters[joints] += sign * shift[axis, leg]
        if len(lengths):
            parameters[lengths] += sign * np.einsum("ik,kib->ib", self.along_leg[followed], shift[:, followed])

    def slope(self, theta: Array) -> Array:
        """Return the derivative of θ by what it is counted from, at one vector (D,), shape (D, D)."""
        (joints, axis, leg), (gains, rising), (lengths, followed) = self._joints, self._gains, self._lengths
        change = np.eye(self.layout.size)
        if not (len(joints) or len(gains) or len(lengths)):
            return change
        local, index = local_directions(self.layout, theta), self.layout.index["rho0"]
        direction, rho0 = chart_of(self.layout).to_base(local), theta[index]
        frames = chart_of(self.layout).axes
        slopes = frames[:, :2] - (local[:, :2] / local[:, 2:])[..., None] * frames[:, 2:]
        change[joints, index[leg]] -= direction[leg, axis]
        along = self.along_leg[followed]
        change[lengths, index[followed]] -= np.sum(along * direction[followed], axis=-1)
        for m, turns in enumerate(self._turns):
            change[joints, turns[leg]] -= rho0[leg] * slopes[leg, m, axis]
            change[gains, turns[rising]] += np.sum(self.legs[rising] * slopes[rising, m], axis=-1)
            if len(lengths):
                change[lengths, turns[followed]] -= rho0[followed] * np.sum(along * slopes[followed, m], axis=-1)
        return change


LENGTH = "l"


@dataclass(frozen=True, eq=False)
class ClosingCoordinates(Coordinates):
    """Coordinates with free leg lengths counted from what closes the legs at a reference pose."""

    machine: Machine
    position: Array  # (1, 3): the reference pose
    rotation: Array  # (1, 3, 3)
    actuators: Array  # (1, N)

    @classmethod
    def around(cls, known: Coordinates, machine: Machine, position: Array, rotation: Array, actuators: Array) -> Self:
        """Return coordinates as they are but for the leg lengths."""
        as_they_are = {one.name: getattr(known, one.name) for one in fields(Coordinates)}
        return cls(**as_they_are, machine=machine, position=position, rotation=rotation, actuators=actuators)

    @cached_property
    def _lengths(self) -> np.ndarray:
        """Legs whose length is free and not bounded."""
        index = self.layout.index.get(LENGTH)
        return np.empty(0, dtype=int) if index is None else np.flatnonzero(self._mask[index])

    @cached_property
    def _slope(self) -> Array:
        """Closure per length of these legs, where the coordinates start."""
        return self._differentiate(self.start)[self._lengths, self.layout.index[LENGTH][self._lengths]]

    @cached_property
    def _gap(self) -> Array:
        """Closure of these legs where the coordinates start."""
        return self._close(self.start[None])[0]

    def _differentiate(self, theta: Array) -> Array:
        """Return the closure's derivative at the reference pose for one parameter vector (D,), shape (N, D)."""
        size, machine = self.machine.layout.size, self.machine
        return machine.linearise(theta[:size], self.position, self.rotation, self.actuators).parameters[0]

    def _close(self, theta: Array) -> Array:
        """Return the closure of these legs at the reference pose, (B, D) to (B, k)."""
        layout, model = self.machine.layout, self.machine.model
        bound = model.bind(layout, self.position, self.rotation, self.machine.basis(self.actuators))
        closure = bound.evaluate(np.asfortranarray(theta[:, : layout.size]))
        return np.asarray(closure[self._lengths, 0].T.copy())

    def _follow(self, theta: Array) -> Array:
        """Return by how much the lengths follow the rest of θ (..., D), shape (..., k)."""
        flat = theta.reshape(-1, theta.shape[-1]).copy()
        index = self.layout.index[LENGTH][self._lengths]
        flat[:, index] = self.start[index]
        moved = (self._close(flat) - self._gap) / -self._slope
        return np.asarray(moved.reshape(*theta.shape[:-1], -1))

    def theta_from_y(self, y: Array) -> Array:
        """Return full parameter vectors (..., D); see `Coordinates.theta_from_y`."""
        theta = super().theta_from_y(y)
        if len(self._lengths):
            theta[..., self.layout.index[LENGTH][self._lengths]] += self._follow(theta)
        return theta

    def y_from_theta(self, theta: Array) -> Array:
        """Return the coordinates (..., n) of full parameter vectors (..., D)."""
        theta = theta.copy()
        if len(self._lengths):
            theta[..., self.layout.index[LENGTH][self._lengths]] -= self._follow(theta)
        return super().y_from_theta(theta)

    def jacobian(self, theta: Array) -> Array:
        """Return dθ/dy, shape (D, n), at one parameter vector (D,)."""
        change = super().jacobian(theta)
        if len(self._lengths):
            index = self.layout.index[LENGTH][self._lengths]
            held = theta.copy()
            held[index] = self.start[index]
            slope = self._differentiate(held)[self._lengths]
            slope[:, index] = 0.0
            change[index] -= (slope @ change[: self.machine.layout.size]) / self._slope[:, None]
        return change
