"""Readings as measured: poses by channels, with what was not read left out, and what is known of their noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bayescal.machines.readings import Channel
from bayescal.numerics.geometry import Array, compute_left_inverse_jacobian, compute_left_jacobian

AT_ONCE = 2048  # poses of which many draws are looked at together
MIN_SINE = 1e-150  # of the sine of half a turn, whose square is no number
CONSTRAINT = 1e-4
"""Noise of a reading that is stated to have none, in units of the smallest other one of its unit, or of any: its square
no longer shows."""


@dataclass(frozen=True, eq=False)
class Measurements:
    """Readings of P poses by all K channels of a machine.

    Attributes
    ----------
    poses : tuple of str
        Names of the poses.
    values : ndarray, shape (P, K)
        In the channels' units; NaN where nothing was read.
    sd : ndarray, shape (P, K)
        Standard deviations; zero for a constraint, any number where nothing was read.
    given : mapping of str to ndarray, shape (P,)
        What is known of each pose besides.
    correlation : ndarray, shape (P, K, K), or None
        Of the noise; the identity where it is None.
    commanded : ndarray of bool, shape (P, K), or None
        Which readings are positions that the machine was commanded to; none where it is None.
    order : ndarray of int, shape (P,)
        Places of the poses among all that were read, by default as they stand here.
    """

    poses: tuple[str, ...]
    values: Array
    sd: Array
    given: Mapping[str, Array] = field(default_factory=dict)
    correlation: Array | None = None
    commanded: np.ndarray | None = None
    order: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=int))

    def __post_init__(self) -> None:
        """Count the poses where their order is not stated."""
        if len(self.order) != len(self.poses):
            object.__setattr__(self, "order", np.arange(len(self.poses)))

    @cached_property
    def present(self) -> np.ndarray:
        """Which readings there are, shape (P, K)."""
        return np.isfinite(self.values)

    @property
    def n_poses(self) -> int:
        """Number P of poses."""
        return len(self.poses)

    def pick(self, which: np.ndarray) -> Measurements:
        """Return some of the poses."""
        names = tuple(np.array(self.poses, dtype=object)[which])
        given = {name: value[which] for name, value in self.given.items()}
        correlation = None if self.correlation is None else self.correlation[which]
        commanded = None if self.commanded is None else self.commanded[which]
        order = self.order[which]
        return Measurements(names, self.values[which], self.sd[which], given, correlation, commanded, order)

    def split(self) -> list[tuple[np.ndarray, Measurements]]:
        """Return some of the poses at a time, (R,), with their measurements: for what many draws make of each."""
        parts = np.array_split(np.arange(self.n_poses), max(1, -(-self.n_poses // AT_ONCE)))
        return [(parts[0], self)] if len(parts) == 1 else [(part, self.pick(part)) for part in parts]

    def only(self, channels: np.ndarray) -> Measurements:
        """Return the measurements with the readings of other channels, given by a mask (K,) or (P, K), left out.

        A pose that loses one of its commanded positions has none: what is left of them need not determine it.
        """
        values, commanded = np.where(channels, self.values, np.nan), self.commanded
        if commanded is not None:
            commanded = commanded & ~(commanded & ~np.asarray(channels)).any(axis=1, keepdims=True)
        return replace(self, values=values, commanded=commanded)

    def with_constraints(self, units: Sequence[str]) -> Measurements:
        """Return the measurements with a noise that no longer shows instead of none, by the units of K channels."""
        sd, noisy = self.sd.copy(), self.present & (self.sd > 0.0)
        for unit in dict.fromkeys(units):
            alike = np.array([other == unit for other in units])
            known = self.sd[noisy & alike] if (noisy & alike).any() else self.sd[noisy]
            tiny = CONSTRAINT * (float(known.min()) if known.size else 1.0)
            sd[:, alike] = np.where(sd[:, alike] > 0.0, sd[:, alike], tiny)
        return replace(self, sd=sd)


@dataclass(frozen=True, eq=False)
class Comparison:
    """How readings of some channels are compared: on a line, on a circle, or as a rotation."""

    channels: tuple[Channel, ...]

    @cached_property
    def _periods(self) -> Array | None:
        periods = np.array([one.period or np.inf for one in self.channels])
        return periods if np.isfinite(periods).any() else None

    @cached_property
    def rotations(self) -> list[slice]:
        """Where the components of rotation vectors stand, of those that are there whole."""
        names = [one.rotation for one in self.channels]
        starts = [names.index(name) for name in dict.fromkeys(filter(None, names)) if names.count(name) == 3]
        return [slice(k, k + 3) for k in starts]

    @property
    def is_plain(self) -> bool:
        """Whether all are on a line."""
        return self._periods is None and not self.rotations

    def subtract(self, measured: Array, read: Array) -> Array:
        """Return measured minus read, (..., K); NaN where nothing was measured."""
        error = measured - read
        if self._periods is not None:
            circle = np.isfinite(self._periods)
            period = self._periods[circle]
            error[..., circle] -= period * np.round(error[..., circle] / period)
        for three in self.rotations:
            error[..., three] = _turn(*np.broadcast_arrays(measured[..., three], read[..., three]))
        return np.asarray(error)

    def add(self, read: Array, error: Array) -> Array:
        """Return what differs from readings by errors as `subtract` returns them, both (..., K)."""
        result = read + error
        for three in self.rotations:
            result[..., three] = _turn(*np.broadcast_arrays(error[..., three], -read[..., three]))
        return np.asarray(result)

    def pull_back(self, error: Array, read: Array, slope: Array) -> Array:
        """Return the derivative of read minus measured from that of the readings, both (..., K, n)."""
        if not self.rotations:
            return slope
        result = slope.copy()
        for three in self.rotations:
            vector, left = np.nan_to_num(read[..., three]), np.nan_to_num(error[..., three])
            # d log(M exp(-ω) Rᵀ) = -J_r⁻¹(r) ω with ω = J_l(v) dv, and J_r⁻¹(r) = J_l⁻¹(-r)
            turn = compute_left_inverse_jacobian(-left) @ compute_left_jacobian(vector)
            result[..., three, :] = turn @ slope[..., three, :]
        return result


@dataclass(frozen=True, eq=False)
class RowPositions:
    """Where K channels stand at M rows: the argument of errors that are functions of the position.

    It must not be the number whose density is computed: of residuals g - h - c z(g) the density of a reading g is that
    of a normal times |1 - c z'(g)|, and without that factor c z' = 1, which explains nothing, fits best. A channel
    that was commanded stands at its command, any other where the fitted machine does at the row's pose.

    Attributes
    ----------
    channels : tuple of Channel, length K
    home : ndarray, shape (K,)
        What they read in the middle of the workspace, in their units.
    order : ndarray of int, shape (M,)
        Places of the rows in measuring order.
    readings, positions : ndarray, shape (M, K)
        What was read, NaN where nothing was, and where the channels stand, in their units.
    """

    channels: tuple[Channel, ...]
    home: Array
    order: np.ndarray
    readings: Array
    positions: Array

    @classmethod
    def find(cls, channels: Sequence[Channel], data: Measurements, expected: Array, home: Array) -> RowPositions:
        """Return it for rows at which a fitted machine reads what is expected, (M, K); home where it does not stand."""
        plain = tuple(replace(one, rotation="") for one in channels)
        near = np.where(np.isfinite(expected), expected, home)
        at = near
        if data.commanded is not None:
            command = near + Comparison(plain).subtract(data.values, near)
            at = np.where(data.commanded & data.present, command, near)
        return cls(plain, home, data.order, data.values, at)

    def pick(self, which: np.ndarray) -> RowPositions:
        """Return the same of some of the channels."""
        channels = tuple(self.channels[k] for k in which)
        return RowPositions(channels, self.home[which], self.order, self.readings[:, which], self.positions[:, which])

    def find_rows(self, data: Measurements) -> np.ndarray:
        """Return which of the M rows each of P rows is, by its place in measuring order, (P,); -1 for none."""
        sorter = np.argsort(self.order)
        where = sorter[np.minimum(np.searchsorted(self.order, data.order, sorter=sorter), len(sorter) - 1)]
        return np.where(self.order[where] == data.order, where, -1)

    def at(self, data: Measurements, values: Array) -> Array:
        """Return where the channels stand at P rows whose readings of them are ``values``, (P, K).

        At rows that are none of these, and where other numbers were read than here, that is what was read; at home
        where nothing was.
        """
        rows = self.find_rows(data)
        known = rows[:, None] >= 0
        near = np.where(known, self.positions[rows], self.home)
        stay = np.isnan(values) | (known & (values == self.readings[rows]))
        return np.where(stay, near, near + Comparison(self.channels).subtract(values, near))


def _turn(measured: Array, read: Array) -> Array:
    """Return the rotation vector of M Rᵀ for rotation vectors (..., 3); NaN where either is."""
    (w, x), (v, y) = _quaternion(measured), _quaternion(read)
    real = w * v + (x * y).sum(axis=-1)
    other = v[..., None] * x - w[..., None] * y - np.cross(x, y)
    sine = np.linalg.norm(other, axis=-1)
    small = sine < MIN_SINE
    turn = np.where(small, 2.0, 2.0 * np.arctan2(sine, np.abs(real)) / np.where(small, 1.0, sine))
    return np.asarray(np.where(real < 0.0, -turn, turn)[..., None] * other)


def _quaternion(vector: Array) -> tuple[Array, Array]:
    """Return real (...) and imaginary parts (..., 3) of the rotations of vectors (..., 3)."""
    half = 0.5 * np.linalg.norm(vector, axis=-1)
    return np.cos(half), 0.5 * np.sinc(half / np.pi)[..., None] * vector
